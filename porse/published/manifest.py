"""What a published run consists of: which files there may be, how large, and each of them by its content.

`manifest.json` names every file with its size and its SHA-256, and carries an id of all that it says: a byte that changed in any
file, this one included, is noticed. Names that are no names of such files are refused before anything is opened.
"""

import hashlib
import json
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from porse import paths
from porse.errors import PorseError
from porse.identity import content_id

FOLDER = Path("published")
"""Published runs of a project, a folder each."""

MANIFEST = "manifest.json"
FORMAT = 1

OUTPUTS, OUTPUTS_FILE = "outputs", "outputs.dvc"
"""What the stages left, which `dvc pull` brings beside the run, and the file by which DVC knows it. Git holds the file alone."""

NAME = re.compile(r"[a-z0-9]([a-z0-9-]{0,58}[a-z0-9])?")
"""The name of a published run."""

MOST_GIT_BYTES = 5 * 2**20
"""Of a run that is published here."""

MOST_FILES, MOST_BYTES, MOST_FILE_BYTES = 20_000, 256 * 2**20, 64 * 2**20
"""Of any run that is read, ours or somebody else's."""

MOST_MANIFEST_BYTES = 4 * 2**20

SHA256 = re.compile(r"[0-9a-f]{64}")

_PART = r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}"
_FILES = re.compile(
    "|".join(
        (
            r"card\.md",
            r"report\.html",
            r"params\.yaml",
            r"metrics\.json",
            r"dvc\.lock",
            r"outputs\.dvc",
            r"logs/environment\.json",
            rf"iterations/{_PART}/dvc\.lock",
            rf"presets/{_PART}\.yaml",
            rf"inputs/{_PART}\.json",
            rf"results/{_PART}\.parquet",
            rf"run/{_PART}/start/{_PART}\.parquet",
            rf"run/{_PART}/start/policies/{_PART}\.safetensors",
            r"llm_cache/refreshed\.txt",
            r"llm_cache/[0-9a-f]{2}/[0-9a-f]{64}\.json",
            rf"functions/{_PART}/(reward|mapping)-[0-9]{{1,4}}\.py",
            rf"code/({_PART}/){{0,9}}{_PART}",
        )
    )
)
_NEEDED = ("card.md", "report.html", "params.yaml", "metrics.json", "dvc.lock")
_WORD = re.compile(r"[A-Za-z0-9._/+-]{1,300}")
_VERSION = re.compile(r"[A-Za-z0-9.+-]{0,64}")
_CHUNK = 2**20


@dataclass(frozen=True)
class File:
    """A file of a published run: SHA-256 and size in bytes."""

    sha256: str
    size: int


@dataclass(frozen=True)
class Manifest:
    """What a published run says of itself.

    Attributes:
        program: version of the package that published it, and the commit that the run's code is of; empty where it is of none.
        files: every file but the manifest, by its name.
        left_out: outputs that were too large, or not to be had; those that `dvc pull` brings are among them.
    """

    program: Mapping[str, str]
    files: Mapping[str, File]
    left_out: tuple[str, ...]

    def render(self) -> bytes:
        """Returns the bytes of the file."""
        said = {
            "format": FORMAT,
            "program": {**self.program},
            "files": {name: {"sha256": file.sha256, "size": file.size} for name, file in self.files.items()},
            "left_out": [*self.left_out],
        }
        return (json.dumps({**said, "id": content_id("published-run", said)}, indent=1, sort_keys=True) + "\n").encode()


def is_allowed(name: str) -> bool:
    """Returns whether a published run may have a file of that name."""
    return _FILES.fullmatch(name) is not None


def make_manifest(folder: Path, program: Mapping[str, str], left_out: tuple[str, ...]) -> Manifest:
    """Returns the manifest of the files that are in a folder.

    Raises:
        PorseError: one of them has no place in a published run.
    """
    files = {name: _hashed(folder / name, name) for name in sorted({*_scanned(folder)} - {MANIFEST})}
    return _checked(Manifest(program, files, left_out), str(folder))


def read_manifest(folder: Path) -> Manifest:
    """Returns the manifest of the published run in a folder, without a look at its other files.

    Raises:
        PorseError: it is missing, or is not what was published.
    """
    path = folder / MANIFEST
    try:
        data = _read(path, MANIFEST, MOST_MANIFEST_BYTES)
    except FileNotFoundError:
        raise PorseError(
            f"expected a published run in {folder}, found no {MANIFEST} there; `porse published` lists those of this project"
        ) from None
    return parse_manifest(data, str(path))


