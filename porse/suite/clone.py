"""The clone that an entry runs in: the project's files in a repository of their own, so that nothing else is touched.

Three things are the project's own, through links: the environment, the recorded replies, and `.porse/` with the open
requests, so that `PORSE_LLM_MODE=record` and `batch` work in a suite as they do without one. DVC's cache is shared too:
what one entry has computed, no other one computes again.
"""

import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from porse.config import load_params
from porse.documents import render_yaml
from porse.errors import PorseError
from porse.pipeline import write_pipeline
from porse.suite.resolve import REPLIES

_LINKED = (".venv", REPLIES, ".porse")
DVC = (sys.executable, "-m", "dvc")
"""DVC of the environment that this runs in."""


def copy_files(files: Sequence[str], source: Path, target: Path) -> None:
    """Copies files, named relative to `source`, into the folder `target`; a link stays a link."""
    for name in files:
        path = target / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        shutil.copy(source / name, path, follow_symlinks=False)


def new_clone(work: Path, root: Path) -> None:
    """Makes an empty repository at `work`, in place of what is there, with the DVC cache of the project at `root`.

    Raises:
        PorseError: Git or DVC refuses.
    """
    if work.exists():
        shutil.rmtree(work)
    new_repository(work)
    call(work, *DVC, "cache", "dir", "--local", call(root, *DVC, "cache", "dir"))


def new_repository(work: Path) -> None:
    """Makes an empty repository of Git and DVC at `work`.

    Raises:
        PorseError: Git or DVC refuses.
    """
    work.mkdir(parents=True, exist_ok=True)
    call(work, "git", "init", "--quiet")
    call(work, *DVC, "init", "--quiet")


def dvc_cache(root: Path) -> Path | None:
    """Returns DVC's cache of the project at `root`, None where DVC does not say it."""
    done = subprocess.run([*DVC, "cache", "dir"], cwd=root, capture_output=True, text=True)
    return root / done.stdout.strip() if not done.returncode else None


def fill_clone(work: Path, files: Sequence[str], source: Path, root: Path, params: dict[str, Any]) -> None:
    """Puts the project's files, links and an entry's parameters into the clone; what a run wrote there stays.

    Args:
        work: the clone.
        files: the tracked files, relative to `source`.
        source: where they are.
        root: the project's root, for the links.
        params: the document of the entry's `params.yaml`.
    """
    copy_files(files, source, work)
    for name in _LINKED:
        (work / name).unlink(missing_ok=True)
        (work / name).symlink_to(root / name)
    path = work / "params.yaml"
    path.write_text(render_yaml(params), encoding="utf-8")
    write_pipeline(work, load_params(path, work))


def call(where: Path, *command: str) -> str:
    """Returns what a command prints that is run in the folder `where`.

    Raises:
        PorseError: it fails.
    """
    done = subprocess.run(command, cwd=where, capture_output=True, text=True)
    if done.returncode:
        raise PorseError(
            f"expected `{' '.join(command)}` to work in {where}, found: {' '.join(done.stderr.split())}; fix that first"
        )
    return done.stdout.strip()
