"""What the human rewards teach, as tables from the runs of a suite: `python -m porse.report.learning RESULTS docs`.

One table has a row for each task, the other the curve of each run.

Fitness is that of training epochs, of a policy that explores, and of whole episodes: of zero action, of random actions
N(0, 0.8) and of the trained policy's mean action. A task learns if its last epochs beat both policies that know nothing by
at least a tenth of the gap between the better one and the best possible fitness. Success can be rarer than that although a
policy has learned much of what the reward pays for. So the table also says whether the return improves: whether it ends
above that of both policies, by twice the deviation of the better one's episodes.

The return of training episodes is the mean reward of a step times the mean length of an episode, which is their mean return
where episodes are in all phases. Beside it stands Bi-DexHands' PPO at the same number of steps, between two points of its
published curve on a straight line.
"""

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import chain, pairwise
from pathlib import Path
from statistics import fmean

import click
import torch
from torch import Tensor

from porse import tables
from porse.config import load_params, presets_root
from porse.report.calibration import first_episodes, random_actions, zero_actions
from porse.report.paper import find_mts
from porse.tables import Row
from porse.tasks import TASKS, make_task
from porse.tasks.base import Task
from porse.training.episodes import play_episodes

COLUMNS = (
    "task", "seeds", "steps", "start", "zero_action", "random", "end", "paper", "holds",
    "lowest", "mts", "final", "return", "published_return", "published_std", "return_holds",
    "zero_return", "random_return", "improves",
)  # fmt: skip

CURVE_COLUMNS = ("task", "seed", "steps", "fitness", "return")

TABLE, CURVES = "learning.csv", "learning-curves.csv"

STRETCHES = 30
"""Of a run's epochs, each a point of its curve: the mean over it."""
EPOCHS = 10
"""How many first and last epochs are averaged."""
ENVS = 128
"""Whole episodes of zero action and of random actions."""
CLEARLY = 0.1
DEVIATIONS = 2.0
"""How many deviations of its episodes a return must be above that of a policy that knows nothing."""
BEST: Mapping[str, float] = {"Quadcopter": 0.0, "Anymal": 0.0, "Humanoid": 7.235}
"""The best possible fitness: no distance, no deviation, the paper's speed (m/s) with this reward; else every episode: 1."""


@dataclass(frozen=True)
class Learned:
    """What one run learned.

    Attributes:
        steps: environment steps of the training.
        start: mean fitness of its first epochs, where the policy is about random.
        end: of its last epochs.
        mts: the highest of any epoch.
        final: what the trained policy's mean action is worth, over whole episodes.
        returned: mean return of the last epochs' episodes, with the human reward.
    """

    task: str
    steps: int
    start: float
    end: float
    mts: float
    final: float
    returned: float


@dataclass(frozen=True)
class Trivial:
    """What a policy is worth that sees nothing.

    Attributes:
        fitness: mean over whole episodes.
        returned: their mean return with the human reward.
        deviation: standard deviation of their returns.
    """

    fitness: float
    returned: float
    deviation: float


def learned(result: Path) -> Learned:
    """Returns what a finished run learned.

    Args:
        result: a folder with the run's `params.yaml` and `results/`.
    """
    iterations = tables.read(result / "results" / "iterations.parquet", tables.ITERATIONS)
    episodes = tables.read(result / "results" / "episodes.parquet", tables.EPISODES)
    fitness, rewards, lengths = _series(result)
    return Learned(
        task=load_params(result / "params.yaml", presets_root(result)).task,
        steps=sum(row["environment_steps"] for row in iterations),
        start=fmean(fitness[:EPOCHS]),
        end=fmean(fitness[-EPOCHS:]),
        mts=max(row["mts"] for row in iterations),
        final=fmean(row["outcome"] for row in episodes),
        returned=_mean_return(rewards[-EPOCHS:], lengths[-EPOCHS:]),
    )


