"""What the human rewards teach, one row for each task of a suite: `python -m porse.report.learning RESULTS CSV`.

Fitness is that of training epochs, of a policy that explores, and of whole episodes: of zero action, of random actions
N(0, 0.8) and of the trained policy's mean action. A task learns where its last epochs are clearly above both policies that
know nothing: by a tenth of the way from the better of them to what can be had.

The return of training episodes is the mean reward of a step times the mean length of an episode, which is their mean return
where episodes are in all phases. Beside it stands Bi-DexHands' PPO at the same number of steps, between two points of its
published curve on a straight line.
"""

import csv
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from statistics import fmean

import click
import torch
from torch import Tensor

from porse import tables
from porse.config import load_params
from porse.report.calibration import random_actions, zero_actions
from porse.report.paper import find_mts
from porse.tables import Row
from porse.tasks import TASKS, make_task
from porse.training.episodes import play_episodes

COLUMNS = (
    "task", "seeds", "steps", "start", "zero_action", "random", "end", "paper", "holds",
    "lowest", "mts", "final", "return", "published_return", "published_std", "return_holds",
)  # fmt: skip

EPOCHS = 10
"""How many first and last epochs are averaged."""
ENVS = 128
"""Whole episodes of zero action and of random actions."""
CLEARLY = 0.1
BEST: Mapping[str, float] = {"Quadcopter": 0.0, "Anymal": 0.0, "Humanoid": 7.235}
"""The fitness that can be had: no distance, no deviation, the paper's speed (m/s) with this reward; else every episode: 1."""


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


def learned(result: Path) -> Learned:
    """Returns what a finished run learned.

    Args:
        result: a folder with the run's `params.yaml` and `results/`.
    """
    iterations = tables.read(result / "results" / "iterations.parquet", tables.ITERATIONS)
    episodes = tables.read(result / "results" / "episodes.parquet", tables.EPISODES)
    curves = tables.read(result / "results" / "curves.parquet", tables.CURVES)
    series: dict[str, list[float]] = {"fitness": [], "goal": [], "episode_length": []}
    for row in sorted(curves, key=lambda row: row["epoch"]):
        if row["series"] in series:
            series[row["series"]].append(row["value"])
    return Learned(
        task=load_params(result / "params.yaml").task,
        steps=sum(row["environment_steps"] for row in iterations),
        start=fmean(series["fitness"][:EPOCHS]),
        end=fmean(series["fitness"][-EPOCHS:]),
        mts=max(row["mts"] for row in iterations),
        final=fmean(row["outcome"] for row in episodes),
        returned=fmean(series["goal"][-EPOCHS:]) * fmean(series["episode_length"][-EPOCHS:]),
    )


def learning_row(runs: Sequence[Learned], zero: float, random: float) -> Row:
    """Returns the row of one task: means over its runs, one for each seed, and the lowest end.

    Args:
        runs: at least one, all of one task.
        zero: fitness of zero action.
        random: of random actions.
    """
    task, steps = runs[0].task, runs[0].steps
    end, trivial = fmean(run.end for run in runs), max(zero, random)
    paper = find_mts(task, "human", "none")
    returned, published = fmean(run.returned for run in runs), published_return(task, steps)
    return {
        "task": task,
        "seeds": len(runs),
        "steps": steps,
        "start": _short(fmean(run.start for run in runs)),
        "zero_action": _short(zero),
        "random": _short(random),
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
    }


def published_return(task: str, steps: int) -> tuple[float, float] | None:
    """Returns mean and deviation of Bi-DexHands' PPO after so many steps; None where its curve has no points around them."""
    for (before, *low), (after, *high) in pairwise(_curves().get(task, ())):
        if before <= steps <= after:
            share = (steps - before) / (after - before)
            mean, std = (a + share * (b - a) for a, b in zip(low, high, strict=True))
            return mean, std
    return None


@cache
def _curves() -> Mapping[str, Sequence[tuple[float, float, float]]]:
    found: dict[str, list[tuple[float, float, float]]] = {}
    with (Path(__file__).parent / "paper" / "returns.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            found.setdefault(row["task"], []).append(
                (float(row["environment_steps"]), float(row["mean"]), float(row["std"]))
            )
    return {task: sorted(points) for task, points in found.items()}


def trivial_fitness(task: str, actions: Callable[..., Iterable[Tensor]]) -> float:
    """Returns what a policy that sees nothing is worth, over the first whole episode of every environment.

    Args:
        task: its name.
        actions: yields actions for a task, `(num_envs, actions)`.
    """
    made = make_task(task, ENVS, seed=0)
    drawn = iter(actions(made))
    return fmean(episode.outcome for episode in play_episodes(made, lambda _: next(drawn)))


def _said(holds: bool) -> str:
    return "yes" if holds else "no"


def _short(value: float) -> str:
    return "" if math.isnan(value) else f"{float(f'{value:.4g}'):g}"


@click.command()
@click.argument("results", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.argument("target", type=click.Path(dir_okay=False, path_type=Path))
def main(results: Path, target: Path) -> None:
    """Write one line for each task with finished runs in the folder RESULTS of a suite to the CSV file TARGET."""
    torch.set_num_threads(1)
    runs: dict[str, list[Learned]] = {}
    for entry in sorted(results.iterdir()):
        if (entry / "done.json").exists():
            run = learned(entry)
            runs.setdefault(run.task, []).append(run)
    with target.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        for task in filter(runs.__contains__, TASKS):
            zero, random = (trivial_fitness(task, actions) for actions in (zero_actions, random_actions))
            writer.writerow(learning_row(runs[task], zero, random))


if __name__ == "__main__":
    main()
