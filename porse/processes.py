"""Processes that do not outlive the one that wanted their work, and that take no more memory than they may."""

import contextlib
import ctypes
import os
import resource
import signal
import sys

_PR_SET_PDEATHSIG = 1


def die_with_parent(parent: int | None = None) -> None:
    """Asks Linux to kill this process when its parent ends; elsewhere it does nothing.

    A run that is killed with `kill -9` would else leave its trainings behind, and they would write into the folders of
    the run that is started next.

    Args:
        parent: the process that must be the parent, where it is known; this process ends at once where it is not.
    """
    if not sys.platform.startswith("linux"):
        return
    wanted = os.getppid() if parent is None else parent
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    # The parent may have ended before the request was made.
    if os.getppid() != wanted:
        os.kill(os.getpid(), signal.SIGKILL)


PARENT_VARIABLE = "PORSE_PARENT"
"""Names the process that must be a stage's parent: a stage asks to end with it some milliseconds after it was started."""


def expected_parent() -> int | None:
    """Returns the process that the environment names as the parent, None where it names none; names it to no child."""
    text = os.environ.pop(PARENT_VARIABLE, "")
    return int(text) if text.isascii() and text.isdecimal() else None


def limit_memory(mib: int) -> None:
    """Lets this process take so much memory beyond what it has, on Linux; what asks for more is refused it.

    What counts is memory of its own that it may write to, not address space: libraries reserve much more of that than
    they use. Where the machine itself runs out, Linux ends this process before its parent.
    """
    if not sys.platform.startswith("linux"):
        return
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w", encoding="ascii") as file:
        file.write("500")
    with open("/proc/self/status", encoding="ascii") as lines:
        taken = next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmData:"))
    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    wanted = taken + mib * 2**20
    resource.setrlimit(resource.RLIMIT_DATA, (wanted if hard == resource.RLIM_INFINITY else min(wanted, hard), hard))


def unlimit_memory() -> None:
    """Takes back what `limit_memory` did, as far as the system lets this process."""
    if sys.platform.startswith("linux"):
        hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
        resource.setrlimit(resource.RLIMIT_DATA, (hard, hard))


def memory_mib() -> int:
    """Returns the memory that this process and its children may fill, in MiB: the machine's, or the container's."""
    found = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    try:
        with open("/sys/fs/cgroup/memory.max", encoding="ascii") as file:
            text = file.read().strip()
    except OSError:
        text = "max"
    if text.isdecimal():
        found.append(int(text))
    return min(found) // 2**20
