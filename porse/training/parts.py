"""A training in parts, each with a checkpoint behind it: whoever takes it over goes on after the last whole part.

A training that is split anywhere gives the same bits, so neither the length of a part nor who trains it changes a result. A
whole part is two files in the training's own folder: a checkpoint, and then, put in place in one step, a JSON file with the
rows up to there. Every attempt writes under its own number, so an attempt that is wrongly believed dead disturbs nobody.
"""

import dataclasses
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from porse.checkpoint import read_checkpoint
from porse.config import Params
from porse.training.job import Ended, Job, Outcome, Report, Tell

FIRST = 8
"""Epochs of the first part of an attempt, whose speed says how long the next one may be."""

Run = Callable[[Job, Params, Tell], None]
"""Trains one job, as an executor does."""


@dataclass(frozen=True)
class Part:
    """A training up to an epoch.

    Attributes:
        epoch: the last one done.
        checkpoint: the file to go on from.
        rows: (epoch, series, value) of all epochs of the training so far.
    """

    epoch: int
    checkpoint: Path
    rows: list[tuple[int, str, float]]


def train_in_parts(
    job: Job, params: Params, folder: Path, attempt: int, every_s: float, run: Run, tell: Tell
) -> Outcome:
    """Trains a job, from the last part that any attempt has left in `folder`, and returns what it left.

    Args:
        job: the training, whole.
        params: the run's parameters.
        folder: where its parts are.
        attempt: the number of this attempt, which nobody else has.
        every_s: seconds of training from one checkpoint to the next, about.
        run: trains one part.
        tell: is told of every epoch.

    Raises:
        PorseError: the program cannot go on: the start is missing or damaged, say, or the disk is full.
    """
    part = last_part(folder)
    start = part or Part(int(read_checkpoint(job.start).scalars.get("epoch", 0)), job.start, [])
    pace = 0.0
    while True:
        until = start.epoch + part_length(job.until - start.epoch, pace, every_s)
        finish = job.finish if until == job.until else folder / f"{attempt}-{until}.safetensors"
        begun = start.epoch if start.rows else 0
        clock = _Clock(tell)
        run(
            dataclasses.replace(job, start=start.checkpoint, finish=finish, until=until, begun=begun),
            params,
            clock.tell,
        )
        outcome = clock.outcome
        if outcome.failure:
            return outcome
        rows = [*start.rows, *outcome.rows]
        if until == job.until:
            return Outcome(rows, "")
        old, start, pace = start, Part(until, finish, rows), clock.pace or pace
        _write(start, folder / f"{attempt}-{until}.json")
        if old.checkpoint.name.startswith(f"{attempt}-") and old.checkpoint.parent == folder:
            old.checkpoint.with_suffix(".json").unlink()
            old.checkpoint.unlink()


def part_length(left: int, pace_s: float, every_s: float) -> int:
    """Returns the epochs of the next part: as many as fit between two checkpoints, at least 1 and at most all.

    A rest of less than half a part more is done at once.

    Args:
        left: epochs that are left to do.
        pace_s: seconds of one epoch; 0: not known yet.
        every_s: seconds from one checkpoint to the next.
    """
    fits = max(1, int(every_s / pace_s)) if pace_s else FIRST
    return left if left <= fits + fits // 2 else fits


def last_part(folder: Path) -> Part | None:
    """Returns the whole part of the highest epoch in a folder, None where there is none."""
    parts: list[Part] = []
    for path in folder.glob("*-*.json"):
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            continue  # its attempt still lives, and has just put a later one in its place
        rows = [(epoch, series, value) for epoch, series, value in found["rows"]]
        parts.append(Part(found["epoch"], path.with_suffix(".safetensors"), rows))
    return max((part for part in parts if part.checkpoint.is_file()), key=lambda part: part.epoch, default=None)


def _write(part: Part, path: Path) -> None:
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps({"epoch": part.epoch, "rows": part.rows}), encoding="utf-8")
    partial.replace(path)


class _Clock:
    """Hands reports on, keeps the end, and measures the time between the first report and the last."""

    def __init__(self, tell: Tell) -> None:
        self._tell, self._times = tell, list[float]()
        self.outcome = Outcome([], "it was not trained", outside=True)

    def tell(self, event: Report | Ended) -> None:
        """Takes in what happens."""
        if isinstance(event, Ended):
            self.outcome = event.outcome
            return
        self._times.append(time.monotonic())
        self._tell(event)

    @property
    def pace(self) -> float:
        """Seconds of one epoch; 0 where one report alone tells nothing."""
        return (self._times[-1] - self._times[0]) / (len(self._times) - 1) if len(self._times) > 1 else 0.0
