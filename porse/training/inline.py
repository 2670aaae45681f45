"""Trainings in this process, one after the other: for a debugger, and for an iteration in one process.

Nothing protects this process from a training that kills it, hangs or fills the memory: `porse.training.local` does.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from porse.config import Params
from porse.training.job import Ended, Job, Report, Tell


class Inline:
    """Trains in this process. See `porse.training.executor.Executor`."""

    def run(self, jobs: Sequence[Job], params: Params, tell: Tell) -> None:
        """Trains every job once and tells of each epoch and of each end."""
        # Imported here: a process that has its trainings done by others may do without torch.
        from porse.training.candidate import train_candidate

        for job in jobs:

            def report(epoch: int, fitness: float, name: str = job.name) -> None:
                tell(Report(name, epoch, fitness))

            with _globals_kept():
                outcome = train_candidate(job, params, report)
            tell(Ended(job.name, outcome))


@contextmanager
def _globals_kept() -> Iterator[None]:
    """Gives torch's global state back as it was: a training owns its process, and this one has other work to do."""
    import torch

    generator = torch.get_rng_state()
    deterministic = torch.are_deterministic_algorithms_enabled()
    only_warns = torch.is_deterministic_algorithms_warn_only_enabled()
    try:
        yield
    finally:
        torch.set_rng_state(generator)
        torch.use_deterministic_algorithms(deterministic, warn_only=only_warns)
