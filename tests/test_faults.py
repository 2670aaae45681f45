"""One candidate breaks, in every way that there is; the others end with the bytes of a run in which nothing happens."""

import dataclasses
import hashlib
import json
import os
import re
import signal
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch

from faulty import PLAN_VARIABLE
from porse.checkpoint import Checkpoint, read_checkpoint, write_checkpoint
from porse.errors import CheckpointError, ParamsError
from porse.identity import seed_for
from porse.pool import read_pool, write_pool
from porse.training.evaluation import evaluate
from porse.training.executor import EXECUTOR_VARIABLE
from porse.training.job import Ended, Job, Outcome, Report
from porse.training.limits import MEMORY_VARIABLE, SILENCE_VARIABLE, WORKERS_VARIABLE, limits_from_environment
from porse.training.local import Local
from porse.training.population import train_pool
from porse.training.probing import search_rung
from porse.training.reason import plain
from porse.training.start import random_policy
from samples import MAPPING, NOT_FINITE, RAISES, REWARD, program

pytestmark = pytest.mark.timeout(600)

STEPS, EPOCHS = 8, 3
GOOD, HIT, CALM = "good", "hit", "calm"
SEEDS = {GOOD: 1, HIT: 2, CALM: 3}


@dataclass(frozen=True)
class Fault:
    """What happens to one candidate, and what its row says about it."""

    says: str
    way: str = ""
    reward: str = REWARD
    start: str = "start"


FAULTS = {
    "a kill": Fault(r"its process was ended by SIGKILL, after epoch 1", "kill"),
    "a trap of the processor": Fault(r"its process was ended by SIGFPE, after epoch 1", "fpe"),
    "an illegal instruction": Fault(r"its process was ended by SIGILL, after epoch 1", "ill"),
    "a broken pointer": Fault(r"its process was ended by SIGSEGV, after epoch 1", "segv"),
    "an end of its own": Fault(
        r"its process ended by itself with code 3, after epoch 1; it printed last: rotor 3 is gone", "end"
    ),
    "lost pipes": Fault(r"its process ended by itself with code 1, after epoch 1; it printed last: .*OSError", "pipes"),
    "an exception": Fault(
        r"its training raised KeyError: 'no such rotor in rotors\.py', in epoch 2$", "raise"
    ),
    "an exit": Fault(r"its training raised SystemExit: 7, in epoch 2$", "exit"),
    "too much memory": Fault(r"its training may take no more memory: MemoryError, in epoch 2$", "memory"),
    "a fitness that is no number": Fault(
        r"its fitness was not finite in 100\.0% of the values, in epoch 2$", "fitness"
    ),
    "a reward that is not finite": Fault(
        r"its reward was not finite in 50\.0% of the epoch's states \(components: late\), in epoch 2$", reward=NOT_FINITE
    ),
    "a reward that raises": Fault(r"its function raised in training: .*, in epoch 2$", reward=RAISES),
    "weights beyond measure": Fault(r"its .* not finite in .*%.*, in epoch 1$", start="heavy"),
    "a deviation that turns negative": Fault(r"the deviation of its actions fell to -0\.\d+, in epoch 1$", start="narrow"),
    "a stop": Fault(r"its process made no progress for 10 s, after epoch 1", "stop"),
    "an endless wait": Fault(r"its process made no progress for 10 s, after epoch 1", "sleep"),
}  # fmt: skip
HANGS = ("a stop", "an endless wait")
"""Those that take as long as the limit, twice."""
TWICE = {"kill", "fpe", "ill", "segv", "end", "pipes", "memory", "stop", "sleep"}
"""Ways whose cause may lie outside: they are tried twice."""


@pytest.fixture(scope="module")
def starts(small, tmp_path_factory) -> Path:
    """A folder with the policies that trainings start from."""
    folder = tmp_path_factory.mktemp("starts")
    policy = random_policy(small, 1)
    heavy = {n: a * np.float32(1e30) if n == "critic.mlp.2.weight" else a for n, a in policy.arrays.items()}
    narrow = {n: a * np.float32(1e-5) if n.endswith("std_param") else a for n, a in policy.arrays.items()}
    for name, arrays in (("start", policy.arrays), ("heavy", heavy), ("narrow", narrow)):
        write_checkpoint(folder / f"{name}.safetensors", Checkpoint(arrays, {"kind": "policy"}))
    return folder


@pytest.fixture(scope="module")
def faulty(small):
    return dataclasses.replace(small, task="faulty:Faulty")


