"""A task in motion: frames under a policy or random actions, written as .gif or shown in MuJoCo's viewer."""

import time
from collections.abc import Iterator
from pathlib import Path

import torch
from PIL import Image

from porse.picture import camera, first_simulation
from porse.tasks.base import Task
from porse.training.actor import Actor

WIDTH, HEIGHT, FRAMES_PER_SECOND = 480, 360, 25
COLOURS = 128
SEED = 0


def random_actor(task: Task) -> Actor:
    """Returns random actions, the same ones each time."""
    generator = torch.Generator().manual_seed(SEED)
    return lambda _: 2.0 * torch.rand(task.num_envs, task.NUM_ACTIONS, generator=generator) - 1.0


def _steps(task: Task, actor: Actor, seconds: float) -> Iterator[int]:
    """Plays and yields the number of each control step; ended episodes begin anew."""
    with torch.inference_mode():
        for step in range(int(seconds / task.control_dt)):
            task.step(actor(task.observations()))
            task.reset(task.terminated() | task.timed_out())
            yield step


def write_gif(path: Path, task: Task, actor: Actor, seconds: float) -> None:
    """Plays for so many seconds and writes what is seen."""
    every = max(1, round(1.0 / (FRAMES_PER_SECOND * task.control_dt)))
    with camera(task, WIDTH, HEIGHT) as take:
        frames = [take(), *(take() for step in _steps(task, actor, seconds) if step % every == every - 1)]
    # One palette for all frames and no dithering: what stands still is then equal in all of them, and costs nothing.
    palette = Image.fromarray(frames[0]).quantize(COLOURS, dither=Image.Dither.NONE)
    first, *others = (Image.fromarray(f).quantize(palette=palette, dither=Image.Dither.NONE) for f in frames)
    first.save(path, save_all=True, append_images=others, duration=round(1000.0 * every * task.control_dt), loop=0)


def view(task: Task, actor: Actor, seconds: float) -> None:
    """Plays in MuJoCo's viewer, in real time, until the time is over or the window is closed."""
    import mujoco.viewer

    model, data = first_simulation(task)
    with mujoco.viewer.launch_passive(model, data) as viewer:
        for _ in _steps(task, actor, seconds):
            first_simulation(task, data)
            mujoco.mj_forward(model, data)
            viewer.sync()
            time.sleep(task.control_dt)
            if not viewer.is_running():
                return
