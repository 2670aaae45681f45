"""What trainings may use, from the environment: CPUs, memory, time without progress. None of it changes a result."""

import os
from dataclasses import dataclass

from porse.errors import ParamsError
from porse.processes import memory_mib

WORKERS_VARIABLE = "PORSE_WORKERS"
MEMORY_VARIABLE = "PORSE_MEMORY_MIB"
SILENCE_VARIABLE = "PORSE_SILENCE_S"
CHECKPOINT_VARIABLE = "PORSE_CHECKPOINT_S"

_SILENCE_S = 600
_CHECKPOINT_S = 600


@dataclass(frozen=True)
class Limits:
    """Limits of the trainings of a pool.

    Attributes:
        workers: CPUs that they use.
        crowd: how many may share these CPUs at the end of a pool, when no full round is left.
        memory_mib: memory that one of them may take beyond what it is forked with, in MiB.
        silence_s: seconds that one of them may take without finishing an epoch.
    """

    workers: int
    crowd: int
    memory_mib: int
    silence_s: int


def limits_from_environment() -> Limits:
    """Returns the limits that the environment sets.

    Raises:
        ParamsError: a variable is not a positive whole number.
    """
    count = workers()
    # Where the user keeps CPUs free for something else, they stay free.
    crowd = 2 * count - 1 if count == cpus() else count
    return Limits(
        workers=count,
        crowd=crowd,
        memory_mib=_number(MEMORY_VARIABLE, max(1, memory_mib() // count)),
        silence_s=_number(SILENCE_VARIABLE, _SILENCE_S),
    )


def workers() -> int:
    """Returns how many CPUs trainings use: PORSE_WORKERS, or all that this process may use.

    Raises:
        ParamsError: PORSE_WORKERS is not a positive whole number.
    """
    return _number(WORKERS_VARIABLE, cpus())


def checkpoint_s() -> int:
    """Returns after how many seconds a training that may lose its machine writes the next checkpoint to go on from.

    Raises:
        ParamsError: PORSE_CHECKPOINT_S is not a positive whole number.
    """
    return _number(CHECKPOINT_VARIABLE, _CHECKPOINT_S)


def cpus() -> int:
    """Returns how many CPUs this process may use."""
    # macOS does not say which CPUs a process may use.
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _number(variable: str, default: int) -> int:
    text = os.environ.get(variable, "")
    if not text:
        return default
    if not (text.isascii() and text.isdecimal()) or not 1 <= len(text) <= 9 or int(text) < 1:
        raise ParamsError(
            f"expected {variable} to be a whole number from 1 to 999999999, found {text[:40]!r} in the environment; set or unset it"
        )
    return int(text)