@pytest.fixture
def environment(monkeypatch, tmp_path):
    monkeypatch.setenv(WORKERS_VARIABLE, "2")
    monkeypatch.setenv(MEMORY_VARIABLE, "600")
    monkeypatch.setenv(SILENCE_VARIABLE, "120")
    monkeypatch.setenv(PLAN_VARIABLE, str(tmp_path / "plan.json"))
    (tmp_path / "plan.json").write_text("{}")
    return monkeypatch


def plan(folder: Path, way: str, step: int, marker: str) -> None:
    seed = seed_for(SEEDS[HIT], "task")
    (folder / "plan.json").write_text(json.dumps({str(seed): [way, step, marker]}))


def job(name: str, starts: Path, out: Path, fault: Fault | None = None) -> Job:
    start = starts / f"{fault.start if fault else 'start'}.safetensors"
    reward = fault.reward if fault else REWARD
    return Job(name, program(reward), program(MAPPING), 1.0, start, out / f"{name}.safetensors", EPOCHS, SEEDS[name])


def files(folder: Path) -> dict[str, str]:
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in folder.iterdir()} if folder.exists() else {}


@pytest.fixture(scope="module")
def undisturbed(faulty, starts, tmp_path_factory) -> tuple[dict[str, Outcome], dict[str, str]]:
    """Outcomes and files of a pool in which nothing happens."""
    folder = tmp_path_factory.mktemp("undisturbed")
    with pytest.MonkeyPatch.context() as patch:
        (folder / "plan.json").write_text("{}")
        patch.setenv(PLAN_VARIABLE, str(folder / "plan.json"))
        jobs = [job(name, starts, folder / "out") for name in SEEDS]
        outcomes = train_pool(jobs, faulty, lambda event: None)
    assert [outcome.failure for outcome in outcomes] == ["", "", ""]
    return dict(zip(SEEDS, outcomes, strict=True)), files(folder / "out")


def has_no_children() -> bool:
    try:
        os.waitpid(-1, os.WNOHANG)
    except ChildProcessError:
        return True
    return False


def check_fault(fault, order, faulty, starts, out, undisturbed):
    outcomes, content = undisturbed
    ends: list[Ended] = []
    jobs = [job(name, starts, out, fault if name == HIT else None) for name in order]
    found = dict(
        zip(order, train_pool(jobs, faulty, lambda e: ends.append(e) if isinstance(e, Ended) else None), strict=True)
    )
    assert {name: found[name] for name in (GOOD, CALM)} == {name: outcomes[name] for name in (GOOD, CALM)}
    assert files(out) == {name: digest for name, digest in content.items() if not name.startswith(HIT)}
    assert found[HIT].rows == []
    assert re.match(fault.says, found[HIT].failure), found[HIT].failure
    assert len([end for end in ends if end.name == HIT]) == 1 + (fault.way in TWICE)
    assert has_no_children()


@pytest.mark.parametrize("name", [name for name in FAULTS if name not in HANGS])
def test_what_happens_to_one_candidate_is_that_candidates_failure(
    name, faulty, starts, tmp_path, environment, undisturbed
):
    plan(tmp_path, FAULTS[name].way, STEPS + 3, "")
    check_fault(FAULTS[name], [GOOD, HIT, CALM], faulty, starts, tmp_path / "out", undisturbed)


@pytest.mark.slow
@pytest.mark.parametrize("step", [STEPS + 1, STEPS + 4, STEPS + 5, STEPS + 7, 2 * STEPS])
@pytest.mark.parametrize("name", FAULTS)
def test_wherever_and_whenever_it_happens(name, step, faulty, starts, tmp_path, environment, undisturbed):
    environment.setenv(WORKERS_VARIABLE, str(1 + step % 3))
    environment.setenv(SILENCE_VARIABLE, "10")
    order = [GOOD, CALM]
    order.insert(step % 3, HIT)
    plan(tmp_path, FAULTS[name].way, step, "")
    check_fault(FAULTS[name], order, faulty, starts, tmp_path / "out", undisturbed)


@pytest.mark.parametrize("way", ["kill", "stop"])
def test_what_happens_once_changes_nothing(way, faulty, starts, tmp_path, environment, undisturbed):
    environment.setenv(SILENCE_VARIABLE, "10")
    plan(tmp_path, way, STEPS + 3, str(tmp_path / "happened"))
    outcomes, content = undisturbed
    found = train_pool([job(name, starts, tmp_path / "out") for name in SEEDS], faulty, lambda event: None)
    assert (tmp_path / "happened").exists()
    assert dict(zip(SEEDS, found, strict=True)) == outcomes
    assert files(tmp_path / "out") == content
    assert has_no_children()