def learning_curve(result: Path, steps: int) -> list[Row]:
    """Returns the curve of a finished run: fitness and return, each the mean over one of `STRETCHES` equal stretches.

    The return of a stretch in which no episode ended is empty.

    Args:
        result: a folder with the run's `params.yaml` and `results/`.
        steps: environment steps of the whole training; a point stands at the end of its stretch.
    """
    params = load_params(result / "params.yaml", presets_root(result))
    fitness, rewards, lengths = _series(result)
    ends = [number * len(fitness) // STRETCHES for number in range(STRETCHES + 1)]
    return [
        {
            "task": params.task,
            "seed": params.seed,
            "steps": steps * end // len(fitness),
            "fitness": _short(fmean(fitness[start:end])),
            "return": _short(_mean_return(rewards[start:end], lengths[start:end])),
        }
        for start, end in pairwise(ends)
        if start < end
    ]


def _series(result: Path) -> tuple[list[float], list[float], list[float]]:
    """Returns fitness, mean reward of a step, and mean length of episodes (nan where none ended), in the order of epochs."""
    curves = tables.read(result / "results" / "curves.parquet", tables.CURVES)
    found: dict[str, dict[int, float]] = {"fitness": {}, "goal": {}, "episode_length": {}}
    for row in curves:
        if row["series"] in found:
            found[row["series"]][row["epoch"]] = row["value"]
    fitness, rewards, lengths = (
        [found[name].get(epoch, math.nan) for epoch in sorted(found["goal"])] for name in found
    )
    return fitness, rewards, lengths


def _mean_return(rewards: Sequence[float], lengths: Sequence[float]) -> float:
    """Returns the mean return of the episodes of some epochs: nan where none ended."""
    ended = [length for length in lengths if not math.isnan(length)]
    return fmean(rewards) * fmean(ended) if ended else math.nan


def learning_row(runs: Sequence[Learned], zero: Trivial, random: Trivial) -> Row:
    """Returns the row of one task: means over its runs, one for each seed, and the lowest end.

    Args:
        runs: at least one, all of one task.
        zero: zero action.
        random: random actions.
    """
    task, steps = runs[0].task, runs[0].steps
    end, trivial = fmean(run.end for run in runs), max(zero.fitness, random.fitness)
    better = max(zero, random, key=lambda policy: policy.returned)
    paper = find_mts(task, "human", "none")
    returned, published = fmean(run.returned for run in runs), published_return(task, steps)
    return {
        "task": task,
        "seeds": len(runs),
        "steps": steps,
        "start": _short(fmean(run.start for run in runs)),
        "zero_action": _short(zero.fitness),
        "random": _short(random.fitness),
        "end": _short(end),
        "paper": "" if paper is None else _short(paper.mean),
        "holds": _said(end - trivial >= CLEARLY * (BEST.get(task, 1.0) - trivial)),
        "lowest": _short(min(run.end for run in runs)),
        "mts": _short(fmean(run.mts for run in runs)),
        "final": _short(fmean(run.final for run in runs)),
        "return": _short(returned),
        "published_return": "" if published is None else _short(published[0]),
        "published_std": "" if published is None else _short(published[1]),
        "return_holds": "" if published is None else _said(returned >= published[0]),
        "zero_return": _short(zero.returned),
        "random_return": _short(random.returned),
        "improves": _said(returned >= better.returned + DEVIATIONS * better.deviation),
    }


def published_return(task: str, steps: int) -> tuple[float, float] | None:
    """Returns mean and deviation of Bi-DexHands' PPO after so many steps; None where its curve has no points around them."""
    for (before, *low), (after, *high) in pairwise(published_curves().get(task, ())):
        if before <= steps <= after:
            share = (steps - before) / (after - before)
            mean, std = (a + share * (b - a) for a, b in zip(low, high, strict=True))
            return mean, std
    return None


@cache
def published_curves() -> Mapping[str, Sequence[tuple[float, float, float]]]:
    """Returns the points of Bi-DexHands' PPO by task: environment steps, mean return and its deviation over seeds."""
    found: dict[str, list[tuple[float, float, float]]] = {}
    with (Path(__file__).parent / "paper" / "returns.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            found.setdefault(row["task"], []).append(
                (float(row["environment_steps"]), float(row["mean"]), float(row["std"]))
            )
    return {task: sorted(points) for task, points in found.items()}


def trivial(task: str, actions: Callable[[Task], Iterator[Tensor]]) -> Trivial:
    """Returns what a policy that sees nothing is worth, over the first whole episode of every environment.

    Args:
        task: its name.
        actions: yields actions for a task, `(num_envs, actions)`.
    """
    made = make_task(task, ENVS, seed=0)
    drawn = actions(made)
    fitness = fmean(episode.outcome for episode in play_episodes(made, lambda _: next(drawn)))
    made = make_task(task, ENVS, seed=0)
    returns = first_episodes(made, actions(made)).returns.double()
    return Trivial(fitness, float(returns.mean()), float(returns.std()))


def _said(holds: bool) -> str:
    return "yes" if holds else "no"


def _short(value: float) -> str:
    return "" if math.isnan(value) else f"{float(f'{value:.4g}'):g}"


def _rows(path: Path) -> dict[str, list[Row]]:
    """Returns the rows of a table by task; none if it is not there yet."""
    found: dict[str, list[Row]] = {}
    if path.exists():
        with path.open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                found.setdefault(row["task"], []).append(dict(row))
    return found


def _write(path: Path, columns: Sequence[str], rows: Iterable[Row]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


@click.command()
@click.argument("results", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.argument("docs", type=click.Path(exists=True, file_okay=False, path_type=Path))
def main(results: Path, docs: Path) -> None:
    """Write what the finished runs in the folder RESULTS of a suite learned, as two tables in the folder DOCS.

    Tasks without a finished run there keep their rows.
    """
    torch.set_num_threads(1)
    runs: dict[str, list[Learned]] = {}
    curves = _rows(docs / CURVES)
    for done in sorted(results.glob("*/done.json")):
        run = learned(done.parent)
        if run.task not in runs:
            runs[run.task], curves[run.task] = [], []
        runs[run.task].append(run)
        curves[run.task] += learning_curve(done.parent, run.steps)
    rows = _rows(docs / TABLE)
    for task, own in runs.items():
        rows[task] = [learning_row(own, trivial(task, zero_actions), trivial(task, random_actions))]
    for path, columns, by_task in ((docs / CURVES, CURVE_COLUMNS, curves), (docs / TABLE, COLUMNS, rows)):
        _write(path, columns, chain.from_iterable(by_task.get(task, []) for task in TASKS))


if __name__ == "__main__":
    main()
