"""What an entry runs with: its parameters, and the code, each with a content id."""

import hashlib
import re
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from porse.config import load_document, parse_params, resolve_document
from porse.documents import read_yaml
from porse.errors import PorseError
from porse.identity import content_id
from porse.paths import code_root, has_own_package
from porse.pipeline import FOLDER as ITERATIONS
from porse.presets import FOLDER as PRESETS
from porse.suite.plan import Entry, Suite
from porse.warm.sameness import sources

REPLIES = "llm_cache"
"""The folder of recorded replies; an entry reads the project's own."""

_PUBLISHED = "published/"
"""Published runs: a run needs none of them."""

_WRITTEN = re.compile(r"params\.yaml|metrics\.json|dvc\.lock|iterations/[^/]+/dvc\.(yaml|lock)")
"""Tracked files that differ from entry to entry."""


@dataclass(frozen=True)
class Resolved:
    """An entry with its parameters.

    Attributes:
        params: the document of its `params.yaml`.
        ids: content ids of its values and of the code, `{"params": ..., "code": ...}`.
    """

    entry: Entry
    params: dict[str, Any]
    ids: dict[str, str]


def resolve(suite: Suite, root: Path, code: str, where: str) -> list[Resolved]:
    """Returns the entries of a suite with their parameters.

    Args:
        suite: the suite.
        root: the root of the project, whose `params.yaml` they are laid over.
        code: id of the code that they run with.
        where: names the suite's file in errors.

    Raises:
        ParamsError: `params.yaml` is wrong, by itself or with an entry's overrides.
    """
    path = root / "params.yaml"
    document = load_document(path)
    parse_params(document, str(path), root)
    return [_resolve(entry, laid_over(document, suite.overrides), root, code, where) for entry in suite.entries]


def _resolve(entry: Entry, document: Mapping[str, Any], root: Path, code: str, where: str) -> Resolved:
    chosen = {"task": entry.task, "method": entry.method, "ablation": entry.ablation, "seed": entry.seed}
    params = {**laid_over(document, entry.overrides), **chosen}
    source = f"params.yaml with the overrides of {entry.name} in {where}"
    parse_params(params, source, root)
    # The preset and the sets of the method and of the ablation are values too: an edited one makes another run.
    values = resolve_document(params, source, root).document
    return Resolved(entry, params, {"params": content_id("suite-params", values), "code": code})


def laid_over(document: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a document with some values replaced: mappings are merged, everything else, lists too, is replaced."""
    result = dict(document)
    for key, value in overrides.items():
        own = result.get(key)
        if isinstance(own, Mapping) and isinstance(value, Mapping):
            result[key] = laid_over(own, value)
        else:
            result[key] = value
    return result


def tracked_files(root: Path) -> list[str]:
    """Returns the files that Git tracks below `root` and that are there, but for replies, published runs and what runs write.

    Raises:
        PorseError: `root` is no Git repository.
    """
    done = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, text=True)
    if done.returncode:
        raise PorseError(
            f"expected a Git repository in {root}, found: {' '.join(done.stderr.split())}; run from a clone's root"
        )
    names = sorted(name for name in set(done.stdout.split("\0")) - {""} if not _WRITTEN.fullmatch(name))
    return [name for name in names if not name.startswith((f"{REPLIES}/", _PUBLISHED)) and (root / name).is_file()]


def code_id(root: Path, files: Sequence[str]) -> str:
    """Returns the content id of `dvc.yaml`, of those files that it names as `deps`, or that are below one.

    The template of the iterations' `dvc.yaml` counts, too; those files themselves follow from it and the parameters.
    If the package is the installed one, its sources count. What no stage depends on, such as documentation, is not part
    of the id. Presets are not part of it: their values are in the id of an entry's parameters, and the preset of another
    task does not concern an entry. Recorded replies are not part of it: an entry that is done had all of its own, and
    recording those of the next entry changes nothing for it.

    Raises:
        PorseError: there is no `dvc.yaml` among the files.
    """
    if "dvc.yaml" not in files:
        raise PorseError(
            f"expected dvc.yaml among the tracked files of {root}, found none; run from the project's root"
        )
    stages = read_yaml(root / "dvc.yaml")["stages"].values()
    deps = {dep for stage in stages for dep in stage["deps"]} - {PRESETS} | {"dvc.yaml", ITERATIONS}
    names = [name for name in files if _below(name, deps)]
    hashes = {name: hashlib.sha256((root / name).read_bytes()).hexdigest() for name in names}
    if not has_own_package(root):
        hashes["porse"] = sources(code_root(root))
    return content_id("suite-code", hashes)


def _below(name: str, folders: set[str]) -> bool:
    return name in folders or any(str(parent) in folders for parent in Path(name).parents)
