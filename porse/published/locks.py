"""The locks of a run: what each stage read and left, by the MD5 that DVC has of it; and outputs by that MD5, wherever they are."""

import hashlib
import json
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path, PurePosixPath
from typing import Any

from porse.config import Params
from porse.documents import parse_yaml, read_yaml
from porse.errors import ParamsError
from porse.pipeline import FOLDER as ITERATIONS
from porse.pipeline import lock_files, pipeline_files
from porse.published.manifest import refused

RESOLVE, INPUTS = "resolve", "inputs"
"""The stage that writes down what each other stage reads, and the folder that it writes it to."""

_MD5 = re.compile(r"[0-9a-f]{32}(\.dir)?")
_PART = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,199}")


@dataclass(frozen=True)
class Stage:
    """One stage as a lock has it.

    Attributes:
        name: for people: `evaluate`, `2/mutate`.
        target: for `dvc repro`.
        deps: MD5 of what it read, by its path.
        outs: MD5 of what it left, by its path.
    """

    name: str
    target: str
    deps: Mapping[str, str]
    outs: Mapping[str, str]

    @property
    def kind(self) -> str:
        """The stem of the file of its inputs; empty for the stage that has none."""
        return next((PurePosixPath(path).stem for path in self.deps if path.startswith(f"{INPUTS}/")), "")

    @property
    def read(self) -> list[str]:
        """The outputs of other stages that it read, its inputs not among them."""
        return [path for path in self.deps if not path.startswith(f"{INPUTS}/")]


def read_locks(folder: Path) -> list[Stage]:
    """Returns the stages that the locks in a folder name, each after those whose outputs it reads.

    Raises:
        PorseError: a lock is missing, or is not as DVC writes it.
    """
    found: list[Stage] = []
    for path in lock_files(folder):
        inside = path.parent != folder
        try:
            document = read_yaml(path)
            for name, stage in document["stages"].items():
                found.append(
                    Stage(
                        f"{path.parent.name}/{name}" if inside else str(name),
                        f"{ITERATIONS}/{path.parent.name}/dvc.yaml:{name}" if inside else str(name),
                        _hashes(stage.get("deps") or []),
                        _hashes(stage["outs"]),
                    )
                )
        except (ParamsError, FileNotFoundError, KeyError, TypeError, ValueError, AttributeError):
            raise refused(str(path), "a lock as DVC writes it", "something else, or none") from None
    try:
        return _ordered(found)
    except CycleError:
        raise refused(str(folder / "dvc.lock"), "stages of which none waits for itself", "a circle") from None


def check_pipeline_of(stages: Sequence[Stage], params: Params, root: Path, where: Path) -> None:
    """Checks that stages and outputs are those that the project at `root` has with these parameters.

    Raises:
        PorseError: they are not; the lock is named.
    """
    texts = [(root / "dvc.yaml").read_text(encoding="utf-8"), *pipeline_files(root, params).values()]
    folders = ["", *(f"{entry.n}/" for entry in params.iterations)]
    expected: dict[str, set[str]] = {}
    for folder, text in zip(folders, texts, strict=True):
        for name, stage in parse_yaml(text, "dvc.yaml")["stages"].items():
            expected[f"{folder}{name}"] = {*_paths(stage["outs"]), *_paths(stage.get("metrics") or [])}
    found = {stage.name: {*stage.outs} for stage in stages}
    for name in sorted({*expected, *found}):
        if expected.get(name) != found.get(name):
            inside, _, _ = name.rpartition("/")
            lock = where / ITERATIONS / inside / "dvc.lock" if inside else where / "dvc.lock"
            raise refused(
                str(lock),
                f"the stages and outputs that its parameters give here, {name} among them"
                if name in expected
                else "only stages that its parameters give here",
                f"others (of {name!r}): another version's, or edited",
            )


