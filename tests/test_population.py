"""The processes of a population: what they report, and that they do not outlive who started them."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from porse.checkpoint import write_checkpoint
from porse.training.job import Job
from porse.training.population import train_pool
from porse.training.start import random_policy
from samples import MAPPING, REWARD, program

ROOT = Path(__file__).resolve().parent.parent

ENDLESS = """
import sys
sys.path[:0] = [{root!r}, {tests!r}]
from conftest import load_params, numerics
import dataclasses
from pathlib import Path
from porse.training.job import Job
from porse.training.population import train_pool
from samples import MAPPING, REWARD, program

params = load_params(Path({root!r}) / "params.yaml")
train = dataclasses.replace(params.train, num_envs=8, steps_per_epoch=8, hidden=(8,), minibatches=2)
jobs = [Job(str(n), program(REWARD), program(MAPPING), 1.0, Path({start!r}), Path("never"), 10**9, n) for n in (1, 2)]
if __name__ == "__main__":
    train_pool(jobs, dataclasses.replace(params, train=train), lambda report: print(report.epoch, flush=True))
"""


def job(name: str, start: Path, until: int) -> Job:
    return Job(name, program(REWARD), program(MAPPING), 1.0, start, start.with_name(f"{name}.safetensors"), until, 7)


def test_every_epoch_of_every_candidate_is_reported_in_order(small, tmp_path):
    start = tmp_path / "start.safetensors"
    write_checkpoint(start, random_policy(small, 1))
    reports = []
    outcomes = train_pool([job("a", start, 3), job("b", start, 2)], small, reports.append)
    assert {name: [r.epoch for r in reports if r.name == name] for name in "ab"} == {"a": [1, 2, 3], "b": [1, 2]}
    told = {(r.name, r.epoch): r.fitness for r in reports}
    written = {
        (name, epoch): value
        for name, outcome in zip("ab", outcomes, strict=True)
        for epoch, series, value in outcome.rows
        if series == "fitness"
    }
    assert told == written


def session(leader: int) -> set[int]:
    """The living processes of a session."""
    found = set()
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                state, _, _, sid = (entry / "stat").read_text().rsplit(")", 1)[1].split()[:4]
            except (FileNotFoundError, ProcessLookupError):
                continue
            if int(sid) == leader and state != "Z":
                found.add(int(entry.name))
    return found


def wait_until(holds, seconds):
    deadline = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_trainings_do_not_outlive_a_killed_parent(small, tmp_path):
    start = tmp_path / "start.safetensors"
    write_checkpoint(start, random_policy(small, 1))
    script = tmp_path / "endless.py"
    script.write_text(ENDLESS.format(root=str(ROOT), tests=str(ROOT / "tests"), start=str(start)))
    command = [sys.executable, str(script)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True, cwd=tmp_path, text=True) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline().strip() == "1"
        # The parent, the server that forks, two trainings, and the tracker of resources.
        assert len(session(parent.pid)) >= 4
        os.kill(parent.pid, signal.SIGKILL)
        parent.wait()
        wait_until(lambda: not session(parent.pid), 30)
