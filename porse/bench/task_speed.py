"""How fast each task steps, as a Markdown table: `python -m porse.bench.task_speed` prints it.

A control step here is all that a task does in one: random actions in, physics, measurements, observations, and new
episodes where some ended. The bare physics is `mujoco.batch.Batch.step` alone, from the same states with the same
controls and substeps. Nothing of this is tracked.
"""

import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import click
import torch
from torch import Tensor

from porse.bench.floor import Clock, bare_steps_s, physics_of, starts_of
from porse.printing import echo
from porse.tasks import TASKS, make_task
from porse.tasks.base import Task

STEPS = 10
"""Control steps of one round."""


@dataclass(frozen=True)
class Round:
    """The same `STEPS` control steps, by the task and by the bare physics.

    Attributes:
        whole_s: seconds of the task.
        bare_s: seconds of the bare physics.
    """

    whole_s: float
    bare_s: float

    @property
    def share(self) -> float:
        """The part of the task's time that the bare physics takes."""
        return self.bare_s / self.whole_s


@dataclass(frozen=True)
class Speed:
    """A task's speed.

    Attributes:
        steps: environment steps a second, median of the rounds.
        share: time of the bare physics over the time of the task, median of the rounds.
    """

    steps: float
    share: float


def measure(task: Task, seconds: float) -> Speed:
    """Returns the speed of a task that is played with random actions for about so many seconds, three rounds at least.

    Counted is time on the clock, since several threads may step the physics.
    """
    end, played = time.perf_counter() + seconds, []
    for each in rounds(task, time.perf_counter):
        played.append(each)
        if len(played) >= 3 and time.perf_counter() >= end:
            break
    whole_s = statistics.median(each.whole_s for each in played)
    return Speed(task.num_envs * STEPS / whole_s, statistics.median(each.share for each in played))


def rounds(task: Task, clock: Clock) -> Iterator[Round]:
    """Yields rounds without an end. The first one, which finds caches cold, is not among them."""
    return islice(_rounds(task, clock), 1, None)


def _rounds(task: Task, clock: Clock) -> Iterator[Round]:
    physics = physics_of(task)
    generator = torch.Generator().manual_seed(0)
    while True:
        drawn = [2.0 * torch.rand(task.num_envs, task.NUM_ACTIONS, generator=generator) - 1.0 for _ in range(STEPS)]
        before = task.state()
        begun = clock()
        _play(task, drawn)
        whole = clock() - begun
        # Played again, to the same states: noting them takes time that is not the task's.
        task.load_state(before)
        with starts_of(physics) as starts:
            _play(task, drawn)
        after = task.state()
        bare = bare_steps_s(physics, starts, task.SUBSTEPS, clock)
        task.load_state(after)
        yield Round(whole, bare)


def _play(task: Task, drawn: Sequence[Tensor]) -> None:
    for actions in drawn:
        task.step(actions)
        task.reset(task.terminated() | task.timed_out())
        task.observations()


@click.command()
@click.option("--envs", default=128, show_default=True, help="Environments stepped at once.")
@click.option("--threads", default=2, show_default=True, help="Native threads of the physics.")
@click.option("--seconds", default=2.0, show_default=True, help="How long each task is played.")
def main(envs: int, threads: int, seconds: float) -> None:
    """Print environment steps a second of every task, and the share of the bare physics, as Markdown."""
    torch.set_num_threads(1)
    echo("| task | substeps | environment steps/s | share of bare `Batch.step` |")
    echo("| --- | --- | --- | --- |")
    for name in TASKS:
        task = make_task(name, envs, seed=0, threads=threads)
        speed = measure(task, seconds)
        echo(f"| {name} | {task.SUBSTEPS} | {speed.steps:,.0f} | {speed.share:.0%} |")


if __name__ == "__main__":
    main()
