"""The files that a stage's result depends on, each with its SHA-256, and which of them have changed.

A file of the package is named as in a checkout, `porse/...`, wherever the package is installed; all others lie below the root.
"""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from porse.errors import ParamsError
from porse.inputs.imports import imported_files
from porse.inputs.stages import NO_RESULT, PACKAGES, Stage
from porse.paths import code_root
from porse.presets import check_task_name
from porse.task_names import class_name, is_own, module_file

_IGNORED = frozenset({"__pycache__"})
_PACKAGE = "porse"
_TASK_NAMES = "porse/task_names.py"
"""It names the modules of all tasks; a stage imports that of the run's task."""


def stage_files(root: Path, stage: Stage, task: str, own: Sequence[str]) -> dict[str, str]:
    """Returns the SHA-256 of each file that a stage depends on, by its name, in the order of the names.

    Args:
        root: the project's root.
        stage: the stage.
        task: the task of the run; its module is a dependency, those of others are none.
        own: further folders that the stage reads.

    Raises:
        ParamsError: no task has that name, or the module of one's own is not there.
    """
    paths = _imported(root, module_file(root, stage.script))
    if "task" in stage.parameters and any(path.parts[-2:] == ("tasks", "__init__.py") for path in paths):
        paths |= task_files(root, task)
    for folder in (*stage.folders, *own, PACKAGES):
        paths |= _below(root / folder)
    names = {_name(root, path) for path in paths} - set(NO_RESULT)
    return {name: _hash(_path(root, name)) for name in sorted(names)}


def task_files(root: Path, task: str) -> set[Path]:
    """Returns the files of a task: all that is in its folder, and what its module imports.

    A scene, a mesh or a table lies beside the module that reads it. A task of the package has a folder to itself; that of
    one's own is its top-level package, and a single module has none.

    Raises:
        ParamsError: no task has that name, or the module of one's own is not there.
    """
    check_task_name(task, "params.yaml")
    module = class_name(task).partition(":")[0]
    package = module.partition(".")[0]
    home = root if is_own(task) else code_root(root)
    file = module_file(home, module)
    if not file.is_file():
        raise ParamsError(
            f"expected the module of task {task!r} at {file}, found no such file; correct its name or add it"
        )
    files = _imported(root, file, package)
    if not is_own(task):
        return files | _below(file.parent)
    return files | _below(root / package) if "." in module else files


def changed_files(root: Path, files: Mapping[str, str]) -> list[str]:
    """Returns those of the files that no longer have the SHA-256 that is named for them, or are gone."""
    paths = {name: _path(root, name) for name in files}
    return [name for name, path in paths.items() if not path.is_file() or _hash(path) != files[name]]


def _imported(root: Path, start: Path, *own: str) -> set[Path]:
    code = code_root(root)
    homes = {**dict.fromkeys(own, root), _PACKAGE: code}
    return imported_files(start, homes, frozenset({code / _TASK_NAMES}))


def _name(root: Path, path: Path) -> str:
    code = code_root(root)
    return path.relative_to(code if path.is_relative_to(code / _PACKAGE) else root).as_posix()


def _path(root: Path, name: str) -> Path:
    return (code_root(root) if name.startswith(f"{_PACKAGE}/") else root) / name


def _below(path: Path) -> set[Path]:
    """Returns a file, or all files of a folder, without what Python or an editor leaves there."""
    if path.is_file():
        return {path}
    found = {file for file in path.rglob("*") if file.is_file()}
    return {
        file
        for file in found
        if not any(part in _IGNORED or part.startswith(".") for part in file.relative_to(path).parts)
    }


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
