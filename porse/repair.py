"""What a kill can leave in a DVC project, mended, so that `dvc repro` goes on: `porse repro`.

DVC writes two kinds of files in place, so that a kill can leave them empty or cut off: `dvc.lock`, of which it then says
that it is corrupted, and `.dvc/tmp/rwlock`, of which it says the same. A lock is replaced by the copy that was kept when
the run was started, by the committed one, or by none; whatever it then says, DVC checks it against the files and takes
finished stages from its run cache. All else that DVC writes, it renames into place.
"""

import fcntl
import json
import re
import subprocess
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from porse.documents import parse_yaml
from porse.errors import ParamsError
from porse.pipeline import lock_files

_WAIT_S = 3.0
"""How long a DVC that is at work is waited for; it holds its lock while it writes, and not while a stage runs."""

_HASH = re.compile(r"[0-9a-f]{32}(\.dir)?")
_CONFLICT = "<<<<<<< "


def repair(root: Path) -> list[str]:
    """Mends what a killed DVC left in the project at `root`, keeps copies of its locks, and returns what it mended.

    Nothing is touched while another DVC writes there.
    """
    state = root / ".dvc" / "tmp"
    state.mkdir(parents=True, exist_ok=True)
    with _held(state / "lock") as mine:
        if not mine:
            return []
        did = [*_mend_rwlock(state / "rwlock"), *_mend_locks(root, state / "porse" / "locks")]
        _keep_locks(root, state / "porse" / "locks")
        return did


def at_work(root: Path) -> bool:
    """Returns whether a DVC is at work on a stage of the project at `root`."""
    try:
        return any(_living(root / ".dvc" / "tmp" / "rwlock"))
    except (OSError, ValueError, AttributeError, TypeError, KeyError):
        # There is none, or DVC is just writing it: it is asked again by whoever wants to know.
        return False


def is_whole(text: str) -> bool:
    """Returns whether a lock's text is all that DVC wrote: entries of stages, the last line of the last one included."""
    if not text.endswith("\n"):
        return False
    try:
        document = parse_yaml(text, "a lock")
    except ParamsError:
        return False
    stages = document.get("stages") if isinstance(document, dict) else None
    return isinstance(stages, dict) and bool(stages) and all(_is_whole_stage(stage) for stage in stages.values())


def _is_whole_stage(stage: Any) -> bool:
    if not isinstance(stage, dict) or "cmd" not in stage or not isinstance(stage.get("outs"), list):
        return False
    return all(_is_whole_file(entry) for entry in [*(stage.get("deps") or []), *stage["outs"]])


def _is_whole_file(entry: Any) -> bool:
    if not isinstance(entry, dict) or not {"path", "hash", "md5", "size"} <= set(entry):
        return False
    digest = entry["md5"]
    if not isinstance(digest, str) or not _HASH.fullmatch(digest):
        return False
    return not digest.endswith(".dir") or "nfiles" in entry


def _mend_locks(root: Path, kept: Path) -> Iterator[str]:
    for path in _locks(root):
        text = path.read_text(encoding="utf-8", errors="replace")
        name = path.relative_to(root)
        # A conflict is a person's to solve.
        if is_whole(text) or _CONFLICT in text:
            continue
        for origin, found in (("the copy of it", _text(kept / name)), ("the committed one", _committed(root, name))):
            if found is not None and is_whole(found):
                _replace(path, found)
                yield f"{name} was cut off: {origin} is in its place"
                break
        else:
            path.unlink()
            yield f"{name} was cut off: removed, what was done is in DVC's run cache"


def _keep_locks(root: Path, kept: Path) -> None:
    for path in _locks(root):
        text, copy = path.read_text(encoding="utf-8"), kept / path.relative_to(root)
        if is_whole(text) and _text(copy) != text:
            copy.parent.mkdir(parents=True, exist_ok=True)
            _replace(copy, text)


def _locks(root: Path) -> list[Path]:
    return [path for path in lock_files(root) if path.is_file()]


def _committed(root: Path, name: Path) -> str | None:
    """Returns the text of a file in the last commit, None where it has none."""
    done = subprocess.run(["git", "show", f"HEAD:./{name.as_posix()}"], cwd=root, capture_output=True)
    return done.stdout.decode("utf-8", errors="replace") if done.returncode == 0 else None


def _text(path: Path) -> str | None:
    return path.read_text(encoding="utf-8") if path.is_file() else None


def _replace(path: Path, text: str) -> None:
    """Writes a file, whole or not at all."""
    partial = path.with_name(f"{path.name}.partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)


def _mend_rwlock(path: Path) -> Iterator[str]:
    """Removes lock holders whose process has ended. DVC does this itself only if it can read the file.

    A process that has ended and that nobody has waited for yet counts as ended, and so does one that got the number of
    an ended DVC.
    """
    if not path.is_file():
        return
    try:
        living = _living(path)
    except (ValueError, AttributeError, TypeError, KeyError):
        path.unlink()
        yield f"{path.name} of DVC was cut off: removed"
        return
    if living and not any(living):
        path.unlink()
        yield f"{path.name} of DVC named a process that has ended: removed"


def _living(path: Path) -> list[bool]:
    """Returns for each process that holds files of the project, by DVC's list, whether it lives."""
    held = json.loads(path.read_text(encoding="utf-8"))
    holders = [*held.get("write", {}).values(), *(entry for each in held.get("read", {}).values() for entry in each)]
    return [_lives(holder) for holder in holders]


def _lives(holder: Mapping[str, Any]) -> bool:
    # Imported here, as DVC does: who only wants to read a lock needs no list of processes.
    import psutil

    try:
        process = psutil.Process(int(holder["pid"]))
        if process.status() == psutil.STATUS_ZOMBIE:
            return False
        command = " ".join(process.cmdline())
    except psutil.NoSuchProcess:
        return False
    except psutil.AccessDenied:
        return True
    return "dvc" in command or str(holder["cmd"]).split(" ")[0] in command


@contextmanager
def _held(path: Path) -> Iterator[bool]:
    """Holds DVC's own lock file while the block runs, and says whether it could be had."""
    with path.open("a", encoding="utf-8") as file:
        deadline = time.monotonic() + _WAIT_S
        while True:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if time.monotonic() > deadline:
                    yield False
                    return
                time.sleep(0.1)
            else:
                yield True
                return
