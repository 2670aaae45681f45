"""`porse init DIR`: a project of one's own, outside the repository of this one, that uses the package as it is installed."""

import shutil
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import click

from porse.config import load_document, parse_params
from porse.documents import edited_yaml
from porse.errors import PorseError
from porse.pipeline import write_pipeline
from porse.printing import echo

STARTER = Path(__file__).with_name("starter")
"""The task of a new project, and the list of files that it gets of this one."""

_CARRIED = Path(__file__).with_name("project")
"""Where a wheel has these files; a checkout has them at its root."""

_TASK = "my_tasks.cart:CartPole"


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(file_okay=False, path_type=Path))
def init(folder: Path) -> None:
    """Start a project of your own in DIR: pipeline, prompts, parameters and a task. It uses the installed package."""
    make_project(folder)
    echo(f"{folder}: a project that trains {_TASK}, without a model and without a network")
    echo(f"next: cd {folder}, then run porse demo (a minute) or porse repro; its README.md says more")


def make_project(folder: Path) -> None:
    """Makes a project in `folder`, a Git and DVC repository: whole, or not at all.

    Raises:
        PorseError: something is there already, Git or DVC refuses, or the files of this project are not as they should be.
    """
    if folder.exists() and any(folder.iterdir()):
        raise PorseError(
            f"expected an empty folder, or none, at {folder}, found something in it; name another, or empty it"
        )
    parent = folder.resolve().parent
    parent.mkdir(parents=True, exist_ok=True)
    # Beside its place, so that Git and DVC find the same around it.
    with tempfile.TemporaryDirectory(prefix=".porse-init-", dir=parent) as name:
        made = Path(name)
        _fill(made)
        folder.mkdir(exist_ok=True)
        for path in made.iterdir():
            shutil.move(path, folder / path.name)


def _fill(folder: Path) -> None:
    """Makes a project in an empty folder."""
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
    for name, edit in (("params.yaml", _train_own_task), ("dvc.yaml", partial(_depend_on_own_task, folder))):
        text = (folder / name).read_text(encoding="utf-8")
        (folder / name).write_text(edited_yaml(text, str(source / name), edit), encoding="utf-8")
    params = parse_params(load_document(folder / "params.yaml"), str(source / "params.yaml"), folder)
    write_pipeline(folder, params)


def _train_own_task(document: Any) -> None:
    document |= {"task": _TASK, "generator": "grammar"}


def _depend_on_own_task(folder: Path, document: Any) -> None:
    resolve = document["stages"]["resolve"]
    # The package is not a file of the project: what it is, resolve finds out each time.
    resolve["deps"] = [*(dep for dep in resolve["deps"] if (folder / dep).exists()), "my_tasks"]
    resolve.insert([*resolve].index("outs"), "always_changed", True)


def _copy(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    if source.is_dir():
        shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))
    else:
        shutil.copyfile(source, target)


def _call(where: Path, *command: str) -> None:
    try:
        done = subprocess.run(command, cwd=where, capture_output=True, text=True)
    except FileNotFoundError:
        raise PorseError(f"expected {command[0]} on the PATH, found none; install it and try again") from None
    if done.returncode:
        raise PorseError(
            f"expected `{' '.join(command[-3:])}` to work in {where}, found: {' '.join(done.stderr.split())}; fix that first"
        )
