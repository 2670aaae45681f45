"""How each task behaves under policies that know nothing, beside the originals: `python -m porse.report.calibration CSV`.

Two policies play the first episodes: random actions N(0, 0.8), clipped to [-1, 1], as Bi-DexHands' trainings begin; and
zero action. Each gives the mean return with the human reward and the length of the shortest episode.

The published figures are the first rows of Bi-DexHands' learning curves: 2 048 environments, ten seeds, of policies that
had a few gradient steps behind them. The first row of a curve is written when the first episodes have ended, so it says
how long the shortest ones were. Ours are of 64 environments, where the shortest is longer. A return is taken to agree
within a factor of `RETURN`, a shortest episode within a factor of `LENGTH`.
"""

import csv
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import click
import torch
from torch import Tensor

from porse.tables import Row
from porse.tasks import TASKS, make_task
from porse.tasks.base import Task

COLUMNS = ("task", "quantity", "published", "ours", "low", "high", "holds")
ENVS = 64
STILL = 8
"""Environments of zero action, whose episodes differ by their starts alone."""

SPREAD = 0.8
RETURN = 1.5
"""Factor within which a return agrees."""

LENGTH = 2.0
"""Factor within which the length of the shortest episode agrees."""


@dataclass(frozen=True)
class Published:
    """What random play of an original gave.

    Attributes:
        returns: lowest and highest mean return.
        shortest: lowest and highest length of the shortest episode, over the curves.
        within: the return is of episodes that ended within so many steps; None for all.
    """

    returns: tuple[float, float] | None = None
    shortest: tuple[int, int] | None = None
    within: int | None = None


PUBLISHED: Mapping[str, Published] = {
    "Over": Published((1.2, 2.5), (18, 39)),
    "CatchAbreast": Published((0.06, 0.14), (14, 26)),
    "CatchOver2Underarm": Published((2.7, 3.9), (8, 30)),
    "CatchUnderarm": Published((0.49, 0.66), (28, 53)),
    "TwoCatchUnderarm": Published((0.94, 1.4), (26, 53)),
    "DoorCloseInward": Published((139.0, 145.0), (228, 256)),
    "DoorCloseOutward": Published((11.7, 11.8), (8, 23), within=47),
    "DoorOpenInward": Published(shortest=(243, 256)),
    "DoorOpenOutward": Published(shortest=(140, 256)),
    "BlockStack": Published((110.0, 155.0)),
    "GraspAndPlace": Published((10.0, 10.0)),
    "BottleCap": Published((110.0, 140.0)),
}
"""From the first rows of `dataset/` in Bi-DexHands, the last three from its images of curves.

By the time that the first episodes of the opening doors ended, their policies had had 30 updates: returns say nothing of
random play there.
"""


@dataclass(frozen=True)
class Episodes:
    """First episodes of all environments.

    Attributes:
        returns: with the human reward.
        lengths: in steps.
    """

    returns: Tensor
    lengths: Tensor

    def mean_return(self, within: int | None = None) -> float:
        """Returns the mean return of the episodes that ended within so many steps; NaN where none did."""
        chosen = self.returns if within is None else self.returns[self.lengths <= within]
        return float(chosen.double().mean())

    def shortest(self) -> int:
        """Returns the length of the shortest episode."""
        return int(self.lengths.min())


def random_actions(task: Task) -> Iterator[Tensor]:
    """Yields clipped actions N(0, 0.8)."""
    generator = torch.Generator().manual_seed(1)
    while True:
        # Sums of twelve uniform draws: the normal distribution of torch goes through libraries that know CPUs apart.
        draws = torch.rand(12, task.num_envs, task.NUM_ACTIONS, generator=generator)
        yield (SPREAD * (draws.sum(dim=0) - 6.0)).clamp(-1.0, 1.0)


def zero_actions(task: Task) -> Iterator[Tensor]:
    """Yields zeros."""
    while True:
        yield torch.zeros(task.num_envs, task.NUM_ACTIONS)


def first_episodes(task: Task, actions: Iterator[Tensor]) -> Episodes:
    """Plays the first episode of every environment."""
    returns, lengths = torch.zeros(task.num_envs), torch.zeros(task.num_envs, dtype=torch.int64)
    running = torch.ones(task.num_envs, dtype=torch.bool)
    while running.any():
        task.step(next(actions))
        returns[running] += task.human_reward()[running]
        lengths[running] += 1
        done = task.terminated() | task.timed_out()
        running &= ~done
        task.reset(done)
    return Episodes(returns, lengths)


def calibration_rows(name: str) -> list[Row]:
    """Returns the rows of one task."""
    published = PUBLISHED.get(name, Published())
    played = first_episodes(task := make_task(name, ENVS, seed=0), random_actions(task))
    still = first_episodes(task := make_task(name, STILL, seed=0), zero_actions(task))
    within = "" if published.within is None else f"_within_{published.within}"
    return [
        _row(name, f"random_return{within}", published.returns, played.mean_return(published.within), RETURN),
        _row(name, "random_shortest", published.shortest, played.shortest(), LENGTH),
        _row(name, "zero_return", None, still.mean_return(), RETURN),
        _row(name, "zero_shortest", None, still.shortest(), LENGTH),
    ]


def _row(name: str, quantity: str, published: tuple[float, float] | None, ours: float, factor: float) -> Row:
    """Returns a row; a quantity with nothing published is uncalibrated, and its last columns are empty."""
    row: Row = {"task": name, "quantity": quantity, "ours": _short(ours)}
    if published is None:
        return row | {"published": "", "low": "", "high": "", "holds": ""}
    low, high = published[0] / factor, published[1] * factor
    label = _short(published[0]) if published[0] == published[1] else "-".join(_short(value) for value in published)
    holds = "yes" if low <= ours <= high else "no"
    return row | {"published": label, "low": _short(low), "high": _short(high), "holds": holds}


def _short(value: float) -> str:
    """Returns a number with three digits, whole ones with all of theirs."""
    if isinstance(value, int) or math.isnan(value):
        return str(value)
    return f"{float(f'{value:.3g}'):g}"


@click.command()
@click.argument("target", type=click.Path(dir_okay=False, path_type=Path))
def main(target: Path) -> None:
    """Write the calibration table of all tasks to the CSV file TARGET. Takes about five minutes of one core."""
    torch.set_num_threads(1)
    with target.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        for name in TASKS:
            writer.writerows(calibration_rows(name))
            file.flush()


if __name__ == "__main__":
    main()
