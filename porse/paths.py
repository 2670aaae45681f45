"""Paths: where a file can be written, what is a plain file, and which project a command belongs to."""

import copy
import errno
import functools
import os
import stat
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, BinaryIO

import click
from click.core import ParameterSource

from porse.errors import PorseError

TASK_ARGUMENT = "the argument TASK"
"""Where a task is that was named on the command line, in errors."""


def check_target(path: Path, suffixes: Iterable[str], option: str = "--out") -> None:
    """Checks that a file can be written at `path`, before any work is done for it.

    Args:
        path: the file.
        suffixes: what its name may end with, as ".png"; case does not count.
        option: names it in errors.

    Raises:
        PorseError: its name ends otherwise, its folder is not there or is not a folder, or it cannot be written.
    """
    allowed = [*suffixes]
    if path.suffix.lower() not in allowed:
        raise PorseError(f"expected {option} to end in {' or '.join(allowed)}, found {path}; choose one of them")
    folder = path.parent
    if not folder.is_dir():
        found = "a file there" if folder.exists() else "none"
        raise PorseError(
            f"expected the folder {folder} for {option} {path}, found {found}; make it first, or name another"
        )
    if path.is_dir():
        raise PorseError(f"expected a file at {option} {path}, found a folder; name a file in it")
    if not os.access(path if path.exists() else folder, os.W_OK):
        raise PorseError(
            f"expected to be allowed to write {path}, found it read-only; name a place of your own with {option}"
        )


def open_plain(path: Path) -> BinaryIO:
    """Returns a plain file, opened for reading; it never waits, as the opening of a pipe would.

    Raises:
        OSError: there is none, or it is a link, a folder, a pipe, a device, or cannot be read.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "it is no plain file", str(path))
    return os.fdopen(descriptor, "rb")


def code_root(root: Path) -> Path:
    """Returns the folder in which the package `porse` lies that the project at `root` uses: its own, or the installed one."""
    return root if has_own_package(root) else Path(__file__).resolve().parents[1]


def has_own_package(root: Path) -> bool:
    """Returns whether a project brings the package along, as a checkout does; one of `porse init` uses the installed one."""
    return (root / "porse").is_dir()


def python_of_stages(root: Path) -> dict[str, str]:
    """Returns the environment variable that names the Python of the stages of a project that uses the installed package."""
    given = has_own_package(root) or os.environ.get("PORSE_PYTHON")
    return {} if given else {"PORSE_PYTHON": sys.executable}


def project_root(start: Path) -> Path | None:
    """Returns the nearest folder, `start` or one above it, that is a project; None where none is."""
    found = (folder for folder in (start, *start.parents) if (folder / "dvc.yaml").is_file())
    return next((folder for folder in found if (folder / "params.yaml").is_file()), None)


def at_root(command: click.Command) -> click.Command:
    """Returns a copy of a command, or of a group with all its commands, that runs at the root of the project it is in.

    Paths that are typed count from where they are typed, and defaults from the root. Where there is no project, or a
    `params.yaml` beside the user, nothing changes.
    """
    placed = copy.copy(command)
    if isinstance(placed, click.Group):
        placed.commands = {name: at_root(child) for name, child in placed.commands.items()}
    elif placed.callback is not None:
        placed.callback = _moved(placed.callback)
    return placed


def _moved(callback: Any) -> Any:
    @functools.wraps(callback)
    def run(**values: Any) -> Any:
        here = Path.cwd()
        root = project_root(here)
        if root is None or root == here or (here / "params.yaml").is_file():
            return callback(**values)
        context = click.get_current_context()
        for parameter in context.command.params:
            name = parameter.name
            if name in values and context.get_parameter_source(name) is ParameterSource.COMMANDLINE:
                values[name] = _from(here, parameter, values[name])
        os.chdir(root)
        try:
            return callback(**values)
        finally:
            os.chdir(here)

    return run


def _from(here: Path, parameter: click.Parameter, value: Any) -> Any:
    """Returns a value of the command line; a path in it counts from `here`."""
    if isinstance(value, tuple):
        return tuple(_from(here, parameter, item) for item in value)
    if isinstance(parameter.type, click.Path) and value not in (None, "-"):
        return str(here / value) if isinstance(value, str) else here / value
    return value
