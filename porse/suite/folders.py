"""Where a suite keeps what: `.porse/suites/NAME/`, its lock, and the small JSON files that say how far it is."""

import fcntl
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from porse.errors import PorseError


@dataclass(frozen=True)
class Clone:
    """Where an entry runs.

    Attributes:
        work: the clone.
        current: which entry it belongs to: its name and its ids.
    """

    work: Path
    current: Path


@dataclass(frozen=True)
class Folders:
    """The paths of one suite.

    Attributes:
        suite: the folder that holds all of them.
    """

    suite: Path

    @property
    def source(self) -> Path:
        """The tracked files of the project, as they were when the suite was last started."""
        return self.suite / "source"

    @property
    def clone(self) -> Clone:
        """Where entries run one after the other."""
        return Clone(self.suite / "work", self.suite / "current.json")

    def clone_of(self, entry: str) -> Clone:
        """Returns where an entry runs that others run beside."""
        folder = self.suite / "clones" / entry
        return Clone(folder / "work", folder / "current.json")

    def begun(self, entry: str) -> Any:
        """Returns name and ids of an entry as they were when it last began, None where its clone is gone or another's."""
        records = (read_json(clone.current) for clone in (self.clone, self.clone_of(entry)))
        return next((record for record in records if record is not None and record["entry"] == entry), None)

    @property
    def lock(self) -> Path:
        """Locked while the suite runs."""
        return self.suite / "lock"

    def log(self, entry: str) -> Path:
        """Returns the file that the output of an entry's last `dvc repro` is in."""
        return self.suite / "logs" / f"{entry}.log"

    def result(self, entry: str) -> Path:
        """Returns the folder of what came out of an entry: `done.json` is in it, or `failed.json`."""
        return self.suite / "results" / entry

    def earlier(self, entry: str) -> Path:
        """Returns the folder of what came out of an entry before it ran again."""
        return self.suite / "earlier" / entry


def folders_of(name: str, root: Path) -> Folders:
    """Returns the paths of the suite of that name in the project at `root`."""
    return Folders(root / ".porse" / "suites" / name)


@contextmanager
def locked(path: Path) -> Iterator[int]:
    """Holds a lock file while the block runs, and gives its descriptor.

    The system lets go of it when this process has ended, however it ends, and every process that got the descriptor.

    Raises:
        PorseError: another process holds it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise PorseError(
                f"expected that nobody else runs this suite, found {path} locked; wait until that run ends, or end it"
            ) from None
        yield file.fileno()


def is_locked(path: Path) -> bool:
    """Returns whether a process holds the lock file."""
    if not path.exists():
        return False
    with path.open(encoding="utf-8") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Writes a JSON file, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.partial")
    partial.write_text(json.dumps(value, indent=2, sort_keys=True) + "\n", encoding="utf-8")
    partial.replace(path)


def read_json(path: Path) -> Any:
    """Returns what a JSON file holds, None where there is no such file."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
