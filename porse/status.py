"""`porse status`: where the pipeline is, what is left, and how to go on.

A stage is done when its outputs are there, and its lock names what its inputs and the outputs of the stages before it are now.
Nothing is hashed but the inputs, so that the answer takes a second; `dvc status` looks at every byte.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from porse.config import load_document, parse_params
from porse.errors import PorseError
from porse.inputs.resolve import resolve_inputs
from porse.pipeline import lock_entries, lock_files
from porse.plan import EVALUATE, Planned, planned
from porse.printing import echo
from porse.repair import at_work

HOW_ON = {
    "finished": "`porse results` prints what came out, and `porse report` writes a page about it",
    "running": "wait for it; Ctrl-C where it runs stops it, and `porse repro` then goes on",
    "stopped": "`porse repro` goes on with the stage that is named as next",
    "not started": "`porse repro` starts it",
}


@dataclass(frozen=True)
class Status:
    """Where a pipeline is.

    Attributes:
        state: running, stopped, finished or not started.
        done: stages that are done.
        stages: stages in all.
        next: the stage that is at work or comes next; empty where all are done.
        epochs_done: epochs of the stages that are done; those of the evaluation are not counted.
        epochs: epochs of all stages, without those either.
    """

    state: str
    done: int
    stages: int
    next: str
    epochs_done: int
    epochs: int


def status_of(root: Path) -> Status:
    """Returns where the pipeline in `root` is.

    Raises:
        PorseError: there is no pipeline, or its parameters are wrong.
    """
    if not (root / "dvc.yaml").is_file():
        raise PorseError(
            f"expected dvc.yaml in {root.resolve()} or a folder above it, found none; run from a folder of the project"
        )
    document = load_document(root / "params.yaml")
    params = parse_params(document, str(root / "params.yaml"), root)
    now = {
        f"inputs/{name}.json": hashlib.md5(inputs.render().encode(), usedforsecurity=False).hexdigest()
        for name, inputs in resolve_inputs(root, document, "params.yaml").items()
    }
    stages, locks = planned(params), _locks(root)
    done: list[Planned] = []
    for stage in stages:
        if stage.name == "resolve":
            is_done = all((root / path).is_file() for path in now)
        else:
            is_done = _is_done(root, locks.get(stage.name), now)
        if not is_done:
            break
        done.append(stage)
    left = stages[len(done) :]
    if not left:
        state = "finished"
    elif at_work(root):
        state = "running"
    else:
        state = "stopped" if len(done) > 1 else "not started"
    return Status(
        state,
        len(done),
        len(stages),
        left[0].name if left else "",
        _searched(done),
        _searched(stages),
    )


def _searched(stages: Sequence[Planned]) -> int:
    """Returns the epochs of the search: how many the evaluation takes, only the winning lineage tells."""
    return sum(stage.epochs for stage in stages if stage.name != EVALUATE)


def status_text(found: Status) -> str:
    """Returns a status as lines for people."""
    lines = [f"{found.state}: {found.done} of {found.stages} stages, {found.epochs_done} of {found.epochs} epochs"]
    if found.next:
        lines.append(f"{'at work' if found.state == 'running' else 'next'}: {found.next}")
    return "\n".join([*lines, HOW_ON[found.state]])


def _locks(root: Path) -> dict[str, Mapping[str, Any]]:
    """Returns the entries of the locks, by the name of a stage that `dvc repro` takes."""
    found: dict[str, Mapping[str, Any]] = {}
    for path in lock_files(root):
        folder = "" if path.parent == root else f"{path.parent.relative_to(root).as_posix()}/dvc.yaml:"
        found |= {f"{folder}{name}": entry for name, entry in lock_entries(path).items()}
    return found


def _is_done(root: Path, lock: Mapping[str, Any] | None, made: dict[str, str]) -> bool:
    """Returns whether a stage is done, and adds its outputs to those that were `made`, each with its MD5."""
    if lock is None:
        return False
    # The folder `run` is made by all stages together.
    known = {dep["path"]: dep["md5"] for dep in lock.get("deps") or [] if dep["path"] != "run"}
    if any(made.get(path, md5) != md5 for path, md5 in known.items()):
        return False
    outs = {out["path"]: out["md5"] for out in lock.get("outs") or []}
    made |= outs
    return all((root / path).exists() for path in outs)


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object.")
def status(as_json: bool) -> None:
    """Print where the pipeline is, what is left, and how to go on."""
    found = status_of(Path())
    if as_json:
        echo(json.dumps({**found.__dict__, "how_on": HOW_ON[found.state]}, indent=2))
        return
    echo(status_text(found))
