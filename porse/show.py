"""`porse render` and `porse play`: a task as a picture, as a moving picture, or in MuJoCo's viewer."""

import ctypes.util
import os
import sys
from pathlib import Path

import click

from porse.config import Params, load_document, parse_params
from porse.errors import PorseError
from porse.pool import BEST, policy_file


@click.command()
@click.argument("task")
@click.option(
    "--out", required=True, type=click.Path(dir_okay=False, path_type=Path), help="A .png, or a .gif of random actions."
)
@click.option("--seconds", default=2.0, show_default=True, help="Length of a .gif.")
def render(task: str, out: Path, seconds: float) -> None:
    """Draw TASK at an episode's start, or moving under random actions."""
    if out.suffix not in (".png", ".gif"):
        raise PorseError(f"expected --out to end in .png or .gif, found {out}; choose one of them")
    _choose_renderer()
    from porse.film import HEIGHT, SEED, WIDTH, random_actor, write_gif
    from porse.tasks import make_task
    from porse.tasks.picture import picture, write_png

    shown = make_task(task, 1, SEED)
    if out.suffix == ".png":
        write_png(out, picture(shown, WIDTH, HEIGHT))
    else:
        write_gif(out, shown, random_actor(shown), seconds)
    click.echo(f"{out}: {shown.NAME}")


@click.command()
@click.argument("task")
@click.option(
    "--checkpoint",
    type=click.Path(path_type=Path),
    help="The folder of a run, whose last winner is shown, or one policy or checkpoint of it (.safetensors).",
)
@click.option(
    "--params", "path", default="params.yaml", show_default=True, type=click.Path(dir_okay=False, path_type=Path)
)
@click.option(
    "--out", type=click.Path(dir_okay=False, path_type=Path), help="Write a .gif instead of opening the viewer."
)
@click.option("--seconds", default=10.0, show_default=True)
def play(task: str, checkpoint: Path | None, path: Path, out: Path | None, seconds: float) -> None:
    """Show a policy, or random actions, on TASK: in the viewer, or as a .gif where there is no display."""
    in_viewer = out is None and _has_display()
    if not in_viewer:
        _choose_renderer()
    from porse.film import SEED, random_actor, view, write_gif
    from porse.tasks import make_task
    from porse.training.actor import policy_actor

    shown = make_task(task, 1, SEED)
    actor = random_actor(shown)
    if checkpoint:
        # The networks of a preset are those of the task that is shown, whatever the file's own task is.
        document = load_document(path)
        params = parse_params({**document, "task": task} if isinstance(document, dict) else document, str(path))
        actor = policy_actor(shown, _winners(checkpoint, params) if checkpoint.is_dir() else checkpoint, params.train)
    if in_viewer:
        view(shown, actor, seconds)
        return
    target = out or Path(f"{shown.NAME}.gif")
    write_gif(target, shown, actor, seconds)
    click.echo(f"{target}: {shown.NAME}, {seconds:g} s")


def _winners(run: Path, params: Params) -> Path:
    """Returns the file of the policy that a run ended with."""
    return policy_file(run / str(params.iterations[-1].next) / "start", BEST)


def _has_display() -> bool:
    return bool(os.environ.get("DISPLAY")) or sys.platform == "darwin"


def _choose_renderer() -> None:
    """Names the renderer that works without a display, before MuJoCo is imported; MUJOCO_GL goes first.

    Raises:
        PorseError: there is no display, and neither EGL nor OSMesa.
    """
    if _has_display() or os.environ.get("MUJOCO_GL"):
        return
    for library, name in (("EGL", "egl"), ("OSMesa", "osmesa")):
        if ctypes.util.find_library(library):
            os.environ["MUJOCO_GL"] = name
            return
    raise PorseError("expected a display, EGL or OSMesa to draw with, found none; install libegl1 or libosmesa6")
