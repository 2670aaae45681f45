"""What the run in a folder was made with, and whether `params.yaml` still says so: `porse results` says it where not.

DVC's locks name the inputs of each stage that ran, and the inputs hold the parameters that it read (porse/inputs). A fresh
clone has locks and no inputs: there, the committed parameters are those of the run where they give the inputs that the locks
name.
"""

import copy
import functools
import hashlib
import json
import operator
import subprocess
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

from porse.config import Params, leaves, load_document, load_params, parse_part, presets_root, resolve_document
from porse.documents import parse_yaml
from porse.errors import PorseError
from porse.inputs.resolve import resolve_inputs
from porse.pipeline import lock_entries, lock_files
from porse.printing import print_line

_SHOWN = 3
"""So many parameters that differ are named one by one."""


def params_of_run(root: Path) -> Params:
    """Returns the parameters that the run in `root` was made with; those of `params.yaml` where nothing else is known.

    Raises:
        ParamsError: `params.yaml` or a lock cannot be read, or parameters are missing, unknown or out of range.
    """
    changed = changed_parameters(root)
    if not changed:
        return load_params(root / "params.yaml", presets_root(root))
    document = _document(root)
    for name, (then, _) in changed.items():
        *sections, key = name.split(".")
        functools.reduce(operator.getitem, sections, document)[key] = then
    # Its parts were checked together when the run was made.
    return parse_part(document, f"what the run in {root} was made with, by its locks")


def changed_parameters(root: Path) -> dict[str, tuple[Any, Any]]:
    """Returns the parameters that are no longer those of the run in `root`, by name, each as (then, now).

    Only what the run's stages read counts, and of these only stages whose inputs are in the workspace, in DVC's cache, or
    follow from the committed `params.yaml`: without them nothing is known, and nothing is returned.

    Raises:
        ParamsError: `params.yaml` or a lock cannot be read.
    """
    now = dict(leaves(_document(root)))
    then: dict[str, Any] = {}
    committed = functools.cache(lambda: _committed_inputs(root))
    for path, digest in dict.fromkeys(_inputs_of_run(root)):
        text = _content(root, path, digest) or committed().get(digest)
        if text is not None:
            then |= leaves(json.loads(text)["parameters"])
    return {name: (value, now[name]) for name, value in then.items() if name in now and now[name] != value}


def _document(root: Path) -> dict[str, Any]:
    """Returns what `params.yaml` says now, with all layers."""
    where = root / "params.yaml"
    return copy.deepcopy(resolve_document(load_document(where), str(where), presets_root(root)).document)


def another_run(root: Path) -> str | None:
    """Returns a sentence that says that the results in `root` are another run's, None where nothing says so.

    Raises:
        ParamsError: `params.yaml` or a lock cannot be read.
    """
    changed = changed_parameters(root)
    if not changed:
        return None
    # What names a run comes first.
    first = [name for name in ("task", "method", "ablation", "seed") if name in changed]
    names = [*first, *(name for name in changed if name not in first)]
    said = [f"{name}: {json.dumps(changed[name][0])}" for name in names[:_SHOWN]]
    now = [f"{name}: {json.dumps(changed[name][1])}" for name in names[:_SHOWN]]
    more = f" ({len(names) - _SHOWN} more parameters differ)" if len(names) > _SHOWN else ""
    return (
        f"these results are another run's: expected {', '.join(now)}, as params.yaml says, found results of "
        f"{', '.join(said)}{more}; run `porse repro` for new ones, or undo the change in params.yaml"
    )


def warn_of_another_run(root: Path) -> None:
    """Prints a warning on standard error where the results in `root` are not those of its params.yaml.

    Raises:
        ParamsError: `params.yaml` or a lock cannot be read.
    """
    # Without a lock, as in what `porse demo` leaves, nothing says what the run was of.
    if (root / "dvc.lock").is_file() and (warning := another_run(root)):
        print_line("warning: ", str(warning), hang=0, err=True)


def _committed_inputs(root: Path) -> dict[str, bytes]:
    """Returns the inputs of all stages by their MD5, as the last commit's `params.yaml` and the code now give them."""
    done = subprocess.run(["git", "show", "HEAD:./params.yaml"], cwd=root, capture_output=True)
    if done.returncode:
        return {}
    where = "the committed params.yaml"
    try:
        inputs = resolve_inputs(root, parse_yaml(done.stdout.decode("utf-8", errors="replace"), where), where)
    except (PorseError, OSError):
        return {}
    texts = [own.render().encode() for own in inputs.values()]
    return {_md5(text): text for text in texts}


def _inputs_of_run(root: Path) -> Iterator[tuple[str, str]]:
    """Yields path and MD5 of the inputs of each stage that ran; of those that left the results last.

    A run that was stopped on its way has results of the run before it.
    """
    for path in reversed(lock_files(root)):
        for stage in lock_entries(path).values():
            for dep in stage.get("deps") or []:
                name = PurePosixPath(dep["path"])
                if name.parent.name == "inputs":
                    yield f"inputs/{name.name}", dep["md5"]


def _content(root: Path, path: str, digest: str) -> bytes | None:
    """Returns the file that had this hash when the stage ran, from the workspace or from DVC's cache."""
    for place in (root / path, root / ".dvc" / "cache" / "files" / "md5" / digest[:2] / digest[2:]):
        if place.is_file():
            content = place.read_bytes()
            if _md5(content) == digest:
                return content
    return None


def _md5(content: bytes) -> str:
    return hashlib.md5(content, usedforsecurity=False).hexdigest()
