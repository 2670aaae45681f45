"""The processes of a population: what they report, and that they do not outlive who started them."""

import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from porse.checkpoint import write_checkpoint
from porse.training.job import Ended, Job, Report
from porse.training.limits import WORKERS_VARIABLE
from porse.training.population import train_pool
from porse.training.start import random_policy
from samples import MAPPING, REWARD, program


def job(name: str, start: Path, until: int) -> Job:
    return Job(name, program(REWARD), program(MAPPING), 1.0, start, start.with_name(f"{name}.safetensors"), until, 7)


def test_every_epoch_of_every_candidate_is_reported_in_order(small, tmp_path):
    start = tmp_path / "start.safetensors"
    write_checkpoint(start, random_policy(small, 1))
    events = []
    outcomes = train_pool([job("a", start, 3), job("b", start, 2)], small, events.append)
    reports = [event for event in events if isinstance(event, Report)]
    assert {name: [r.epoch for r in reports if r.name == name] for name in "ab"} == {"a": [1, 2, 3], "b": [1, 2]}
    told = {(r.name, r.epoch): r.fitness for r in reports}
    written = {
        (name, epoch): value
        for name, outcome in zip("ab", outcomes, strict=True)
        for epoch, series, value in outcome.rows
        if series == "fitness"
    }
    assert told == written
    assert {event.name: event.outcome for event in events if isinstance(event, Ended)} == dict(
        zip("ab", outcomes, strict=True)
    )


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


def stage(small, start: Path, output: int) -> int:
    """Forks a process that trains eight candidates without an end, as the leader of a session, and returns its id."""
    process = os.fork()
    if process == 0:
        os.setsid()
        os.dup2(output, 1)
        os.dup2(output, 2)
        os.close(output)
        os.environ[WORKERS_VARIABLE] = "8"
        train_pool([job(str(n), start, 10**9) for n in range(8)], small, lambda event: print("event", flush=True))
        os._exit(0)
    return process


def ends_with_its_stage(small, start: Path, alive: Callable[[int], object]) -> None:
    """Kills a stage when `alive` returns: in 5 s nothing of it runs, and nothing holds its output."""
    output, printing = os.pipe()
    sys.stdout.flush()
    process = stage(small, start, printing)
    os.close(printing)
    try:
        alive(process)
    finally:
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
    wait_until(lambda: not session(process), 5)
    while os.read(output, 1 << 16):
        pass
    os.close(output)


def test_trainings_do_not_outlive_a_killed_stage(small, tmp_path):
    start = tmp_path / "start.safetensors"
    write_checkpoint(start, random_policy(small, 1))
    ends_with_its_stage(small, start, lambda process: wait_until(lambda: len(session(process)) == 9, 60))


@pytest.mark.parametrize("milliseconds", range(0, 240, 20))
def test_nor_do_trainings_that_are_just_being_started(small, tmp_path, milliseconds):
    start = tmp_path / "start.safetensors"
    write_checkpoint(start, random_policy(small, 1))
    ends_with_its_stage(small, start, lambda process: time.sleep(milliseconds / 1000))