def children() -> set[int]:
    return {int(pid) for pid in Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()}


def test_a_training_that_is_killed_from_outside_is_trained_again(faulty, starts, tmp_path, environment, undisturbed):
    outcomes, content = undisturbed
    killed: list[int] = []

    def kill_one(event):
        if isinstance(event, Report) and not killed:
            killed.append(max(children()))
            os.kill(killed[0], signal.SIGKILL)

    found = train_pool([job(name, starts, tmp_path / "out") for name in SEEDS], faulty, kill_one)
    assert len(killed) == 1
    assert dict(zip(SEEDS, found, strict=True)) == outcomes
    assert files(tmp_path / "out") == content


@pytest.mark.parametrize("executor", ["local", "inline"])
@pytest.mark.parametrize("count", ["1", "3"])
def test_neither_the_executor_nor_the_number_of_workers_changes_a_bit(
    executor, count, faulty, starts, tmp_path, environment, undisturbed
):
    environment.setenv(EXECUTOR_VARIABLE, executor)
    environment.setenv(WORKERS_VARIABLE, count)
    outcomes, content = undisturbed
    reports: list[tuple[str, int]] = []

    def note(event):
        if isinstance(event, Report):
            reports.append((event.name, event.epoch))

    found = train_pool([job(name, starts, tmp_path / "out") for name in reversed(SEEDS)], faulty, note)
    assert dict(zip(reversed(SEEDS), found, strict=True)) == outcomes
    assert files(tmp_path / "out") == content
    assert sorted(reports) == sorted((name, epoch) for name in SEEDS for epoch in range(1, EPOCHS + 1))


def test_in_one_process_too_a_candidate_that_fails_leaves_the_others_alone(
    faulty, starts, tmp_path, environment, undisturbed
):
    environment.setenv(EXECUTOR_VARIABLE, "inline")
    plan(tmp_path, "raise", STEPS + 3, "")
    # An earlier training of this very process may have left the switch on.
    torch.use_deterministic_algorithms(False)
    torch.manual_seed(5)
    before = torch.get_rng_state()
    check_fault(FAULTS["an exception"], [HIT, GOOD, CALM], faulty, starts, tmp_path / "out", undisturbed)
    assert torch.equal(torch.get_rng_state(), before)
    assert not torch.are_deterministic_algorithms_enabled()


def test_a_start_that_is_damaged_is_no_failure_of_a_candidate(faulty, starts, tmp_path, environment):
    (tmp_path / "start.safetensors").write_bytes(b"{}")
    jobs = [job(GOOD, starts, tmp_path / "out"), job(CALM, tmp_path, tmp_path / "out")]
    with pytest.raises(CheckpointError, match="a damaged file"):
        train_pool(jobs, faulty, lambda event: None)
    assert files(tmp_path / "out") == {}
    assert has_no_children()


def test_a_training_that_goes_on_in_its_own_file_and_fails_leaves_the_file_as_it_was(
    faulty, starts, tmp_path, environment
):
    one = job(HIT, starts, tmp_path)
    train_pool([one], faulty, lambda event: None)
    before = read_checkpoint(one.finish)
    plan(tmp_path, "raise", 3, "")
    (failed,) = train_pool([dataclasses.replace(one, start=one.finish, until=2 * EPOCHS)], faulty, lambda event: None)
    assert failed.failure == f"its training raised KeyError: 'no such rotor in rotors.py', in epoch {EPOCHS + 1}"
    assert before.scalars["epoch"] == read_checkpoint(one.finish).scalars["epoch"] == EPOCHS
    assert sorted(path.name for path in tmp_path.iterdir()) == ["hit.safetensors", "plan.json"]


@pytest.mark.parametrize("variable", [WORKERS_VARIABLE, MEMORY_VARIABLE, SILENCE_VARIABLE, EXECUTOR_VARIABLE])
@pytest.mark.parametrize("value", ["0", "-1", "two", "9" * 5000, "\u0663"])
def test_a_limit_that_is_no_number_is_refused(variable, value, faulty, starts, tmp_path, environment):
    environment.setenv(variable, value)
    with pytest.raises(ParamsError, match=f"expected {variable} to be") as raised:
        train_pool([job(GOOD, starts, tmp_path / "out")], faulty, lambda event: None)
    assert len(str(raised.value)) < 300


