"""`porse init DIR`: a project of one's own, outside the repository of this one, that uses the package as it is installed."""

import shutil
import subprocess
import sys
from pathlib import Path

import click

from porse.config import load_params
from porse.errors import PorseError
from porse.pipeline import write_pipeline
from porse.printing import echo

STARTER = Path(__file__).with_name("starter")
"""The task of a new project, and the list of files that it gets of this one."""

_CARRIED = Path(__file__).with_name("project")
"""Where a wheel has these files; a checkout has them at its root."""

_TASK = "my_tasks.cart:CartPole"
_CHANGED = {
    "params.yaml": (
        ("\ntask: Quadcopter\n", f"\ntask: {_TASK}\n"),
        ("\ngenerator: model\n", "\ngenerator: grammar\n"),
    ),
    # The package is not a file of the project: what it is, resolve finds out each time.
    "dvc.yaml": (
        ("      - porse\n", "      - my_tasks\n"),
        ("    outs:\n      - inputs/begin", "    always_changed: true\n    outs:\n      - inputs/begin"),
    ),
}
"""Texts of this project that are others in a new one."""


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(file_okay=False, path_type=Path))
def init(folder: Path) -> None:
    """Start a project of your own in DIR: pipeline, prompts, parameters and a task. It uses the installed package."""
    make_project(folder)
    echo(f"{folder}: a project that trains {_TASK}, without a model and without a network")
    echo(f"next: cd {folder}, then run porse demo (a minute) or porse repro; its README.md says more")


def make_project(folder: Path) -> None:
    """Makes a project in `folder`, a Git and DVC repository.

    Raises:
        PorseError: something is there already, or Git or DVC refuses.
    """
    if folder.exists() and any(folder.iterdir()):
        raise PorseError(
            f"expected an empty folder, or none, at {folder}, found something in it; name another, or empty it"
        )
    folder.mkdir(parents=True, exist_ok=True)
    inside = subprocess.run(["git", "rev-parse", "--git-dir"], cwd=folder, capture_output=True).returncode == 0
    if not inside:
        _call(folder, "git", "init", "--quiet")
    _call(folder, sys.executable, "-m", "dvc", "init", "--quiet", *(["--subdir"] if inside else []))
    source = _CARRIED if _CARRIED.is_dir() else Path(__file__).resolve().parents[1]
    for name in (STARTER / "files.txt").read_text(encoding="utf-8").split():
        _copy(source / name, folder / name)
    tasks = folder / "my_tasks"
    tasks.mkdir()
    _copy(STARTER / "cart.py.txt", tasks / "cart.py")
    _copy(STARTER / "cart.xml", tasks / "cart.xml")
    _copy(STARTER / "README.md", folder / "README.md")
    _copy(STARTER / "gitignore.txt", folder / ".gitignore")
    for name, changes in _CHANGED.items():
        _change(folder / name, changes)
    write_pipeline(folder, load_params(folder / "params.yaml", folder))


def _copy(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    if source.is_dir():
        shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))
    else:
        shutil.copyfile(source, target)


def _change(path: Path, changes: tuple[tuple[str, str], ...]) -> None:
    text = path.read_text(encoding="utf-8")
    for before, after in changes:
        if text.count(before) != 1:
            raise PorseError(
                f"expected {before.strip()!r} once in {path.name} of the package, found it {text.count(before)} times; the "
                "installation is damaged, or the checkout was changed: install porse again"
            )
        text = text.replace(before, after)
    path.write_text(text, encoding="utf-8")


def _call(where: Path, *command: str) -> None:
    try:
        done = subprocess.run(command, cwd=where, capture_output=True, text=True)
    except FileNotFoundError:
        raise PorseError(f"expected {command[0]} on the PATH, found none; install it and try again") from None
    if done.returncode:
        raise PorseError(
            f"expected `{' '.join(command[-3:])}` to work in {where}, found: {' '.join(done.stderr.split())}; fix that first"
        )
