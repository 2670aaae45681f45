"""The whole pipeline at tiny size: a real Git and DVC repository, real stages, and a real endpoint on loopback."""

import json
import os
import re
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import ClassVar

import pytest
import yaml

from at_once import outputs, run_at_once
from porse import tables
from porse.config import load_params
from porse.generation.states import checker
from porse.inputs.stages import NO_RESULT, STAGES
from porse.report.figures import lineage_fitness
from porse.report.results import read_results
from porse.report.run import read_lineage
from porse.training import evaluation
from scripted import answer
from tiny import BIN, QUIET, committed_params, dvc, make_project, run
from warm_stages import warm_stages

STOPPED_BY_A_PIPE = """#!/bin/sh
case "$*" in *"--rung mutants"*) mkdir -p "{folder}"; mkfifo "{pipe}" ;; esac
exec "{python}" "$@"
"""


def tiny_params() -> dict:
    params = committed_params()
    params["llm"]["profile"] = "local"
    params["generate"] |= {"candidates": 3, "elites": 1}
    params["train"] |= {"num_envs": 8, "steps_per_epoch": 4, "rung_epochs": 1, "hidden": [8], "minibatches": 2}
    params["evaluate"] |= {"seeds": 1, "episodes": 8}
    params["iterations"] = [{"n": 1, "next": 2}, {"n": 2, "next": "result"}]
    params["rungs"] = [
        {"rung": 1, "pool": "validate-code", "until": 1, "keep": 2},
        {"rung": "mutants", "pool": "mutate", "until": 1, "keep": 2},
        {"rung": 2, "pool": "eliminate-mutants", "until": 2, "keep": 1},
    ]
    params["mutate"]["pool"] = "eliminate-1"
    params["fuse"]["pool"] = "eliminate-2"
    return params


class Endpoint(BaseHTTPRequestHandler):
    """An OpenAI-compatible endpoint with the scripted model behind it. The prompt's key is not in the body, so equal
    questions are told apart by a counter, as a sampled model would."""

    asked: ClassVar[list[dict]] = []
    lock: ClassVar = threading.Lock()

    def do_POST(self):
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        with self.lock:
            sample = sum(body["messages"] == earlier["messages"] for earlier in self.asked)
            self.asked.append(body)
        text = answer({"messages": body["messages"], "sample": sample})
        reply = {
            "id": "x", "object": "chat.completion", "created": 0, "model": body["model"],
            "choices": [{"index": 0, "finish_reason": "stop", "message": {"role": "assistant", "content": text}}],
            "usage": {"prompt_tokens": 10, "completion_tokens": 5, "total_tokens": 15},
        }  # fmt: skip
        content = json.dumps(reply).encode()
        self.send_response(200)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_):
        pass


def git(where: Path, *command: str) -> str:
    return run(where, "git", "-c", "user.name=t", "-c", "user.email=t@t", *command).stdout


@pytest.fixture(scope="module")
def warm(tmp_path_factory) -> Iterator[Path]:
    with warm_stages(tmp_path_factory.mktemp("warm")) as venv:
        yield venv


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, warm) -> Path:
    """A project whose run was recorded from the endpoint, and committed."""
    project = make_project(tmp_path_factory.mktemp("recorded") / "project", tiny_params(), warm)
    server = ThreadingHTTPServer(("127.0.0.1", 0), Endpoint)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    url = f"http://127.0.0.1:{server.server_port}/v1"
    dvc(project, "repro", PORSE_LLM_MODE="record", PORSE_LLM_BASE_URL=url, PORSE_LLM_CONCURRENCY="1")
    server.shutdown()
    server.server_close()
    # Recording added to llm_cache/, which is no dep: nothing is left to do.
    assert "Running stage" not in dvc(project, "repro").stdout
    git(project, "add", "-A")
    git(project, "commit", "-qm", "recorded")
    return project


