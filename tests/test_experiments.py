"""Runs beside the workspace: stages find their Python, and `dvc exp run --temp` works. The stages do nothing."""

import csv
import io
import json
import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from empty_stages import PYTHON
from tiny import BIN, ROOT, committed_params, dvc, make_project, run

SCRIPT = ROOT / "stages" / "python.sh"
NAMES = ("-c", "user.name=t", "-c", "user.email=t@t")


def python_at(folder: Path) -> Path:
    """Makes an environment whose Python says where it is, who started it and what MuJoCo may draw with."""
    path = folder / "bin" / "python"
    path.parent.mkdir(parents=True)
    path.write_text(f'#!/bin/sh\necho "{folder.name} $1 $PORSE_PARENT $MUJOCO_GL"\n')
    path.chmod(0o755)
    return path


def found_in(folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    folder.mkdir(parents=True, exist_ok=True)
    kept = {"PATH": "/usr/bin:/bin", **environment}
    return subprocess.run(["sh", str(SCRIPT), "-m"], cwd=folder, env=kept, capture_output=True, text=True)


def test_the_environment_of_this_folder_or_of_one_above_runs_stages(tmp_path):
    python_at(tmp_path / ".venv")
    inside = found_in(tmp_path / "a folder" / "exps" / "tmp1", MUJOCO_GL="osmesa")
    # The parent of the shell is the parent of the stage that takes its place.
    assert inside.stdout == f".venv -m {os.getpid()} disable\n"
    python_at(tmp_path / "a folder" / ".venv")
    assert found_in(tmp_path / "a folder").returncode == 0


def test_a_named_python_comes_first(tmp_path):
    python_at(tmp_path / ".venv")
    named = python_at(tmp_path / "mine")
    assert found_in(tmp_path, PORSE_PYTHON=str(named)).stdout.startswith("mine -m ")


def test_a_worktree_has_the_environment_of_its_repository(tmp_path):
    project = tmp_path / "project"
    project.mkdir()
    run(project, "git", "init", "-q")
    run(project, "git", *NAMES, "commit", "-q", "--allow-empty", "-m", "a")
    run(project, "git", "worktree", "add", "-q", str(tmp_path / "elsewhere" / "tree"))
    python_at(project / ".venv")
    assert found_in(tmp_path / "elsewhere" / "tree").stdout.startswith(".venv -m ")


def test_an_activated_environment_comes_last_and_none_is_a_sentence(tmp_path):
    (tmp_path / "activated").mkdir()
    python_at(tmp_path / "activated" / "conda")
    path = f"{tmp_path / 'activated' / 'conda' / 'bin'}:/usr/bin:/bin"
    assert found_in(tmp_path / "x", PATH=path).stdout.startswith("conda -m ")
    tools = tmp_path / "tools"
    tools.mkdir()
    (tools / "sh").symlink_to("/bin/sh")
    (tools / "git").symlink_to("/bin/false")
    none = found_in(tmp_path / "x", PATH=str(tools))
    assert none.returncode == 1
    assert "run make setup, or set PORSE_PYTHON" in none.stderr


@pytest.fixture(scope="module")
def committed(tmp_path_factory) -> Path:
    """A project of one iteration that was run and committed."""
    folder = tmp_path_factory.mktemp("experiments")
    (folder / "venv" / "bin").mkdir(parents=True)
    (folder / "venv" / "bin" / "python").write_text(PYTHON)
    (folder / "venv" / "bin" / "python").chmod(0o755)
    params = {**committed_params(), "iterations": [{"n": 1, "next": "result"}]}
    project = make_project(folder / "project", params, folder / "venv")
    dvc(project, "repro")
    run(project, "git", "config", "user.name", "t")
    run(project, "git", "config", "user.email", "t@t")
    run(project, "git", "add", "-A")
    run(project, "git", "commit", "-qm", "run")
    return project


def test_an_experiment_beside_the_workspace_runs_and_is_shown(committed):
    done = dvc(committed, "exp", "run", "--temp", "--name", "another", "-S", "seed=7")
    assert "Ran experiment(s): another" in done.stdout
    assert run(committed, "git", "status", "--porcelain").stdout == ""
    # A list is a quoted value of a row.
    shown = csv.DictReader(io.StringIO(dvc(committed, "exp", "show", "--csv", "--no-pager").stdout))
    assert [row["seed"] for row in shown if "another" in row["Experiment"]] == ["7"]
    assert "seed" in dvc(committed, "params", "diff", "another").stdout


def test_experiments_fit_a_terminal_and_say_whose_they_are(tmp_path):
    """As many commits as experiments: the columns are the same, and nothing has to run."""
    project = make_project(tmp_path / "project", committed_params(), tmp_path)
    names = ("score", "mts", "hns_lineage", "success", "epochs_spent", "valid_share")
    document = committed_params()
    for task, method, seed in (("Quadcopter", "porse", 1), ("CatchOver2Underarm", "eureka", 2)):
        figures = {name: -0.12345678901234567 * seed for name in names}
        (project / "metrics.json").write_text(json.dumps({"Task": task, "Method": method, "Seed": seed, **figures}))
        document |= {"task": task, "method": method, "seed": seed, "train": {**document["train"], "gamma": 0.1 * seed}}
        (project / "params.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
        run(project, "git", "add", "-A")
        run(project, "git", *NAMES, "commit", "-qm", task)
    shown = run(project, str(BIN / "porse"), "experiments", "--no-pager", "-A", COLUMNS="120").stdout
    head, _, last, first = (
        line.split() for line in shown.splitlines() if any(word in line for word in ("Task", "0.1", "0.2"))
    )
    assert head == ["Experiment", "Task", "Method", "Seed", "score", "mts", "hns_lineage", "success", "train.gamma"]
    assert max(map(len, shown.splitlines())) <= 120
    assert "…" not in shown
    assert last[-8:] == ["CatchOver2Underarm", "eureka", "2", *["-0.24691"] * 4, "0.2"]
    assert first[-8:] == ["Quadcopter", "porse", "1", *["-0.12346"] * 4, "0.1"]
    # Two tasks: the difference says so.
    said = [line.split() for line in dvc(project, "metrics", "diff", "HEAD~1", "HEAD").stdout.splitlines()]
    assert said[1:4] == [
        ["metrics.json", "Method", "porse", "eureka", "-"],
        ["metrics.json", "Seed", "1", "2", "1"],
        ["metrics.json", "Task", "Quadcopter", "CatchOver2Underarm", "-"],
    ]


@pytest.mark.slow
def test_queued_experiments_run(committed):
    # DVC's workers look for `dvc` in PATH: an activated environment.
    activated = {"PATH": f"{BIN}:{os.environ['PATH']}"}
    for seed in ("8", "9"):
        dvc(committed, "exp", "run", "--queue", "--name", f"seed{seed}", "-S", f"seed={seed}")
    dvc(committed, "exp", "run", "--run-all", **activated)
    status = dvc(committed, "queue", "status").stdout.split()
    assert [status[status.index(name) + 3] for name in ("seed8", "seed9")] == ["Success", "Success"]


def test_a_worktree_runs_on_its_own(committed, tmp_path):
    tree = tmp_path / "tree"
    run(committed, "git", "worktree", "add", "-q", str(tree))
    dvc(tree, "cache", "dir", "--local", str(committed / ".dvc" / "cache"))
    assert "Running stage" not in dvc(tree, "repro").stdout
    assert (tree / "run" / "result" / "start").is_dir()
    assert run(tree, "git", "status", "--porcelain").stdout == ""


def test_the_committed_run_comes_back_as_the_readme_says(committed):
    dvc(committed, "exp", "run", "--name", "away", "-S", "seed=11")
    # These stages write the same for every seed; a result that is gone stands for one that differs.
    shutil.rmtree(committed / "run" / "result" / "start")
    assert "params.yaml" in run(committed, "git", "status", "--porcelain").stdout
    way = re.search(r"\*\*The way back.*?```sh\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    restore, checkout = way[1].splitlines()
    run(committed, *shlex.split(restore))
    assert checkout == ".venv/bin/dvc checkout"
    dvc(committed, "checkout")
    assert (committed / "run" / "result" / "start" / "a").is_file()
    assert run(committed, "git", "status", "--porcelain").stdout == ""
    assert "up to date" in dvc(committed, "status").stdout
    assert "away" in dvc(committed, "exp", "list").stdout