def digest(path: Path) -> str:
    """Returns the MD5 that DVC has of a file, or of a folder: that of the sorted list of its files, with `.dir` behind it."""
    if not path.is_dir():
        return _md5(path)
    files = sorted(file.relative_to(path).as_posix() for file in path.rglob("*") if file.is_file())
    entries = [{"md5": _md5(path / name), "relpath": name} for name in files]
    text = json.dumps(entries, sort_keys=True)
    return f"{hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()}.dir"


def is_output(path: Path, md5: str) -> bool:
    """Returns whether the file or folder at `path` is, byte for byte, the output of that MD5."""
    return path.exists() and path.is_dir() == md5.endswith(".dir") and digest(path) == md5


def overlaps(one: str, other: str) -> bool:
    """Returns whether two paths are the same, or one is below the other."""
    return one == other or one.startswith(f"{other}/") or other.startswith(f"{one}/")


@dataclass(frozen=True)
class Shelf:
    """Where outputs of a run may be had without computing them.

    Attributes:
        folders: folders in which outputs lie under their paths, each with words for it.
        cache: DVC's cache, None for none.
    """

    folders: Sequence[tuple[Path, str]]
    cache: Path | None

    def fetch(self, path: str, md5: str, target: Path) -> str:
        """Copies the output of that path and MD5 to `target`, and returns from where; empty where nobody has it whole."""
        for folder, words in self.folders:
            if is_output(folder / path, md5):
                put(folder / path, target)
                return words
        if self.cache is not None and self._from_cache(md5, target):
            return "DVC's cache"
        return ""

    def _from_cache(self, md5: str, target: Path) -> bool:
        assert self.cache is not None
        stored = _stored(self.cache, md5)
        if not stored.is_file():
            return False
        if not md5.endswith(".dir"):
            put(stored, target)
        else:
            try:
                names = {str(entry["relpath"]): str(entry["md5"]) for entry in json.loads(stored.read_bytes())}
            except (ValueError, TypeError, KeyError):
                return False
            files = {name: _stored(self.cache, each) for name, each in names.items() if _MD5.fullmatch(each)}
            plain = all(all(map(_PART.fullmatch, name.split("/"))) for name in names)
            if not plain or len(files) < len(names) or not all(file.is_file() for file in files.values()):
                return False
            target.mkdir(parents=True, exist_ok=True)
            for name, file in files.items():
                put(file, target / name)
        if is_output(target, md5):
            return True
        shutil.rmtree(target) if target.is_dir() else target.unlink()
        return False


def _stored(cache: Path, md5: str) -> Path:
    return cache / "files" / "md5" / md5[:2] / md5[2:]


def put(source: Path, target: Path) -> None:
    """Copies a file or a folder to `target`, whose parents are made where they are missing."""
    target.parent.mkdir(parents=True, exist_ok=True)
    if source.is_dir():
        shutil.copytree(source, target, copy_function=shutil.copyfile, dirs_exist_ok=True)
    else:
        # copyfile, not copy: DVC may have made the source read-only, which must not travel.
        shutil.copyfile(source, target)


def _hashes(entries: Any) -> dict[str, str]:
    found = {}
    for entry in entries:
        path, md5 = entry["path"], entry["md5"]
        parts = str(path).split("/")
        if not isinstance(md5, str) or not _MD5.fullmatch(md5) or not all(map(_PART.fullmatch, parts)):
            raise ValueError(path)
        found[str(path)] = md5
    return found


def _paths(outs: Any) -> Iterator[str]:
    return (out if isinstance(out, str) else next(iter(out)) for out in outs)


def _ordered(stages: Sequence[Stage]) -> list[Stage]:
    by_name = {stage.name: stage for stage in stages}
    sorter: TopologicalSorter[str] = TopologicalSorter()
    for stage in stages:
        before = [
            other.name
            for other in stages
            if other is not stage and any(overlaps(dep, out) for dep in stage.deps for out in other.outs)
        ]
        sorter.add(stage.name, *before)
    return [by_name[name] for name in sorter.static_order()]


def _md5(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.md5(usedforsecurity=False)).hexdigest()
