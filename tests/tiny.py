"""Tiny projects: a copy of this one with parameters that make `dvc repro` a matter of seconds. For tests."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import yaml

from porse.config import load_document, load_params
from porse.inputs.resolve import resolve_inputs
from porse.pipeline import write_pipeline

ROOT = Path(__file__).resolve().parent.parent
BIN = Path(sys.executable).parent
COPIED = (
    "porse", "stages", "prompts", "presets", "functions", "dvc.yaml", "requirements.lock", ".dvcignore", ".gitignore",
    "iterations/dvc.yaml.jinja",
)  # fmt: skip
QUIET = {"DVC_NO_ANALYTICS": "1", "GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_SYSTEM": os.devnull}


def committed_params() -> dict[str, Any]:
    return yaml.safe_load((ROOT / "params.yaml").read_text())


def make_project(project: Path, params: dict[str, Any], venv: Path) -> Path:
    """Makes a Git and DVC repository in `project` with these parameters, no replies, and `venv` as its `.venv`."""
    project.mkdir(parents=True)
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, project / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            (project / name).parent.mkdir(exist_ok=True)
            shutil.copy(source, project / name)
    (project / "params.yaml").write_text(yaml.safe_dump(params, sort_keys=False))
    write_pipeline(project, load_params(project / "params.yaml", project))
    (project / "llm_cache").mkdir()
    (project / "llm_cache" / "refreshed.txt").touch()
    (project / ".venv").symlink_to(venv)
    run(project, "git", "init", "-q")
    dvc(project, "init", "-q")
    # The templates that `plots` of dvc.yaml names.
    shutil.copytree(ROOT / ".dvc" / "plots", project / ".dvc" / "plots", dirs_exist_ok=True)
    return project


def write_inputs(project: Path) -> None:
    """Writes what stage `resolve` writes, for a folder with `porse/` and `stages/` in it but without a pipeline."""
    (project / "inputs").mkdir(exist_ok=True)
    for name, inputs in resolve_inputs(project, load_document(project / "params.yaml"), "params.yaml").items():
        (project / "inputs" / f"{name}.json").write_text(inputs.render())


def run(
    where: Path, *command: str, check: bool = True, timeout_s: float = 280, **environment: str
) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        command,
        cwd=where,
        env={**os.environ, **QUIET, **environment},
        capture_output=True,
        text=True,
        timeout=timeout_s,
    )
    assert not check or done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done


def dvc(
    where: Path, *command: str, check: bool = True, timeout_s: float = 280, **environment: str
) -> subprocess.CompletedProcess[str]:
    return run(where, str(BIN / "dvc"), *command, check=check, timeout_s=timeout_s, **environment)
