"""Limits that a process puts on itself before it runs a generated function. `docs/security.md` says what they are worth.

Everywhere: address space, processor time, file size, processes, open files. On Linux besides: no network namespace, no
new privileges, and a system call filter that leaves memory, clocks, one pipe and the end; everything else is refused.
"""

import ctypes
import errno
import functools
import os
import platform
import resource
import struct
from dataclasses import dataclass
from typing import Literal

import psutil

from porse.processes import die_with_parent

# Numbers of the kernel's, from its headers.
_CLONE_NEWNET, _CLONE_NEWUSER = 0x40000000, 0x10000000
_PR_GET_SECCOMP, _PR_SET_SECCOMP, _PR_SET_NO_NEW_PRIVS, _SECCOMP_MODE_FILTER = 21, 22, 38, 2
_AUDIT = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}
# read, write, close, fstat, lseek, mmap, mprotect, munmap, brk, rt_sigaction, rt_sigprocmask, rt_sigreturn,
# sched_yield, mremap, madvise, getpid, exit, gettid, futex, clock_gettime, clock_nanosleep, exit_group, getrandom,
# restart_syscall, sigaltstack, getrusage, sched_getaffinity
_CALLS = {
    "x86_64": (0, 1, 3, 5, 8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 28, 39, 60, 186, 202, 228, 230, 231, 318, 219, 131, 98, 204),
    "aarch64": (63, 64, 57, 80, 62, 222, 226, 215, 214, 134, 135, 139, 124, 216, 233, 172, 93, 178, 98, 113, 115, 94, 278,
                128, 132, 165, 123),
}  # fmt: skip


@dataclass(frozen=True)
class Limits:
    """Limits of the probe of one function; they decide verdicts, never results.

    Attributes:
        wall_s: seconds of wall-clock time for compiling and probing one function, then it is killed. A function cannot wait,
            so processor time is what decides, however busy the machine is.
        cpu_s: seconds of processor time for the same.
        memory_mib: address space that one function may take beyond what the probe holds, in MiB.
        startup_s: seconds of wall-clock time for starting the child process, which loads torch.
    """

    wall_s: float = 120.0
    cpu_s: int = 8
    memory_mib: int = 1024
    startup_s: float = 120.0


class _Program(ctypes.Structure):
    """The kernel's struct sock_fprog."""

    _fields_ = [("length", ctypes.c_ushort), ("filter", ctypes.c_char_p)]


def seal() -> None:
    """Takes the network from this process and its children, and ends it with its parent, where the system lets it.

    What each child needs to confine itself is made here once.
    """
    die_with_parent()
    _filter()
    libc = _libc()
    if libc is not None and libc.unshare(_CLONE_NEWNET) != 0:
        libc.unshare(_CLONE_NEWUSER | _CLONE_NEWNET)


def filters_calls() -> bool:
    """Returns whether this system can filter the system calls of a process, as `confine` then does."""
    libc = _libc()
    return libc is not None and _filter() is not None and libc.prctl(_PR_GET_SECCOMP, 0, 0, 0, 0) >= 0


def confine(limits: Limits, keep: int) -> Literal["filtered", "limited"]:
    """Limits this process for good and closes every open file but `keep`.

    Returns:
        "filtered" when the system calls are filtered too, "limited" where the system has no such filter.
    """
    os.closerange(0, keep)
    os.closerange(keep + 1, 65536)
    # One second of processor time past the limit is left, so that the process ends with a signal of its own.
    for kind, soft, more in (
        (resource.RLIMIT_AS, psutil.Process().memory_info().vms + limits.memory_mib * 2**20, 0),
        (resource.RLIMIT_CPU, limits.cpu_s, 1),
        (resource.RLIMIT_FSIZE, 0, 0),
        (resource.RLIMIT_CORE, 0, 0),
        (resource.RLIMIT_NPROC, 0, 0),
    ):
        hard = resource.getrlimit(kind)[1]
        most = soft + more if hard == resource.RLIM_INFINITY else min(soft + more, hard)
        resource.setrlimit(kind, (min(soft, most), most))
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, 0))
    libc, filtered = _libc(), _filter()
    if libc is None or filtered is None or libc.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0:
        return "limited"
    failed = libc.prctl(_PR_SET_SECCOMP, _SECCOMP_MODE_FILTER, ctypes.addressof(filtered), 0, 0)
    return "limited" if failed else "filtered"


@functools.cache
def _filter() -> _Program | None:
    """Returns what refuses every system call that is not in `_CALLS`, None for a machine whose calls are not known."""
    machine = platform.machine()
    if machine not in _CALLS:
        return None
    calls = _CALLS[machine]
    load, jump_if_equal, jump_if_at_least, finish = 0x20, 0x15, 0x35, 0x06
    allow, refuse, kill = 0x7FFF0000, 0x00050000 | errno.EPERM, 0x80000000
    program = [
        (load, 0, 0, 4),
        (jump_if_equal, 1, 0, _AUDIT[machine]),
        (finish, 0, 0, kill),
        (load, 0, 0, 0),
        (jump_if_at_least, len(calls), 0, 0x40000000),
        *[(jump_if_equal, len(calls) - index, 0, call) for index, call in enumerate(calls)],
        (finish, 0, 0, refuse),
        (finish, 0, 0, allow),
    ]
    code = b"".join(struct.pack("=HBBI", *instruction) for instruction in program)
    return _Program(len(program), code)


@functools.cache
def _libc() -> ctypes.CDLL | None:
    libc = ctypes.CDLL(None)
    if not hasattr(libc, "prctl") or not hasattr(libc, "unshare"):
        return None
    libc.prctl.argtypes = [ctypes.c_int, *[ctypes.c_ulong] * 4]
    return libc
