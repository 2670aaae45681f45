"""The `dvc.yaml` of each iteration, as a function of the parameters.

DVC writes a lock file anew after every stage: one file for all iterations would cost a run a time that grows with the
square of their number.
"""

import shutil
from collections.abc import Container
from pathlib import Path
from typing import Any

from porse.config import Params
from porse.documents import parse_yaml, read_yaml, render_yaml
from porse.errors import ParamsError
from porse.prompts import render
from porse.task_names import is_own, own_place

FOLDER = "iterations"

RUN = "run"
"""The folder of the outputs of all iterations."""


def lock_files(root: Path) -> list[Path]:
    """Returns the paths of a run's locks: that at its root, which need not be there, and those of its iterations in their order."""
    inside = (root / FOLDER).glob("*/dvc.lock")
    return [root / "dvc.lock", *sorted(inside, key=lambda path: (len(path.parent.name), path.parent.name))]


def lock_entries(lock: Path) -> dict[str, Any]:
    """Returns the entries of a lock by the names of their stages; none where there is no lock.

    Raises:
        ParamsError: it is no lock as DVC writes it.
    """
    document = read_yaml(lock) if lock.is_file() else None
    if document is None:
        return {}
    try:
        entries: dict[str, Any] = document["stages"]
        files = [file for entry in entries.values() for kind in ("deps", "outs") for file in entry.get(kind) or []]
        fine = all(isinstance(file["path"], str) and isinstance(file["md5"], str) for file in files)
    except (KeyError, TypeError, AttributeError):
        fine = False
    if not fine:
        raise ParamsError(
            f"expected in {lock} the entries of stages with the paths and hashes of their files, as DVC writes a lock, found "
            "something else; run `porse repro`, which mends it"
        )
    return entries


def pipeline_files(root: Path, params: Params) -> dict[Path, str]:
    """Returns the text of each iteration's `dvc.yaml`, by its path.

    Raises:
        PorseError: the template in `iterations/` is missing or wrong.
    """
    return {
        root / FOLDER / str(entry.n) / "dvc.yaml": render(
            root / FOLDER,
            "dvc.yaml",
            n=entry.n,
            next=entry.next,
            rungs=params.rungs,
            mutate_pool=params.mutate.pool,
            fuse_pool=params.fuse.pool,
        )
        + "\n"
        for entry in params.iterations
    }


def write_pipeline(root: Path, params: Params) -> list[str]:
    """Writes what differs, removes iterations, stages and outputs that are no more, and returns what it did, in lines.

    DVC keeps the entry of a stage in its lock, and its output, after the stage has left `dvc.yaml`. The lock of a run would
    then name outputs that are not the run's, and `run`, which the last stages depend on, would hold them. What remains of a
    lock stays byte for byte. A lock that cannot be read stays as it is.

    Raises:
        PorseError: the template in `iterations/` is missing or wrong.
    """
    did = []
    files = pipeline_files(root, params)
    stages = {path: parse_yaml(text, str(path))["stages"] for path, text in files.items()}
    made = {out for own in stages.values() for stage in own.values() for out in stage["outs"]}
    for lock in lock_files(root)[1:]:
        entries = _entries(lock)
        outs = sorted({out["path"] for entry in entries.values() for out in entry.get("outs") or []} - made)
        did += [f"{out}: removed, no stage makes it any more" for out in outs if _remove_output(root, out)]
        gone = [name for name in entries if name not in stages.get(lock.with_name("dvc.yaml"), entries)]
        if gone:
            _remove_entries(lock, gone)
            did.append(f"{lock.relative_to(root)}: {', '.join(gone)} removed")
    for path, text in files.items():
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
            did.append(f"{path.relative_to(root)}: written")
    for folder in _left_over(root, params):
        shutil.rmtree(folder)
        did.append(f"{folder.relative_to(root)}: removed")
    return did


def check_pipeline(root: Path, params: Params) -> None:
    """Checks that the `dvc.yaml` of each iteration is the one of these parameters.

    Raises:
        ParamsError: one differs, is missing or is left over.
    """
    files = pipeline_files(root, params)
    stale = [path for path, text in files.items() if not path.is_file() or path.read_text(encoding="utf-8") != text]
    stale += _left_over(root, params)
    if stale:
        raise ParamsError(
            f"expected {stale[0].relative_to(root)} to be what iterations, rungs, mutate.pool and fuse.pool of "
            "params.yaml say, found it out of date; `porse pipeline` writes it, and `porse repro` does so before it runs"
        )


def check_dependency(root: Path, task: str) -> None:
    """Checks that stage `resolve` depends on the folder of a task of one's own, so that DVC notices every change in it.

    Raises:
        ParamsError: it does not.
    """
    if not is_own(task):
        return
    place = own_place(task)
    stages: Any = read_yaml(root / "dvc.yaml")["stages"]
    if place not in stages["resolve"]["deps"]:
        raise ParamsError(
            f"expected the stage resolve in dvc.yaml to depend on {place}, where task {task} is, found no such line "
            f"among its deps; add `- {place}` there, so that a change of the task is noticed"
        )


def _entries(lock: Path) -> dict[str, Any]:
    """Returns the entries of a lock; none where a kill or a merge has left something else."""
    try:
        return lock_entries(lock)
    except ParamsError:
        return {}


def _remove_entries(lock: Path, gone: Container[str]) -> None:
    document = read_yaml(lock)
    document["stages"] = {name: entry for name, entry in document["stages"].items() if name not in gone}
    partial = lock.with_name(f"{lock.name}.partial")
    partial.write_text(render_yaml(document), encoding="utf-8")
    partial.replace(lock)


def _remove_output(root: Path, out: str) -> bool:
    """Removes an output of a stage from the workspace, and returns whether it was there. DVC's cache keeps it."""
    path = root / out
    if not path.is_dir() or not path.resolve().is_relative_to((root / RUN).resolve()):
        return False
    shutil.rmtree(path)
    return True


def _left_over(root: Path, params: Params) -> list[Path]:
    """Returns the folders of iterations that the parameters do not have."""
    wanted = {str(entry.n) for entry in params.iterations}
    return sorted(path.parent for path in (root / FOLDER).glob("*/dvc.yaml") if path.parent.name not in wanted)
