"""A task in motion: frames under a policy or random actions, written as .gif or .mp4, or shown in MuJoCo's viewer."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import torch
from PIL import Image

from porse.errors import PorseError
from porse.picture import HEIGHT, WIDTH, Pixels, View, camera, first_simulation
from porse.tasks.base import Task
from porse.training.actor import Actor

FRAMES_PER_SECOND = 25
COLOURS = 128
SEED = 0
SHADOWS = 2048
"""Side of a film's shadow map, in texels. Without a graphics card, a frame takes 0.6 times as long as with MuJoCo's 4096."""


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


@dataclass(frozen=True)
class Shot:
    """How a film is taken.

    Attributes:
        width, height: of a frame, in pixels.
        view: where the camera looks and stands; None for the task's own view.
    """

    width: int = WIDTH
    height: int = HEIGHT
    view: View | None = None


def write_film(path: Path, task: Task, actor: Actor, seconds: float, shot: Shot) -> None:
    """Plays for so many seconds and writes what is seen, as .gif or .mp4.

    Raises:
        PorseError: an .mp4 is asked for, and what writes it is not installed.
    """
    (write_mp4 if path.suffix.lower() == ".mp4" else write_gif)(path, task, actor, seconds, shot)


def _frames(task: Task, actor: Actor, seconds: float, shot: Shot) -> Iterator[Pixels]:
    """Plays, and yields what is seen at the start and every so often."""
    every = _every(task)
    with camera(task, shot.width, shot.height, shot.view, SHADOWS) as take:
        yield take(0)
        for step in _steps(task, actor, seconds):
            if step % every == every - 1:
                yield take(0)


def _every(task: Task) -> int:
    """Returns how many control steps are between two frames."""
    return max(1, round(1.0 / (FRAMES_PER_SECOND * task.control_dt)))


def write_gif(path: Path, task: Task, actor: Actor, seconds: float, shot: Shot = Shot()) -> None:
    """Plays for so many seconds and writes what is seen."""
    frames = [*_frames(task, actor, seconds, shot)]
    # One palette for all frames and no dithering: what stands still is then equal in all of them, and costs nothing. Colours
    # of small things count, too: the median cut, Pillow's default, made an orange egg grey.
    palette = Image.fromarray(frames[0]).quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    first, *others = (Image.fromarray(f).quantize(palette=palette, dither=Image.Dither.NONE) for f in frames)
    frame_ms = round(1000.0 * _every(task) * task.control_dt)
    first.save(path, save_all=True, append_images=others, duration=frame_ms, loop=0)


def check_mp4() -> None:
    """Checks that what writes .mp4 is installed.

    Raises:
        PorseError: it is not.
    """
    try:
        import imageio_ffmpeg  # noqa: F401
    except ImportError:
        raise PorseError(
            "expected what writes .mp4, found that imageio-ffmpeg is not installed; run `pip install imageio-ffmpeg` (the "
            "extra `film`), or write a .gif"
        ) from None


def write_mp4(path: Path, task: Task, actor: Actor, seconds: float, shot: Shot) -> None:
    """Plays for so many seconds and writes what is seen, in H.264.

    Raises:
        PorseError: what writes it is not installed.
    """
    check_mp4()
    import imageio_ffmpeg

    rate = 1.0 / (_every(task) * task.control_dt)
    # Most players want even sizes: the command line asks for them. One thread: the same frames give the same bytes.
    writer = imageio_ffmpeg.write_frames(
        str(path),
        (shot.width, shot.height),
        fps=rate,
        codec="libx264",
        macro_block_size=2,
        output_params=["-threads", "1"],
    )
    writer.send(None)
    for frame in _frames(task, actor, seconds, shot):
        writer.send(frame.tobytes())
    writer.close()


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