@pytest.fixture(autouse=True)
def _long(request):
    request.node.add_marker(pytest.mark.timeout(600))


def test_the_run_leaves_its_tables_and_metrics(recorded):
    results = {name: tables.read(recorded / "results" / f"{name}.parquet", tables.TABLES[name]) for name in (
        "candidates", "verdicts", "curves", "scores", "survivors", "mutants", "iterations", "replies")}  # fmt: skip
    figures = read_results(recorded).figures
    metrics = json.loads((recorded / "metrics.json").read_text())
    assert {name: metrics[name] for name in ("Task", "Method", "Seed")} == {
        "Task": "Quadcopter",
        "Method": "porse",
        "Seed": 1,
    }
    assert all(figures[name] == metrics[name] for name in list(metrics)[3:])
    # Each iteration: 3 candidates x 1, 5 mutants x 1, 2 survivors x 1; allowed are 3 candidates x 2.
    assert (figures["epochs_spent"], figures["epochs_allowed"]) == (2 * (3 + 5 + 2), 2 * 3 * 2)
    assert figures["environment_steps"] == 20 * 8 * 4
    assert [row["varied"] for row in results["mutants"]] == ["beta"] * 5 + ["alpha"] * 5
    assert [row["origin"] for row in results["candidates"] if row["iteration"] == 2][:3] == ["new", "new", "elite"]
    broken = [row for row in results["verdicts"] if not row["passed"]]
    assert next((row["kind"], row["slot"], row["attempt"], row["check"]) for row in broken) == (
        "reward",
        0,
        0,
        "variable",
    )
    assert figures["functions"] == len(results["verdicts"])
    assert figures["valid_functions"] == len(results["verdicts"]) - len(broken)
    assert figures["replies"] == len(results["replies"])
    assert [row["iteration"] for row in results["iterations"]] == [1, 2]
    fitness = [row["value"] for row in results["curves"] if row["series"] == "fitness"]
    assert metrics["mts"] == max(fitness)
    # Two iterations of a lineage that is fused: the run's winner is the last one.
    assert metrics["score"] == results["iterations"][-1]["score"]
    assert figures["episodes"] == 8
    assert figures["success_low"] < figures["success"] < figures["success_high"]
    assert len(fitness) == metrics["epochs_spent"]


def test_the_lineage_trained_again_with_the_runs_own_seed_is_the_run(recorded, tmp_path, monkeypatch):
    monkeypatch.setattr(evaluation, "evaluation_seed", lambda params, number: params.seed)
    params = load_params(recorded / "params.yaml")
    lineage = read_lineage(recorded / "run", params)
    assert [link["iteration"] for link in lineage] == [1, 2]
    again = [row["fitness"] for row in evaluation.evaluate(lineage, 2, params, tmp_path)[0]]
    curves = tables.read(recorded / "results" / "curves.parquet", tables.CURVES)
    assert again == [fitness for _, fitness in lineage_fitness(curves, lineage)]


def test_dvc_sees_metrics_and_plots(recorded):
    head, values = (line.split() for line in dvc(recorded, "metrics", "show").stdout.splitlines())
    # DVC sorts names: whose run it is comes before its figures.
    assert head[:4] == ["Path", "Method", "Seed", "Task"]
    assert values[:4] == ["metrics.json", "porse", "1", "Quadcopter"]
    assert {"score", "mts", "success"} <= {*head}
    assert dvc(recorded, "plots", "show").returncode == 0


def test_a_second_repro_has_nothing_to_do_in_under_five_seconds(recorded):
    started = time.monotonic()
    done = dvc(recorded, "repro")
    assert time.monotonic() - started < 5.0
    assert "Running stage" not in done.stdout
    assert git(recorded, "status", "--porcelain", "--untracked-files=no") == ""


