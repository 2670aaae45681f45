"""The `dvc.yaml` of each iteration, as a function of the parameters.

DVC writes a lock file anew after every stage: one file for all iterations would cost a run a time that grows with the
square of their number.
"""

import shutil
from pathlib import Path
from typing import Any

from porse.config import Params
from porse.documents import read_yaml
from porse.errors import ParamsError
from porse.prompts import render
from porse.task_names import is_own, own_place

FOLDER = "iterations"


def lock_files(root: Path) -> list[Path]:
    """Returns the paths of a run's locks: that at its root, which need not be there, and those of its iterations in their order."""
    inside = (root / FOLDER).glob("*/dvc.lock")
    return [root / "dvc.lock", *sorted(inside, key=lambda path: (len(path.parent.name), path.parent.name))]


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
    """Writes what differs, removes the folders of iterations that are no more, and returns what it did, in lines.

    Raises:
        PorseError: the template in `iterations/` is missing or wrong.
    """
    did = []
    for path, text in pipeline_files(root, params).items():
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
            "params.yaml say, found it out of date; run `porse pipeline`, which writes it, and then `dvc repro` again"
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


def _left_over(root: Path, params: Params) -> list[Path]:
    """Returns the folders of iterations that the parameters do not have."""
    wanted = {str(entry.n) for entry in params.iterations}
    return sorted(path.parent for path in (root / FOLDER).glob("*/dvc.yaml") if path.parent.name not in wanted)