def parse_manifest(data: bytes, where: str) -> Manifest:
    """Returns the manifest in the bytes of its file, which `where` names in errors.

    Raises:
        PorseError: they are not those that `Manifest.render` makes, or name a file that has no place in a published run.
    """
    try:
        document = json.loads(data)
        if document["format"] != FORMAT:
            raise PorseError(
                f"expected a published run of format {FORMAT}, found format {document['format']!r} in {where}; take the version "
                "of porse that published it, or a newer one"
            )
        files = {str(name): File(str(each["sha256"]), each["size"]) for name, each in document["files"].items()}
        manifest = Manifest(dict(document["program"]), files, tuple(document["left_out"]))
        whole = manifest.render() == data
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        whole = False
    if not whole:
        raise refused(where, "the manifest that was published", "another text")
    return _checked(manifest, where)


def check_files(folder: Path, manifest: Manifest) -> None:
    """Checks that the files in a folder are those of the manifest, all of them and no others, byte for byte.

    Raises:
        PorseError: one is not; it is named.
    """
    found = {*_scanned(folder)} - {MANIFEST}
    for name in sorted(found ^ {*manifest.files}):
        raise refused(
            str(folder / name),
            "the files that the manifest names",
            "one that it does not name" if name in found else "none of that name",
        )
    for name, file in manifest.files.items():
        if _hashed(folder / name, name) != file:
            raise refused(str(folder / name), "the bytes that were published", "others")


def refused(where: str, expected: str, found: str) -> PorseError:
    """Returns the error that a published run is refused with; `where` names the file."""
    return PorseError(
        f"refused: expected {expected} at {where}, found {found}; take the published run anew from where it came from"
    )


def open_plain(path: Path, name: str) -> BinaryIO:
    """Returns a file, opened for reading, that is a plain one.

    Raises:
        PorseError: it is a link, a folder, a device; `name` names it.
    """
    try:
        return paths.open_plain(path)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise refused(name, "a plain file", f"one that cannot be opened so ({error.strerror})") from None


def _checked(manifest: Manifest, where: str) -> Manifest:
    names = [*manifest.files]
    for name in names:
        if not is_allowed(name):
            raise refused(where, "names of files that a published run may have", repr(name[:200]))
    counts = Counter(map(str.lower, names))
    twice = next((name for name in names if counts[name.lower()] > 1), None)
    if twice:
        raise refused(where, "names that differ in more than case", repr(twice))
    for name, file in manifest.files.items():
        if not SHA256.fullmatch(file.sha256) or type(file.size) is not int or not 0 <= file.size <= MOST_FILE_BYTES:
            raise refused(where, f"a hash and a size of at most {MOST_FILE_BYTES} bytes for {name}", repr(file))
    total = sum(file.size for file in manifest.files.values())
    if len(names) > MOST_FILES or total > MOST_BYTES:
        raise refused(
            where,
            f"at most {MOST_FILES} files of {MOST_BYTES} bytes together",
            f"{len(names)} files of {total} bytes",
        )
    for name in _NEEDED:
        if name not in manifest.files:
            raise refused(where, f"{name} among the files", "none")
    if not all(isinstance(text, str) and _WORD.fullmatch(text) for text in manifest.left_out):
        raise refused(where, "paths of outputs that were left out", "something else")
    program = {**manifest.program}
    if {*program} != {"porse", "commit"} or not all(map(_VERSION.fullmatch, map(str, program.values()))):
        raise refused(where, "the version and the commit of a program", "something else")
    return manifest


def _scanned(folder: Path) -> Iterator[str]:
    """Yields the names of all files below a folder, none of which may be a link; not those that `dvc pull` brings."""
    todo, count = [""], 0
    while todo:
        below = todo.pop()
        with os.scandir(folder / below) as entries:
            for entry in entries:
                name = f"{below}{entry.name}"
                count += 1
                if count > 2 * MOST_FILES:
                    raise refused(str(folder), f"at most {MOST_FILES} files", "more")
                if name == OUTPUTS:
                    continue
                if entry.is_symlink() or not (entry.is_dir() or entry.is_file()):
                    raise refused(str(folder / name), "plain files and folders", "a link or something else")
                if entry.is_dir():
                    if name.count("/") > 10:
                        raise refused(str(folder / name), "folders that are at most ten deep", "a deeper one")
                    todo.append(f"{name}/")
                elif name == MANIFEST or is_allowed(name):
                    yield name
                else:
                    raise refused(str(folder / name), "only files that a published run may have", "another one")


def _hashed(path: Path, name: str) -> File:
    digest, size = hashlib.sha256(), 0
    with open_plain(path, name) as file:
        while block := file.read(_CHUNK):
            digest.update(block)
            size += len(block)
            if size > MOST_FILE_BYTES:
                raise refused(name, f"at most {MOST_FILE_BYTES} bytes", "more")
    return File(digest.hexdigest(), size)


def _read(path: Path, name: str, most: int) -> bytes:
    with open_plain(path, name) as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise refused(name, f"at most {most} bytes", "more")
    return data
