"""Trains a pool of candidates, each apart from the others: one that fails is a failed candidate, and nothing more."""

import dataclasses
import shutil
from collections.abc import Sequence

from porse.config import Params
from porse.training.executor import executor_from_environment
from porse.training.job import Ended, Job, Outcome, Report, Tell


def train_pool(jobs: Sequence[Job], params: Params, tell: Tell) -> list[Outcome]:
    """Trains all jobs and returns their outcomes, in the order of the jobs.

    A training that failed for a cause that may lie outside it (a signal, a lack of memory, a stop) is tried once more
    from its start, after the others have ended. A checkpoint is put in its place when its training has ended well: what
    fails leaves none, and its start stays as it was, were it the same file.

    Args:
        jobs: the trainings, each with a name of its own.
        params: the run's parameters.
        tell: is told of every epoch and every end; a training that is tried again has two ends.

    Raises:
        PorseError: the program cannot go on: a start is missing or damaged, say, or the disk is full.
    """
    if not jobs:
        return []
    executor = executor_from_environment()
    outcomes: dict[str, Outcome] = {}

    def remember(event: Report | Ended) -> None:
        if isinstance(event, Ended):
            outcomes[event.name] = event.outcome
        tell(event)

    aside = {job.name: job.finish.with_name(f"{job.finish.stem}.unfinished") / job.finish.name for job in jobs}
    apart = [dataclasses.replace(job, finish=aside[job.name]) for job in jobs]
    try:
        executor.run(apart, params, remember)
        again = [job for job in apart if outcomes[job.name].outside]
        if again:
            executor.run(again, params, remember)
        for job in jobs:
            if not outcomes[job.name].failure:
                aside[job.name].replace(job.finish)
    finally:
        for path in aside.values():
            shutil.rmtree(path.parent, ignore_errors=True)
    return [outcomes[job.name] for job in jobs]
