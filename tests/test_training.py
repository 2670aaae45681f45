import dataclasses
import hashlib
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from meaning_cases import changed
from porse import numerics, tables
from porse.checkpoint import Checkpoint, policy_checkpoint, read_checkpoint, write_checkpoint
from porse.errors import CheckpointError, ParamsError
from porse.pool import policy_file, read_pool, write_pool
from porse.search.elimination import rank, score
from porse.training.candidate import train_candidate
from porse.training.job import Job
from porse.training.limits import WORKERS_VARIABLE, workers
from porse.training.reward import EpochMeans
from porse.training.rung import train_rung
from porse.training.start import random_policy
from porse.training.vecenv import TaskEnv
from samples import HUGE, INFINITE_COMPONENT, MAPPING, NOT_FINITE, RAISES, REWARD, program

ENVS = "32"


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.fixture(scope="module")
def start(params, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("start") / "start.safetensors"
    write_checkpoint(path, random_policy(params, 1))
    return path


def train(root, start, finish, until, *before) -> str:
    command = [*before, sys.executable, str(root / "tests" / "train_one.py"), str(start), str(finish), str(until), ENVS]
    subprocess.run(command, check=True, capture_output=True, timeout=600)
    return digest(finish)


def test_a_training_split_between_two_processes_gives_the_same_bits(root, start, tmp_path):
    whole = train(root, start, tmp_path / "whole.safetensors", 4)
    train(root, start, tmp_path / "half.safetensors", 2)
    assert train(root, tmp_path / "half.safetensors", tmp_path / "two.safetensors", 4) == whole


@pytest.mark.slow
@pytest.mark.parametrize("cpu", ["Haswell", "EPYC"])
def test_a_training_gives_the_same_bits_on_another_vendors_cpu(root, start, tmp_path, cpu):
    emulator = shutil.which("qemu-x86_64")
    if emulator is None:
        pytest.fail("expected qemu-x86_64, found none; install Debian's qemu-user, then run this again")
    native = train(root, start, tmp_path / "native.safetensors", 2)
    assert train(root, start, tmp_path / "other.safetensors", 2, emulator, "-cpu", cpu) == native


def job(start, finish, reward=REWARD, **changes):
    return dataclasses.replace(Job("one", program(reward), program(MAPPING), 1.0, start, finish, 2, 7), **changes)


@pytest.fixture(scope="module")
def small_start(small, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("small") / "start.safetensors"
    write_checkpoint(path, random_policy(small, 1))
    return path


@pytest.mark.parametrize(
    ("bonus", "lifetime", "form"),
    [
        ("mapping", "candidate", "relative"),
        ("mapping", "rung", "calibrated"),
        ("mapping", "episode", "literal"),
        ("simhash", "rung", "relative"),
        ("none", "candidate", "relative"),
    ],
)
def test_a_training_split_anywhere_gives_the_same_bits(small, small_start, tmp_path, bonus, lifetime, form):
    """Rungs of `small` have 2 epochs: the first cut is within one, the second at its end."""
    chosen = changed(small, candidate={"bonus": bonus}, exploration={"lifetime": lifetime, "form": form})
    whole = job(small_start, tmp_path / "whole", until=5)
    expected = train_candidate(whole, chosen, lambda *_: None).rows
    for cut in (1, 2):
        rows = train_candidate(job(small_start, tmp_path / "half", until=cut), chosen, lambda *_: None).rows
        rows += train_candidate(job(tmp_path / "half", tmp_path / "two", until=5), chosen, lambda *_: None).rows
        assert rows == expected
        assert digest(tmp_path / "two") == digest(tmp_path / "whole")


def test_counts_of_a_rung_begin_with_it_and_those_of_a_candidate_go_on(small, small_start, tmp_path):
    new = {}
    for lifetime in ("candidate", "rung"):
        chosen = changed(small, exploration={"lifetime": lifetime})
        rows = train_candidate(job(small_start, tmp_path / "x", until=4), chosen, lambda *_: None).rows
        new[lifetime] = [value for _, series, value in rows if series == "new_cells"]
    assert new["candidate"][:2] == new["rung"][:2]
    # the third epoch of a candidate finds few new cells, the first one of a rung nothing else
    assert new["rung"][2] > 2.0 * new["candidate"][2]


def test_another_seed_gives_another_policy(small, small_start, tmp_path):
    for seed in (1, 2):
        train_candidate(job(small_start, tmp_path / f"{seed}.safetensors", seed=seed), small, lambda *_: None)
    assert digest(tmp_path / "1.safetensors") != digest(tmp_path / "2.safetensors")


def test_every_series_is_written_down_at_every_epoch(small, small_start, tmp_path):
    outcome = train_candidate(job(small_start, tmp_path / "x.safetensors"), small, lambda *_: None)
    series = [name for epoch, name, _ in outcome.rows if epoch == 2]
    assert series == [
        "fitness", "goal", "bonus", "goal_size", "bonus_size", "bonus_share", "cells_visited", "new_cells",
        "component/closeness", "component/tilt", "component/upright", "progress/distance", "progress/speed", "reward",
        "terminated", "episode_length",
    ]  # fmt: skip
    values = {name: value for epoch, name, value in outcome.rows if epoch == 2}
    assert 0.0 < values["bonus_share"] < 1.0
    assert 0.0 < values["cells_visited"] < 1.0
    assert values["goal"] == pytest.approx(
        values["component/closeness"] + 0.2 * values["component/upright"] - 0.01 * values["component/tilt"], abs=1e-6
    )


def test_a_reward_that_is_not_finite_ends_the_training_with_a_reason_and_writes_nothing(small, small_start, tmp_path):
    outcome = train_candidate(job(small_start, tmp_path / "x.safetensors", NOT_FINITE), small, lambda *_: None)
    assert outcome.failure == "its reward was not finite in 50.0% of the epoch's states (components: late), in epoch 2"
    assert outcome.rows == []
    assert not (tmp_path / "x.safetensors").exists()


def test_a_reward_beyond_measure_is_brought_to_size_and_unscaled_it_ends_the_training(small, small_start, tmp_path):
    huge = job(small_start, tmp_path / "x.safetensors", HUGE)
    assert train_candidate(huge, small, lambda *_: None).failure == ""
    outcome = train_candidate(huge, changed(small, train={"scaling": "none"}), lambda *_: None)
    # Where PPO notices it first depends on what overflows.
    assert re.fullmatch(
        r"its (losses|returns) were not finite in .*|its training raised RuntimeError: .*", outcome.failure
    )
    assert outcome.failure.endswith(", in epoch 2")


def test_a_reward_that_raises_on_a_late_state_ends_the_training_with_a_reason(small, small_start, tmp_path):
    outcome = train_candidate(job(small_start, tmp_path / "x.safetensors", RAISES), small, lambda *_: None)
    assert outcome.failure.startswith("its function raised in training:")
    assert "out of bounds" in outcome.failure
    assert not (tmp_path / "x.safetensors").exists()


def test_a_component_that_is_not_finite_ends_the_training_by_its_name(small, small_start, tmp_path):
    """It would reach the next prompt, though the total is sound."""
    outcome = train_candidate(job(small_start, tmp_path / "x.safetensors", INFINITE_COMPONENT), small, lambda *_: None)
    assert outcome.failure.startswith("its series component/late held NaN or infinity in an epoch")
    assert not (tmp_path / "x.safetensors").exists()


def test_a_list_that_is_none_is_the_candidates_failure(small, small_start, tmp_path):
    broken = dataclasses.replace(job(small_start, tmp_path / "x.safetensors"), reward_program="{}")
    outcome = train_candidate(broken, small, lambda *_: None)
    assert outcome.failure.startswith("its function cannot be run: expected an operator list")


def candidate_row(name, reward, slot):
    return {
        "iteration": 1, "slot": slot, "candidate_id": name, "origin": "new", "parent_id": "", "reward_key": "",
        "mapping_key": "", "reward_source": reward, "mapping_source": MAPPING,
        "reward_program": program(reward), "mapping_program": program(MAPPING), "beta": 1.0, "alpha": 0.8, "draw": 0,
        "policy": "fused", "epochs": 0, "failure": "",
    }  # fmt: skip


def folder_digest(folder: Path) -> list[tuple[str, str]]:
    return [(str(path.relative_to(folder)), digest(path)) for path in sorted(folder.rglob("*")) if path.is_file()]


def test_a_rung_does_not_depend_on_the_number_of_workers_and_survives_a_failed_candidate(
    small, small_start, tmp_path, monkeypatch, capsys
):
    gentler = REWARD.replace("1.5", "0.5")
    rows = [candidate_row("good", REWARD, 0), candidate_row("bad", NOT_FINITE, 1), candidate_row("calm", gentler, 2)]
    write_pool(tmp_path / "pool", rows, [], {"fused": small_start})
    for count in ("1", "3"):
        monkeypatch.setenv(WORKERS_VARIABLE, count)
        train_rung(read_pool(tmp_path / "pool"), small, 1, "1", 2, tmp_path / count)
        said = capsys.readouterr().out
        assert "iteration 1 rung 1: bad failed: its reward was not finite in 45.3% of the epoch's states" in said
        assert "iteration 1 rung 1: 3 candidates, " in said
    assert folder_digest(tmp_path / "1") == folder_digest(tmp_path / "3")
    trained = read_pool(tmp_path / "3")
    after = {row["candidate_id"]: row for row in trained.candidates}
    assert (after["good"]["policy"], after["good"]["epochs"], after["good"]["failure"]) == ("good", 2, "")
    assert (after["bad"]["policy"], after["bad"]["epochs"]) == ("fused", 0)
    assert after["bad"]["failure"].startswith("its reward was not finite")
    ranked = rank([score(row, trained.curves, small.eliminate) for row in trained.candidates])
    assert ranked[-1].candidate_id == "bad"
    # A candidate that is as old as the rung stays as it is, byte for byte.
    train_rung(trained, small, 1, "1", 2, tmp_path / "again")
    assert digest(policy_file(tmp_path / "again", "good")) == digest(policy_file(tmp_path / "3", "good"))


def test_workers_come_from_the_environment(monkeypatch):
    monkeypatch.setenv(WORKERS_VARIABLE, "3")
    assert workers() == 3
    monkeypatch.setenv(WORKERS_VARIABLE, "none")
    with pytest.raises(ParamsError, match="PORSE_WORKERS"):
        workers()


def test_epoch_means_are_over_environments_and_steps():
    means = EpochMeans()
    means.add({"a": torch.tensor([1.0, 3.0]), "b": torch.tensor([True, False])})
    means.add({"a": torch.tensor([5.0, 7.0]), "b": torch.tensor([False, False])})
    # (1 + 3 + 5 + 7) / 4 and (1 + 0 + 0 + 0) / 4
    assert means.take() == {"a": 4.0, "b": 0.25}
    assert means.take() == {}


class FakeTask:
    """Two environments: the first fails, the second meets the time limit."""

    NUM_ACTIONS, EPISODE_LENGTH, OVER_EPISODES, num_envs = 1, 5, False, 2
    is_asynchronous = False
    progress = torch.tensor([3, 5])

    def __init__(self):
        self.reset_mask = None

    def step(self, actions):
        pass

    def present(self):
        return {}

    def observations(self):
        return torch.zeros(2, 1)

    def terminated(self):
        return torch.tensor([True, False])

    def timed_out(self):
        return torch.tensor([True, True])

    def mean_fitness(self):
        return torch.tensor(0.0)

    def renew(self, mask):
        self.reset_mask = mask


class FakeReward:
    def see(self, task):
        assert task.reset_mask is None


def test_only_the_time_limit_alone_counts_as_a_time_out():
    task = FakeTask()
    _, ends, timed_out = TaskEnv(task, FakeReward()).step(torch.zeros(2, 1))
    assert ends.tolist() == [True, True]
    assert timed_out.tolist() == [False, True]
    assert task.reset_mask.tolist() == [True, True]


def test_a_checkpoint_reads_back_with_its_shapes_and_types(tmp_path):
    arrays = {"task.count": np.array(3), "actor.w": np.ones((2, 3), np.float32), "ppo.g": np.arange(4, dtype=np.uint8)}
    write_checkpoint(
        tmp_path / "c.safetensors", Checkpoint(arrays, {"kind": "checkpoint", "epoch": 4, "learning_rate": 0.5})
    )
    found = read_checkpoint(tmp_path / "c.safetensors")
    assert found.scalars == {"kind": "checkpoint", "epoch": 4, "learning_rate": 0.5}
    assert {name: (a.shape, a.dtype) for name, a in found.arrays.items()} == {
        name: (a.shape, a.dtype) for name, a in arrays.items()
    }
    assert list(found.policy()) == ["actor.w"]


def test_a_missing_and_a_damaged_checkpoint_are_told_apart(tmp_path, small, small_start):
    with pytest.raises(CheckpointError, match="no such file"):
        read_checkpoint(tmp_path / "none.safetensors")
    damaged = tmp_path / "damaged.safetensors"
    damaged.write_bytes(small_start.read_bytes()[:-10])
    with pytest.raises(CheckpointError, match="damaged"):
        read_checkpoint(damaged)
    other = tmp_path / "other.safetensors"
    write_checkpoint(other, policy_checkpoint({"actor.x": np.zeros(1, np.float32)}))
    with pytest.raises(CheckpointError, match=r"train\.hidden"):
        train_candidate(job(other, tmp_path / "x.safetensors"), small, lambda *_: None)


def test_no_checkpoint_is_a_pickle(small_start):
    assert small_start.read_bytes()[8:9] == b"{"


def test_the_numeric_profile_must_be_set_before_torch(monkeypatch):
    numerics.apply("portable")
    monkeypatch.setenv("MKL_CBWR", "AVX2")
    with pytest.raises(ParamsError, match="before torch is loaded"):
        numerics.apply("portable")


def test_a_cpu_without_the_instructions_of_the_profile_is_refused_before_it_traps(monkeypatch, tmp_path):
    # Of an Ivy Bridge, which has neither AVX2 nor FMA.
    info = "processor\t: 0\nmodel name\t: Xeon E5-2697 v2\nflags\t\t: fpu sse sse2 ssse3 sse4_1 sse4_2 avx f16c\n"
    (tmp_path / "cpuinfo").write_text(info * 2)
    monkeypatch.setattr(numerics, "_CPU_INFO", tmp_path / "cpuinfo")
    with pytest.raises(ParamsError, match=r"found one without avx2 and fma \(Xeon E5-2697 v2\)"):
        numerics.apply("portable")
    (tmp_path / "cpuinfo").write_text(info.replace("f16c", "f16c fma avx2"))
    numerics.apply("portable")
    # Another system, or another kind of CPU, lists them otherwise or not at all.
    (tmp_path / "cpuinfo").write_text("processor\t: 0\nFeatures\t: fp asimd\n")
    numerics.apply("portable")
    monkeypatch.setattr(numerics, "_CPU_INFO", tmp_path / "none")
    numerics.apply("portable")


def test_the_manifest_names_what_ran():
    found = numerics.manifest()
    assert found["package torch"].startswith("2.13.0")
    assert found["MKL_CBWR"] == "COMPATIBLE"
    assert found["cpu"]


def test_pools_leave_out_the_curves_of_others(tmp_path, small_start):
    row = {"iteration": 1, "rung": "1", "series": "fitness", "epoch": 1, "value": 0.0}
    curves = [{**row, "candidate_id": name} for name in ("in", "out")]
    write_pool(tmp_path / "p", [candidate_row("in", REWARD, 0)], curves, {"fused": small_start})
    assert [row["candidate_id"] for row in read_pool(tmp_path / "p").curves] == ["in"]
    assert tables.read(tmp_path / "p" / "candidates.parquet", tables.CANDIDATES)[0]["policy"] == "fused"