def test_a_parameter_of_mutate_concerns_only_what_depends_on_it(recorded):
    original = (recorded / "params.yaml").read_text()
    params = yaml.safe_load(original)
    params["mutate"]["inertia"] = 0.5
    try:
        (recorded / "params.yaml").write_text(yaml.safe_dump(params, sort_keys=False))
        dvc(recorded, "repro", "resolve")
        status = json.loads(dvc(recorded, "status", "--json").stdout)
    finally:
        (recorded / "params.yaml").write_text(original)
        dvc(recorded, "repro", "resolve")
    assert sorted(status) == ["iterations/1/dvc.yaml:mutate", "iterations/2/dvc.yaml:mutate", "summarise"]


def test_one_process_leaves_the_bytes_of_all_stages(recorded, tmp_path):
    with checker(load_params(recorded / "params.yaml")) as check:
        said = run_at_once(tmp_path / "run", tiny_params(), check, recorded / "llm_cache")
    assert outputs(tmp_path / "run") == outputs(recorded)
    # Begin; two iterations of generate, validate-code, three rungs, mutate and fuse; then evaluate and summarise.
    assert len(said) == 1 + 2 * (1 + 1 + 3 + 1 + 1) + 2


def processes_in(folder: Path) -> list[str]:
    """The living processes whose working directory is `folder`."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdecimal() and (entry / "cwd").readlink() == folder:
                found.append(entry.name)
        except (FileNotFoundError, PermissionError):
            # It has ended, or is another user's.
            continue
    return found


def test_killed_and_started_again_elsewhere_it_ends_with_the_same_lock(recorded, warm, tmp_path):
    clone = tmp_path / "another place" / "clone"
    git(recorded, "clone", "-q", str(recorded), str(clone))
    # The mutants' stage finds a pipe that nobody reads where its table goes: it trains, and cannot end before the kill.
    trained = clone / "run" / "1" / "train-mutants"
    table = trained / "candidates.parquet"
    python = clone / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text(STOPPED_BY_A_PIPE.format(folder=trained, pipe=table, python=BIN / "python"))
    python.chmod(0o755)
    other = {
        "PORSE_WORKERS": "1", "TZ": "Asia/Kathmandu", "LC_ALL": "C", "PYTHONHASHSEED": "123", "PORSE_LLM_MODE": "frozen",
        # Where it is dash, it stays between DVC and a stage, unless the stage takes its place.
        "SHELL": "/bin/sh",
    }  # fmt: skip
    command = ["sh", "-c", f"umask 077; exec {BIN / 'dvc'} repro"]
    process = subprocess.Popen(
        command, cwd=clone, env={**os.environ, **QUIET, **other}, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    deadline = time.monotonic() + 120
    while not list(trained.glob("policies/*")):
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    while processes_in(clone):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    # A pipe would stop DVC as well; a table that was cut off is what a kill can leave.
    assert table.is_fifo()
    table.unlink()
    table.write_bytes(b"PAR1")
    # The rest is run by the warm server, to save time.
    shutil.rmtree(clone / ".venv")
    (clone / ".venv").symlink_to(warm)
    done = run(clone, "sh", "-c", f"umask 077; exec {BIN / 'dvc'} repro", **other)
    ran = re.findall(r"Running stage '([^']+)'", done.stdout)
    assert ran[0] == "iterations/1/dvc.yaml:train-population-mutants"
    assert git(clone, "status", "--porcelain", "--untracked-files=no") == ""


def test_an_edited_reply_is_refused(recorded, warm, tmp_path):
    clone = tmp_path / "clone"
    git(recorded, "clone", "-q", str(recorded), str(clone))
    (clone / ".venv").symlink_to(warm)
    lock = (clone / "iterations" / "1" / "dvc.lock").read_bytes()
    for record in (clone / "llm_cache").rglob("*.json"):
        record.write_text(record.read_text().replace("distance", "Distance"))
    done = dvc(clone, "repro", "iterations/1/dvc.yaml:generate", check=False)
    assert done.returncode != 0
    assert "Traceback" not in done.stdout + done.stderr
    assert not (clone / "run" / "1" / "generate").exists()
    assert (clone / "iterations" / "1" / "dvc.lock").read_bytes() == lock


EDITING = """#!/bin/sh
case "$*" in *"-m stages.{stage} "*) {edit} ;; esac
exec "{python}" "$@"
"""


def edited_while(recorded: Path, clone: Path, warm: Path, stage: str, edit: str) -> subprocess.CompletedProcess[str]:
    """Runs fuse of iteration 1 again in a clone where a stage finds a file edited when it starts."""
    git(recorded, "clone", "-q", str(recorded), str(clone))
    dvc(clone, "cache", "dir", "--local", str(recorded / ".dvc" / "cache"))
    python = clone / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text(EDITING.format(stage=stage, edit=edit, python=warm / "bin" / "python"))
    python.chmod(0o755)
    dvc(clone, "checkout")
    return dvc(clone, "repro", "--force", "--single-item", "iterations/1/dvc.yaml:fuse", check=False)


def test_parameters_edited_while_a_stage_runs_are_those_of_the_next_run(recorded, warm, tmp_path):
    clone = tmp_path / "clone"
    done = edited_while(recorded, clone, warm, "fuse", "sed -i s/points:.10/points:\\ 9/ params.yaml")
    assert done.returncode == 0, done.stderr
    assert git(clone, "status", "--porcelain", "--untracked-files=no") == " M params.yaml\n"
    assert list(json.loads(dvc(clone, "status", "--json").stdout)) == ["resolve"]


def test_code_edited_before_a_stage_runs_stops_it(recorded, warm, tmp_path):
    clone = tmp_path / "clone"
    done = edited_while(recorded, clone, warm, "fuse", "echo '# new' >> porse/pool.py")
    assert done.returncode != 0
    assert "found porse/pool.py changed since stage resolve wrote them down" in done.stderr
    assert git(clone, "status", "--porcelain", "--untracked-files=no") == " M porse/pool.py\n"
    # The next run begins with what has changed.
    assert "Running stage 'resolve'" in dvc(clone, "repro", "resolve").stdout


def modules_of(project: Path, command: str) -> set[str]:
    """The files of the package that a stage imports, in whatever process: Python itself reports every import."""
    environment = {"PYTHONPROFILEIMPORTTIME": "1", "PORSE_PYTHON": str(BIN / "python")}
    done = run(project, "sh", "-c", command, **environment)
    names = re.findall(r"^import time:.*\| +(porse[\w.]*)$", done.stderr, re.MULTILINE)
    assert names
    files = set[str]()
    for name in names:
        base = project.joinpath(*name.split("."))
        files |= {
            str(path.relative_to(project)) for path in (base.with_suffix(".py"), base / "__init__.py") if path.is_file()
        }
    return files


def kinds() -> list:
    """The stages; all but two of them belong to the long suite, since every one is started in earnest."""
    return [
        kind if kind in ("train-population", "eliminate") else pytest.param(kind, marks=pytest.mark.slow)
        for kind in STAGES
    ]


@pytest.mark.parametrize("kind", kinds())
def test_what_a_stage_imports_when_it_runs_is_among_its_inputs(recorded, tmp_path, kind):
    files = (recorded / "dvc.yaml", recorded / "iterations" / "2" / "dvc.yaml")
    stages = {name: each for path in files for name, each in yaml.safe_load(path.read_text())["stages"].items()}
    name = kind if kind in stages else f"{kind}-1"
    command = stages[name]["cmd"]
    for number, out in enumerate(stages[name]["outs"] + [next(iter(each)) for each in stages[name].get("metrics", [])]):
        command = re.sub(f" {out}(?= |$)", f" {tmp_path / str(number)}", command)
    inputs = json.loads((recorded / "inputs" / f"{kind}.json").read_text())
    found = modules_of(recorded, command)
    assert found - set(inputs["files"]) - set(NO_RESULT) == set()
