"""How fast tasks step and train on a GPU, as a Markdown table: `python -m porse.report.gpu_speed` prints it in about 7 minutes.

An environment step is all that a task does in one: drawn actions, physics, measurements, observations, new episodes. A
training step has PPO and the human reward with it, with the networks of the preset `paper`. Warp compiles its kernels for
each task when they are first used, and keeps them: where the time ends early, the same command does the rest.
"""

import dataclasses
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import torch

from porse.checkpoint import write_checkpoint
from porse.config import Params, load_document, parse_params
from porse.printing import echo
from porse.sim.devices import Device
from porse.sim.placement import placed
from porse.tasks import make_task
from porse.tasks.base import Task
from porse.training.bonus import NoBonus
from porse.training.device import made_ready
from porse.training.goal import human
from porse.training.reward import Reward
from porse.training.scale import ReturnScale
from porse.training.trainer import Trainer, draw_policy

TASKS = ("Over", "LiftUnderarm", "Humanoid", "FrankaCabinet")
ENVS = (2048, 4096, 8192, 16384)
WARM_UP = 4
"""Control steps, and epochs, that are not timed: memory is claimed, graphs are recorded."""


@dataclass(frozen=True)
class Speed:
    """One row of the table.

    Attributes:
        task: its name.
        envs: number of environments.
        environment: environment steps a second.
        training: training steps a second.
        gib: most memory of the GPU that torch held, GiB; that of the physics comes on top.
        ready_s: seconds until the first step, kernels compiled.
    """

    task: str
    envs: int
    environment: float
    training: float
    gib: float
    ready_s: float


def training_params(params_file: Path, task: str, envs: int, device: Device) -> Params:
    """Returns the parameters of the preset `paper`, for so many environments."""
    document: dict[str, Any] = load_document(params_file)
    document |= {"task": task, "size": "paper", "device": device.name, "deterministic": device.deterministic}
    params = parse_params(document, str(params_file), params_file.parent)
    return dataclasses.replace(params, train=dataclasses.replace(params.train, num_envs=envs))


def measured(params: Params, seconds: float) -> Speed:
    """Returns the speed of one task, each of the two measured for about so many seconds."""
    begun = time.perf_counter()
    device, train = made_ready(params), params.train
    if device.is_gpu:
        torch.cuda.reset_peak_memory_stats(device.torch)
    with placed(device.torch), tempfile.TemporaryDirectory() as folder:
        task = make_task(params.task, train.num_envs, seed=0, device=device)
        _play(task, WARM_UP)
        _wait(device)
        ready = time.perf_counter() - begun
        steps, spent = _timed(lambda count: _play(task, count), 16, seconds, device)
        scales = [ReturnScale(train.gamma, train.num_envs) for _ in range(2)]
        reward = Reward(human, NoBonus(), 0.0, 1.0, *scales)
        trainer = Trainer(task, reward, train, seed=0)
        start = Path(folder) / "start.safetensors"
        write_checkpoint(start, draw_policy(task.NUM_OBSERVATIONS, task.NUM_ACTIONS, train, seed=0))
        trainer.load(start)
        _learn(trainer, 1)
        epochs, trained = _timed(lambda count: _learn(trainer, count), 1, seconds, device)
        task.check()
    gib = torch.cuda.max_memory_allocated(device.torch) / 2**30 if device.is_gpu else 0.0
    in_epoch = train.num_envs * train.steps_per_epoch
    return Speed(params.task, train.num_envs, train.num_envs * steps / spent, in_epoch * epochs / trained, gib, ready)


def _play(task: Task, steps: int) -> None:
    with torch.inference_mode():
        for _ in range(steps):
            task.step(2.0 * torch.rand(task.num_envs, task.NUM_ACTIONS) - 1.0)
            task.renew(task.terminated() | task.timed_out())
            task.observations()


def _learn(trainer: Trainer, epochs: int) -> None:
    trainer.train(trainer.epoch + epochs, lambda *_: None, lambda _: None)


def _timed(do: Callable[[int], None], count: int, seconds: float, device: Device) -> tuple[int, float]:
    """Returns how often something was done, some times at once, and the seconds that it took."""
    _wait(device)
    begun, done = time.perf_counter(), 0
    while not done or time.perf_counter() - begun < seconds:
        do(count)
        done += count
        _wait(device)
    return done, time.perf_counter() - begun


def _wait(device: Device) -> None:
    if device.is_gpu:
        torch.cuda.synchronize(device.torch)


def rows(
    params_file: Path, tasks: Sequence[str], sizes: Sequence[int], device: Device, seconds: float, minutes: float
) -> Iterator[Speed]:
    """Yields the rows, the smallest sizes of all tasks first, until the time is over."""
    end = time.monotonic() + 60.0 * minutes
    for envs in sizes:
        for task in tasks:
            if time.monotonic() + 2.0 * seconds > end:
                return
            yield measured(training_params(params_file, task, envs, device), seconds)
            if device.is_gpu:
                torch.cuda.empty_cache()


@click.command()
@click.option(
    "--params", "params_file", type=click.Path(path_type=Path), default=Path("params.yaml"), show_default=True
)
@click.option("--device", default="cuda:0", show_default=True, help="cuda:0 and so on, cpu, or warp-cpu.")
@click.option("--deterministic/--fast", default=False, show_default=True, help="The same bits in every run, or speed.")
@click.option("--task", "tasks", multiple=True, default=TASKS, show_default=True)
@click.option("--envs", "sizes", multiple=True, type=click.IntRange(2), default=ENVS, show_default=True)
@click.option("--seconds", default=8.0, show_default=True, help="Of each of the two measurements of a row.")
@click.option("--minutes", default=7.0, show_default=True, help="No row begins after so long.")
def main(
    params_file: Path, device: str, deterministic: bool, tasks: tuple[str, ...], sizes: tuple[int, ...], seconds: float,
    minutes: float,
) -> None:  # fmt: skip
    """Prints the table."""
    on = Device(device, deterministic)
    name = torch.cuda.get_device_name(on.torch) if on.is_gpu else "processor"
    echo(f"{device} ({name}), deterministic: {str(deterministic).lower()}, torch {torch.__version__}\n")
    echo("| task | environments | environment steps/s | training steps/s | torch's GiB | ready after s |")
    echo("| --- | ---: | ---: | ---: | ---: | ---: |")
    count = 0
    for row in rows(params_file, tasks, sizes, on, seconds, minutes):
        figures = f"{row.environment:,.0f} | {row.training:,.0f} | {row.gib:.1f} | {row.ready_s:.0f}"
        echo(f"| {row.task} | {row.envs} | {figures} |")
        count += 1
    missing = len(tasks) * len(sizes) - count
    if missing:
        echo(
            f"\n{missing} rows did not begin within {minutes:g} minutes; the same command is quicker now that kernels are compiled."
        )


if __name__ == "__main__":
    main()
