"""Where trainings run: one small interface, so that another way to run them is another class and no other pipeline."""

import os
from collections.abc import Sequence
from typing import Protocol

from porse.config import Params
from porse.errors import ParamsError
from porse.training.cluster import check_ray, ray_machines
from porse.training.inline import Inline
from porse.training.job import Job, Tell
from porse.training.limits import checkpoint_s, limits_from_environment
from porse.training.local import Local
from porse.training.remote import Remote

EXECUTOR_VARIABLE = "PORSE_EXECUTOR"


class Executor(Protocol):
    """Runs trainings. Which one does, and in which order, changes no result."""

    def run(self, jobs: Sequence[Job], params: Params, tell: Tell) -> None:
        """Trains every job once and tells of each epoch and of each end, one `Ended` for every job.

        A training that fails, whatever it does to its process, ends that training alone.

        Raises:
            PorseError: the program cannot go on: a start is missing or damaged, say, or the disk is full.
        """
        ...


def uses_ray() -> bool:
    """Returns whether trainings go to the machines of a Ray cluster."""
    return os.environ.get(EXECUTOR_VARIABLE, "") == "ray"


def executor_from_environment() -> Executor:
    """Returns the executor that PORSE_EXECUTOR names.

    `local` has a process for each candidate, `inline` this process, `ray` the machines of a Ray cluster.

    Raises:
        ParamsError: it names another, Ray is not installed, or a limit is not a number.
    """
    name = os.environ.get(EXECUTOR_VARIABLE, "") or "local"
    if name == "local":
        return Local(limits_from_environment())
    if name == "inline":
        return Inline()
    if uses_ray():
        check_ray()
        return Remote(limits_from_environment(), checkpoint_s(), ray_machines)
    raise ParamsError(
        f"expected {EXECUTOR_VARIABLE} to be local, inline or ray, found {name[:40]!r} in the environment; set or unset it"
    )
