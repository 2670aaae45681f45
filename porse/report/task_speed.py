"""How fast each task steps, as a Markdown table: `python -m porse.report.task_speed` prints it.

A control step here is all that a task does in one: random actions in, physics, measurements, observations, and new
episodes where some ended. The bare physics is `mujoco.batch.Batch.step` alone, from the same states with the same
controls and substeps. Nothing of this is tracked.
"""

import statistics
import time
from collections.abc import Iterator
from dataclasses import dataclass

import click
import torch

from porse.sim.physics import CpuPhysics
from porse.tasks import TASKS, make_task
from porse.tasks.base import Task

STEPS = 10
"""Control steps of one round."""


@dataclass(frozen=True)
class Speed:
    """A task's speed.

    Attributes:
        steps: environment steps a second, in the best round.
        share: time of the bare physics over the time of the task, median of the rounds.
    """

    steps: float
    share: float


def measure(task: Task, seconds: float) -> Speed:
    """Returns the speed of a task that is played with random actions for about so many seconds, three rounds at least."""
    rounds = list(_rounds(task, seconds))
    best = min(whole for whole, _ in rounds)
    return Speed(task.num_envs * STEPS / best, statistics.median(bare / whole for whole, bare in rounds))


def _rounds(task: Task, seconds: float) -> Iterator[tuple[float, float]]:
    """Yields the seconds that the task and the bare physics need for `STEPS` control steps, each from the same states."""
    physics = task._physics
    assert isinstance(physics, CpuPhysics)
    generator = torch.Generator().manual_seed(0)
    end, number = time.perf_counter() + seconds, 0
    while number < 4 or time.perf_counter() < end:
        whole = bare = 0.0
        for _ in range(STEPS):
            actions = 2.0 * torch.rand(task.num_envs, task.NUM_ACTIONS, generator=generator) - 1.0
            before = physics.state()
            started = time.perf_counter()
            task.step(actions)
            task.reset(task.terminated() | task.timed_out())
            task.observations()
            whole += time.perf_counter() - started
            after = physics.state()
            physics.load_state(before)
            started = time.perf_counter()
            physics._batch.step(nstep=task.SUBSTEPS)
            bare += time.perf_counter() - started
            physics.load_state(after)
            physics._batch.warning[:] = 0
        # The first round finds caches cold.
        if number:
            yield whole, bare
        number += 1


@click.command()
@click.option("--envs", default=128, show_default=True, help="Environments stepped at once.")
@click.option("--threads", default=2, show_default=True, help="Native threads of the physics.")
@click.option("--seconds", default=2.0, show_default=True, help="How long each task is played.")
def main(envs: int, threads: int, seconds: float) -> None:
    """Print environment steps a second of every task, and the share of the bare physics, as Markdown."""
    torch.set_num_threads(1)
    click.echo("| task | substeps | environment steps/s | share of bare `Batch.step` |")
    click.echo("| --- | --- | --- | --- |")
    for name in TASKS:
        task = make_task(name, envs, seed=0, threads=threads)
        speed = measure(task, seconds)
        click.echo(f"| {name} | {task.SUBSTEPS} | {speed.steps:,.0f} | {speed.share:.0%} |")


if __name__ == "__main__":
    main()