def test_the_last_ones_of_a_pool_share_all_cpus_and_no_more(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    rooms = [Local(limits_from_environment()).room(left) for left in (6, 5, 4, 3, 2, 1)]
    # Five are two, then three that share two CPUs: 1 + 1.5 rounds in place of 3.
    assert rooms == [2, 2, 2, 3, 2, 1]
    # Where fewer CPUs are to be used than there are, the others stay free.
    monkeypatch.setenv(WORKERS_VARIABLE, "1")
    assert [Local(limits_from_environment()).room(left) for left in (3, 2, 1)] == [1, 1, 1]


def test_what_a_failure_says_is_the_same_on_every_machine():
    said = "RuntimeError at /home/me/lib/mlp.py:31,\n tensor 0x7f3a22bc10 of a/b"
    assert plain(said) == "RuntimeError at mlp.py:31, tensor 0x... of a/b"
    assert len(plain("x" * 10_000)) == 400


def candidate(name: str, slot: int, reward: str, beta: float) -> dict:
    return {
        "iteration": 2, "slot": slot, "candidate_id": name, "origin": "new", "parent_id": "", "reward_key": "",
        "mapping_key": "", "reward_source": reward, "mapping_source": MAPPING, "reward_program": program(reward),
        "mapping_program": program(MAPPING), "beta": beta, "alpha": 0.8, "draw": 0,
        "policy": "fused", "epochs": 0, "failure": "",
    }  # fmt: skip


def tree(folder: Path) -> dict[str, str]:
    paths = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


def test_the_search_of_alpha_goes_on_without_a_candidate_that_fails(small, starts, tmp_path, monkeypatch):
    probe = dataclasses.replace(small.probe, trainings=3, initial=2, share=0.5, least_epochs=1)
    roska = dataclasses.replace(small, probe=probe)
    rows = [candidate("good", 0, REWARD, 1.0), candidate("bad", 1, NOT_FINITE, 1.0), candidate("calm", 2, REWARD, 0.5)]
    policies = {stem: starts / "start.safetensors" for stem in ("best", "random", "fused")}
    for name, members in (("all", rows), ("others", [rows[0], rows[2]])):
        write_pool(tmp_path / name, members, [], policies)
    for name, executor, count in (("all", "local", "3"), ("all", "inline", "1"), ("others", "local", "1")):
        monkeypatch.setenv(EXECUTOR_VARIABLE, executor)
        monkeypatch.setenv(WORKERS_VARIABLE, count)
        search_rung(read_pool(tmp_path / name), roska, 2, "1", 2, tmp_path / f"{name}-{executor}")
    assert tree(tmp_path / "all-local") == tree(tmp_path / "all-inline")
    together, apart = read_pool(tmp_path / "all-local"), read_pool(tmp_path / "others-local")
    # Its probes of one epoch end well; the chosen one fails in the second, and keeps the policy that it had after the first.
    (failed,) = [row for row in together.candidates if row["failure"]]
    assert (failed["parent_id"], failed["epochs"]) == ("bad", 1)
    assert failed["failure"].startswith("its reward was not finite")
    assert read_checkpoint(together.policy(failed)).scalars["epoch"] == 1
    # The others are as they would be without it, but for their places.
    others = [row for row in together.candidates if row["parent_id"] != "bad"]
    names = {row["candidate_id"] for row in others}
    assert [row for row in together.curves if row["candidate_id"] in names] == apart.curves
    assert [{**row, "slot": 0} for row in others] == [{**row, "slot": 0} for row in apart.candidates]
    assert all(together.policy(row).read_bytes() == apart.policy(row).read_bytes() for row in others)


def test_an_evaluation_leaves_out_what_fails_and_is_the_same_in_both_executors(small, tmp_path, monkeypatch):
    seeds = dataclasses.replace(small, evaluate=dataclasses.replace(small.evaluate, seeds=2))
    found = []
    for executor in ("local", "inline"):
        monkeypatch.setenv(EXECUTOR_VARIABLE, executor)
        lineage = [
            candidate("one", 0, REWARD, 1.0),
            candidate("two", 0, NOT_FINITE, 1.0),
            candidate("three", 0, REWARD, 1.0),
        ]
        found.append(evaluate(lineage, 2, seeds, tmp_path / executor))
    assert found[0] == found[1]
    rows, seeds = found[0]
    # all of them fail, in the second link, and each says so
    assert [(row["seed"], row["links"]) for row in seeds] == [(1, 1), (2, 1)]
    assert all("its reward was not finite" in row["failure"] for row in seeds)
    assert [(row["candidate_id"], row["seed"], row["epoch"]) for row in rows] == [
        ("one", 1, 1), ("one", 1, 2), ("one", 2, 1), ("one", 2, 2),
    ]  # fmt: skip
