"""Limits that a process puts on itself before it runs a generated function. See `docs/security.md`."""

import ctypes
import os
import resource

from porse.code.limits import Limits

_CLONE_NEWNET = 0x40000000
_CLONE_NEWUSER = 0x10000000
_PR_SET_DUMPABLE = 4
_PR_SET_NO_NEW_PRIVS = 38
_PR_SET_PDEATHSIG = 1


def seal() -> None:
    """Takes the network from this process and its children, where the system lets it."""
    libc = _libc()
    if libc is not None:
        libc.prctl(_PR_SET_PDEATHSIG, 9, 0, 0, 0)
        if libc.unshare(_CLONE_NEWNET) != 0:
            libc.unshare(_CLONE_NEWUSER | _CLONE_NEWNET)


def confine(limits: Limits, keep: int) -> None:
    """Limits this process for good: memory, processor time, files, processes, and every open file but `keep`."""
    used = _address_space()
    pairs = {
        resource.RLIMIT_AS: used + limits.memory_mib * 2**20,
        resource.RLIMIT_CPU: limits.cpu_s,
        resource.RLIMIT_FSIZE: 0,
        resource.RLIMIT_CORE: 0,
        resource.RLIMIT_NPROC: 0,
    }
    for kind, value in pairs.items():
        resource.setrlimit(kind, (value, value))
    os.closerange(0, keep)
    os.closerange(keep + 1, 4096)
    resource.setrlimit(resource.RLIMIT_NOFILE, (keep + 8, keep + 8))
    libc = _libc()
    if libc is not None:
        libc.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)


def _libc() -> ctypes.CDLL | None:
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        return libc if hasattr(libc, "prctl") and hasattr(libc, "unshare") else None
    except OSError:
        return None


def _address_space() -> int:
    """Returns the bytes of address space that this process has taken."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[0]) * resource.getpagesize()
    except OSError:
        return 8 * 2**30
