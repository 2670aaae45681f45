"""What a generated function may use while it is probed."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Limits of the probe of one function; they decide verdicts, never results.

    Attributes:
        wall_s: seconds of wall-clock time for compiling and probing one function, then it is killed.
        cpu_s: seconds of processor time for the same.
        memory_mib: address space that one function may take beyond what the probe holds, in MiB.
        startup_s: seconds of wall-clock time for starting the child process, which loads torch.
    """

    wall_s: float = 10.0
    cpu_s: int = 8
    memory_mib: int = 1024
    startup_s: float = 120.0
