"""Runs at tiny size in this process (`porse.iteration`), and what a run left, wherever it was made. For tests."""

import hashlib
from pathlib import Path
from typing import Any

import yaml

from porse.config import load_params
from porse.generation.functions import Check
from porse.iteration import OUTPUTS, Place, run
from tiny import ROOT


def run_at_once(folder: Path, document: dict[str, Any], check: Check, cache: Path | None = None) -> list[str]:
    """Makes `folder` with these parameters and the outputs of their run; returns what was said."""
    folder.mkdir(parents=True)
    (folder / "params.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
    said: list[str] = []
    run(
        load_params(folder / "params.yaml"),
        Place(folder, ROOT / "prompts", cache or folder / "llm_cache"),
        check,
        said.append,
    )
    return said


def outputs(folder: Path) -> dict[str, str]:
    """Returns a hash of every output of the run in a folder, by the path that `dvc.yaml` gives it."""
    stages = [place for place in folder.glob("run/*/*") if place.is_dir()]
    places = [*stages, *(folder / name for name in OUTPUTS if name != "run")]
    return {str(place.relative_to(folder)): _hash(place) for place in places}


def _hash(place: Path) -> str:
    files = sorted(path for path in place.rglob("*") if path.is_file()) if place.is_dir() else [place]
    digest = hashlib.sha256()
    for path in files:
        content = path.read_bytes()
        digest.update(f"{path.relative_to(place)}\n{len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()
