"""The warm server: a stage that it runs ends as a cold one, ends with its caller, and starts cold where it should."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from porse.checkpoint import write_checkpoint
from porse.pool import write_pool
from porse.training.start import random_policy
from porse.warm.client import VARIABLE
from porse.warm.start import warm_server
from samples import MAPPING, REWARD, program
from test_population import wait_until
from tiny import write_inputs

PARENT = """
import subprocess, sys
from porse.warm.start import warm_server
with warm_server("portable") as environment:
    print(environment["PORSE_WARM"], flush=True)
    sys.stdin.read()
"""
ELIMINATE = ("--inputs", "inputs/eliminate.json", "--iteration", "1", "--rung", "1", "--keep", "1", "--trained", "pool")
KEY = "not-a-key-" + "of-anyone"
"""Joined here, so that only a process that was given it holds it in one piece."""


def row(name: str, slot: int) -> dict:
    return {
        "iteration": 1, "slot": slot, "candidate_id": name, "origin": "new", "parent_id": "", "reward_key": "",
        "mapping_key": "", "reward_source": REWARD, "mapping_source": MAPPING, "reward_program": program(REWARD),
        "mapping_program": program(MAPPING), "beta": 1.0, "alpha": 0.8, "draw": 0,
        "policy": "fused", "epochs": 0, "failure": "",
    }  # fmt: skip


@pytest.fixture(scope="module")
def project(root, small, tmp_path_factory) -> Path:
    """A copy of what stages need, with tiny parameters, trainings without an end, and a pool of two."""
    folder = tmp_path_factory.mktemp("warm") / "a project"
    for name in ("porse", "stages", "presets", "prompts", "llm_cache"):
        shutil.copytree(root / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(root / "requirements.lock", folder)
    params = yaml.safe_load((root / "params.yaml").read_text())
    params["train"] |= {"num_envs": 8, "steps_per_epoch": 8, "rung_epochs": 10**6, "hidden": [8], "minibatches": 2}
    (folder / "params.yaml").write_text(yaml.safe_dump(params))
    write_inputs(folder)
    write_checkpoint(folder / "start.safetensors", random_policy(small, 1))
    curves = [
        {"iteration": 1, "rung": "1", "candidate_id": name, "series": "fitness", "epoch": 1, "value": value}
        for name, value in (("one", -2.0), ("two", -1.0))
    ]
    rows = [row("one", 0), row("two", 1)]
    write_pool(folder / "pool", rows, curves, {"fused": folder / "start.safetensors"})
    return folder


@pytest.fixture(scope="module")
def server() -> Iterator[dict[str, str]]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OPENAI_API_KEY", KEY)
        with warm_server("portable") as environment:
            yield environment


def start(where: Path, *command: str, **environment: str) -> subprocess.Popen[str]:
    # Python then says what it imports: a cold stage imports Arrow, the caller of a warm one does not.
    told = {**os.environ, "PYTHONPROFILEIMPORTTIME": "1", **environment}
    pipe = subprocess.PIPE
    return subprocess.Popen([sys.executable, "-m", *command], cwd=where, env=told, stdout=pipe, stderr=pipe, text=True)


def ended(process: subprocess.Popen[str]) -> tuple[int, str, str, bool]:
    """Returns exit code, output, errors, and whether it was warm."""
    output, errors = process.communicate(timeout=120)
    said = [line for line in errors.splitlines() if not line.startswith("import time:")]
    return process.returncode, output, "\n".join(said), "pyarrow" not in errors


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_warm_stage_writes_and_says_what_a_cold_one_does(project, server):
    cold = ended(start(project, "stages.eliminate", *ELIMINATE, "--out", "cold"))
    warm = ended(start(project, "stages.eliminate", *ELIMINATE, "--out", "warm", **server))
    assert cold == (0, "iteration 1 rung 1: 1 of 2 survive, best two with score -1.000\n", "", False)
    assert warm == (*cold[:3], True)
    assert contents(project / "warm") == contents(project / "cold")
    assert len(contents(project / "cold")) == 5


def test_a_warm_stage_ends_with_the_code_and_the_words_of_a_cold_one(project, server):
    for command in (("stages.eliminate", "--what"), ("stages.eliminate", *ELIMINATE[:-1], "nowhere", "--out", "x")):
        cold, warm = ended(start(project, *command)), ended(start(project, *command, **server))
        assert cold[0] != 0
        assert cold[2] != ""
        assert warm == (*cold[:3], True)


def changed(project: Path, folder: Path, name: str, before: str, after: str) -> Path:
    """Returns a copy of the project in which one file differs."""
    shutil.copytree(project, folder / "changed")
    path = folder / "changed" / name
    assert path.read_text().count(before) == 1
    path.write_text(path.read_text().replace(before, after))
    write_inputs(folder / "changed")
    return folder / "changed"


@pytest.mark.parametrize(
    ("name", "before", "after"),
    [
        ("porse/search/elimination.py", '"""Who goes on:', '"""Who stays:'),
        ("porse/steps/eliminate.py", "survive{best}", "go on{best}"),
        ("params.yaml", "numerics: portable", "numerics: fast"),
        ("params.yaml", "numerics: portable", "'numerics': portable"),
    ],
)
def test_a_stage_starts_cold_where_the_server_has_imported_something_else(
    project, server, tmp_path, name, before, after
):
    place = changed(project, tmp_path, name, before, after)
    code, output, errors, warm = ended(start(place, "stages.eliminate", *ELIMINATE, "--out", "out", **server))
    assert (code, errors, warm) == (0, "", False)
    assert ("go on, best two" in output) == (after == "go on{best}")


def test_a_stage_starts_cold_where_libraries_would_be_loaded_otherwise(project, server):
    command = ("stages.eliminate", *ELIMINATE, "--out", "other")
    assert ended(start(project, *command, MALLOC_ARENA_MAX="1", **server))[3] is False
    # What the numeric profile sets anyway makes no difference.
    assert ended(start(project, *command, OMP_NUM_THREADS="7", TZ="Asia/Kathmandu", **server))[3] is True


def test_a_stage_starts_cold_where_the_server_has_ended(project, tmp_path):
    with warm_server("portable") as environment:
        pass
    code, _, errors, warm = ended(start(project, "stages.eliminate", *ELIMINATE, "--out", "late", **environment))
    assert (code, errors, warm) == (0, "", False)
    assert not Path(environment[VARIABLE]).parent.exists()


@pytest.mark.parametrize("warm", [True, False])
def test_a_stage_whose_parent_has_ended_before_it_could_ask_does_not_start(project, server, warm):
    command = ("stages.eliminate", *ELIMINATE, "--out", f"child-{warm}")
    environment = server if warm else {}
    # This process stands for another one than that which started the stage.
    orphan = start(project, *command, PORSE_PARENT=str(os.getppid()), **environment)
    orphan.communicate(timeout=60)
    assert orphan.returncode == -signal.SIGKILL
    assert not (project / f"child-{warm}").exists()
    # The shell is the parent here, in the place of DVC.
    script = f"PORSE_PARENT=$$ {sys.executable} -m {' '.join(command)}; exit $?"
    done = subprocess.run(["/bin/sh", "-c", script], cwd=project, env={**os.environ, **environment}, check=False)
    assert done.returncode == 0
    assert (project / f"child-{warm}" / "survivors.parquet").exists()


def test_what_is_no_stage_is_not_handed_over(project, server):
    (project / "other.py").write_text("import os, stages\nprint(os.getppid())\n")
    assert ended(start(project, "other", **server))[:2] == (0, f"{os.getpid()}\n")


def processes(ancestor: int) -> set[int]:
    """The living processes below one, itself included."""
    parents: dict[int, int] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                state, parent = (entry / "stat").read_text().rsplit(")", 1)[1].split()[:2]
            except (FileNotFoundError, ProcessLookupError):
                continue
            if state != "Z":
                parents[int(entry.name)] = int(parent)
    found = {ancestor} & set(parents)
    while more := {process for process, parent in parents.items() if parent in found} - found:
        found |= more
    return found


def server_process() -> int:
    """The one server that this process has started."""
    commands = {process: Path(f"/proc/{process}/cmdline").read_bytes() for process in processes(os.getpid())}
    (found,) = (
        process
        for process, command in commands.items()
        if b"\0porse.warm.server\0" in command and parent_of(process) == os.getpid()
    )
    return found


def holds(process: int, text: bytes) -> bool:
    """Returns whether the memory of a process holds a text."""
    with open(f"/proc/{process}/maps") as maps, open(f"/proc/{process}/mem", "rb", buffering=0) as memory:
        for line in maps:
            span, rights = line.split()[:2]
            if not rights.startswith("rw"):
                continue
            begin, end = (int(number, 16) for number in span.split("-"))
            try:
                memory.seek(begin)
                if text in memory.read(end - begin):
                    return True
            except (OSError, ValueError, OverflowError):
                continue
    return False


def training(project: Path, environment: dict[str, str]) -> subprocess.Popen[str]:
    """Starts a stage that trains two candidates without an end."""
    inputs = ("--inputs", "inputs/train-population.json")
    command = (*inputs, "--iteration", "1", "--rung", "1", "--until", "1", "--pool", "pool", "--out", "trained")
    return start(project, "stages.train_population", *command, PORSE_WORKERS="2", **environment)


def test_the_server_never_holds_a_key_of_a_stage(project, server):
    process = server_process()
    caller = training(project, {**server, "OPENAI_API_KEY": KEY})
    wait_until(lambda: len(processes(process)) == 4, 60)
    (stage,) = (child for child in processes(process) if parent_of(child) == process)
    assert holds(stage, KEY.encode())
    assert not holds(process, KEY.encode())
    caller.kill()
    caller.communicate()
    wait_until(lambda: processes(process) == {process}, 5)


def parent_of(process: int) -> int:
    return int(Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[1])


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_warm_stage_and_its_trainings_end_with_their_caller(project, server, number):
    process = server_process()
    caller = training(project, server)
    wait_until(lambda: len(processes(process)) == 4, 60)
    caller.send_signal(number)
    # Its output ends, too: nobody holds it.
    caller.communicate(timeout=5)
    assert caller.returncode == -number
    wait_until(lambda: processes(process) == {process}, 5)


def test_a_warm_stage_that_a_signal_ends_ends_its_caller_with_the_same(project, server):
    process = server_process()
    caller = training(project, server)
    wait_until(lambda: len(processes(process)) == 4, 60)
    (stage,) = (child for child in processes(process) if parent_of(child) == process)
    os.kill(stage, signal.SIGKILL)
    caller.communicate(timeout=5)
    assert caller.returncode == -signal.SIGKILL
    wait_until(lambda: processes(process) == {process}, 5)


@pytest.mark.parametrize("seconds", [0.0, 0.2, None])
def test_everything_ends_with_the_process_that_wanted_the_server(root, project, seconds):
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT], cwd=root, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with parent:
        address = parent.stdout.readline().strip()
        caller = training(project, {VARIABLE: address})
        if seconds is None:
            wait_until(lambda: len(processes(parent.pid)) == 5, 60)
        else:
            time.sleep(seconds)
        below = processes(parent.pid) - {parent.pid}
        parent.kill()
        parent.wait()
        wait_until(lambda: not any(Path(f"/proc/{process}").exists() for process in below), 5)
        # The caller is no child of that process here: it says that its server is gone, or starts cold.
        if seconds is None:
            assert ended(caller)[0] == 1
        caller.kill()
        caller.communicate()
        shutil.rmtree(Path(address).parent)
