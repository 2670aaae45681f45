"""Kills the process that imports it in the middle of a write, for `tests/kills.py`: DVC itself is as it was installed.

`PORSE_TEST_KILL=NAME:NUMBER:SHARE` kills it when it has the NUMBERth file of that name open for writing, counted from 1,
and SHARE per cent of what it wrote are in the file.
"""

import builtins
import os
import signal
import sys

_open = builtins.open


def _arm(name, number, share):
    opened = 0

    def patched(path, mode="r", *arguments, **named):
        nonlocal opened
        file = _open(path, mode, *arguments, **named)
        if "w" not in mode or os.path.basename(str(path)) != name:
            return file
        opened += 1
        if opened == number:
            close = file.close

            def cut():
                file.flush()
                os.truncate(path, os.path.getsize(path) * share // 100)
                os.kill(os.getpid(), signal.SIGKILL)
                close()

            # A `with` looks its methods up on the class; DVC's own file object is a plain one of Python's.
            return _Cut(file, cut)
        return file

    builtins.open = patched


class _Cut:
    def __init__(self, file, cut):
        self._file, self._cut = file, cut

    def __getattr__(self, name):
        return getattr(self._file, name)

    def __enter__(self):
        return self._file

    def __exit__(self, *_):
        self._cut()


# DVC alone, not its stages.
if "PORSE_TEST_KILL" in os.environ and any("dvc" in word for word in sys.orig_argv[1:3]):
    _name, _number, _share = os.environ["PORSE_TEST_KILL"].split(":")
    _arm(_name, int(_number), int(_share))
