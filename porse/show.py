"""`porse render` and `porse play`: a task as a picture, as a moving picture, or in MuJoCo's viewer."""

import functools
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec

import click

from porse.config import load_document, parse_params, presets_root
from porse.errors import PorseError
from porse.paths import TASK_ARGUMENT, check_target
from porse.presets import check_task_name
from porse.printing import echo
from porse.renderer import choose_renderer, draws, has_display
from porse.report.results import params_file, winners_policy

LONGEST_FILM_S, LONGEST_VIEW_S = 120.0, 86_400.0
MOST_FILM_MIB, _FRAMES_PER_SECOND = 4096, 25
"""The frames of a .gif are held in memory, 13 MiB a second at the default size."""

FILMS = (".gif", ".mp4")

_Arguments = ParamSpec("_Arguments")


def _explains(command: Callable[_Arguments, None]) -> Callable[_Arguments, None]:
    """Has a command that failed say so where nothing can be drawn here: each renderer fails in its own way, some on import."""

    @functools.wraps(command)
    def explaining(*arguments: _Arguments.args, **named: _Arguments.kwargs) -> None:
        try:
            command(*arguments, **named)
        except PorseError:
            raise
        except Exception:
            draws()
            raise

    return explaining


def _seconds(context: click.Context, parameter: click.Parameter, value: float) -> float:
    """Checks a length: NaN, nothing and less, and more than a day are refused."""
    if math.isfinite(value) and 0.0 < value <= LONGEST_VIEW_S:
        return value
    raise click.BadParameter(f"expected more than 0 and at most {LONGEST_VIEW_S:g} seconds, found {value:g}")


def _check_film(seconds: float, width: int, height: int) -> None:
    if seconds > LONGEST_FILM_S:
        raise PorseError(
            f"expected a film of at most {LONGEST_FILM_S:g} seconds, found --seconds {seconds:g}; write a shorter one"
        )
    size_mib = seconds * _FRAMES_PER_SECOND * width * height * 3 / 2**20
    if size_mib > MOST_FILM_MIB:
        raise PorseError(
            f"expected frames of at most {MOST_FILM_MIB} MiB in memory, found {size_mib:.0f} for {seconds:g} seconds of "
            f"{width} x {height}; write a shorter or a smaller film"
        )


_CAMERA = re.compile(r"-?[0-9.]+(,-?[0-9.]+){5}")


def _view(context: click.Context, parameter: click.Parameter, value: str | None) -> Any:
    """Reads a camera: six numbers with commas between them."""
    if value is None:
        return None
    try:
        x, y, z, distance, azimuth, elevation = map(float, value.split(","))
    except ValueError:
        distance = math.nan
    if not _CAMERA.fullmatch(value) or not distance > 0.0:
        raise click.BadParameter(
            f"expected X,Y,Z,DISTANCE,AZIMUTH,ELEVATION, six numbers and a distance above 0, found {value!r}"
        )
    return (x, y, z), distance, azimuth, elevation


def _even(context: click.Context, parameter: click.Parameter, value: int) -> int:
    if value % 2:
        raise click.BadParameter(f"expected an even number of pixels, as films want, found {value}")
    return value


def _shot(command: Any) -> Any:
    """Adds the options that say how a picture or a film is taken."""
    for option in (
        click.option("--seed", default=0, show_default=True, type=click.IntRange(0, 2**31 - 1), help="Of the start."),
        click.option(
            "--camera",
            "view",
            callback=_view,
            metavar="X,Y,Z,DISTANCE,AZIMUTH,ELEVATION",
            help="Where the camera looks (m), from how far (m), and at what angles (degrees). [default: the task's view]",
        ),
        click.option(
            "--height", default=360, show_default=True, type=click.IntRange(16, 2160), callback=_even, help="Pixels."
        ),
        click.option(
            "--width", default=480, show_default=True, type=click.IntRange(16, 3840), callback=_even, help="Pixels."
        ),
    ):
        command = option(command)
    return command


@click.command()
@click.argument("task")
@click.option(
    "--out",
    required=True,
    type=click.Path(dir_okay=False, path_type=Path),
    help="A .png, or a .gif or .mp4 of random actions.",
)
@click.option("--seconds", default=2.0, show_default=True, callback=_seconds, help="Length of a film.")
@_shot
@_explains
def render(task: str, out: Path, seconds: float, width: int, height: int, view: Any, seed: int) -> None:
    """Draw TASK at an episode's start, or moving under random actions."""
    check_task_name(task, TASK_ARGUMENT)
    check_target(out, (".png", *FILMS))
    _check_film(seconds, width, height)
    choose_renderer()
    from porse.film import Shot, check_mp4, random_actor, write_film
    from porse.picture import camera, write_png
    from porse.tasks import make_task

    if out.suffix.lower() == ".mp4":
        check_mp4()
    shown = make_task(task, 1, seed)
    if out.suffix.lower() == ".png":
        with camera(shown, width, height, view) as take:
            write_png(out, take(0))
    else:
        write_film(out, shown, random_actor(shown), seconds, Shot(width, height, view))
    echo(f"{out}: {shown.NAME}")


@click.command()
@click.argument("task")
@click.option(
    "--checkpoint",
    type=click.Path(path_type=Path),
    help="The folder of a run, whose last winner is shown, or one policy or checkpoint of it (.safetensors).",
)
@click.option(
    "--params",
    "path",
    type=click.Path(dir_okay=False, path_type=Path),
    help="The run's parameters. [default: params.yaml in or above the checkpoint's folder]",
)
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write a .gif or .mp4 instead of opening the viewer.",
)
@click.option("--seconds", default=10.0, show_default=True, callback=_seconds, help="How long it is shown.")
@_shot
@_explains
def play(
    task: str,
    checkpoint: Path | None,
    path: Path | None,
    out: Path | None,
    seconds: float,
    width: int,
    height: int,
    view: Any,
    seed: int,
) -> None:
    """Show a policy, or random actions, on TASK: in the viewer, or as a .gif where there is no display."""
    check_task_name(task, TASK_ARGUMENT)
    if out is not None:
        check_target(out, FILMS)
    in_viewer = out is None and has_display()
    if not in_viewer:
        _check_film(seconds, width, height)
        choose_renderer()
    from porse.film import Shot, check_mp4, random_actor, write_film
    from porse.film import view as open_viewer
    from porse.tasks import make_task
    from porse.training.actor import policy_actor

    if out is not None and out.suffix.lower() == ".mp4":
        check_mp4()
    shown = make_task(task, 1, seed)
    actor = random_actor(shown)
    if checkpoint:
        # The networks of a preset are those of the task that is shown, whatever the file's own task is.
        where = path or params_file(checkpoint)
        document = load_document(where)
        params = parse_params(
            {**document, "task": task} if isinstance(document, dict) else document,
            str(where),
            presets_root(where.parent),
        )
        actor = policy_actor(
            shown, winners_policy(checkpoint, params) if checkpoint.is_dir() else checkpoint, params.train
        )
    if in_viewer:
        open_viewer(shown, actor, seconds)
        return
    target = out or Path(f"{shown.NAME}.gif")
    write_film(target, shown, actor, seconds, Shot(width, height, view))
    echo(f"{target}: {shown.NAME}, {seconds:g} s")
