"""Processes that do not outlive the one that wanted their work."""

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1


def die_with_parent(parent: int | None = None) -> None:
    """Asks Linux to kill this process when its parent ends; elsewhere it does nothing.

    A run that is killed with `kill -9` would else leave its trainings behind, and they would write into the folders of
    the run that is started next.

    Args:
        parent: the process that is to be its parent, where the caller knows that for sure; None: its parent as of now.
    """
    if not sys.platform.startswith("linux"):
        return
    parent = os.getppid() if parent is None else parent
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    # The parent may have ended before the request was made.
    if os.getppid() != parent:
        os.kill(os.getpid(), signal.SIGKILL)
