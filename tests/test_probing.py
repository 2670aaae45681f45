"""The search of alpha, with a training whose result a pencil knows."""

import dataclasses

import numpy as np
import pytest

from porse.checkpoint import policy_checkpoint, read_checkpoint, write_checkpoint
from porse.pool import Pool, policy_file
from porse.training.job import Outcome
from porse.training.probing import search_alphas


def candidate(name, slot):
    return {
        "iteration": 2, "slot": slot, "candidate_id": name, "origin": "new", "parent_id": "", "reward_key": "",
        "mapping_key": "", "reward_source": f"def {name}", "mapping_source": "", "beta": 0.0, "alpha": 0.8, "draw": 0,
        "policy": "fused", "epochs": 0, "failure": "",
    }  # fmt: skip


@pytest.fixture
def pool(tmp_path):
    for stem, weight in (("best", 1.0), ("random", 0.0)):
        write_checkpoint(policy_file(tmp_path, stem), policy_checkpoint({"actor.w": np.full((2,), weight, np.float32)}))
    return Pool(tmp_path, [candidate("a", 0), candidate("b", 1)], [])


@pytest.fixture
def roska(params):
    return dataclasses.replace(params, probe=dataclasses.replace(params.probe, trainings=9, initial=6, least_epochs=1))


def peaked(rows, starts, until):
    """Fitness is highest at alpha 0.3 for a, at 0.9 for b; a's very first alpha, 0, fails."""
    peaks = {"def a": 0.3, "def b": 0.9}
    outcomes = []
    for row in rows:
        if row["reward_source"] == "def a" and row["alpha"] == 0.0:
            outcomes.append(Outcome([], "its reward was not finite"))
            continue
        fitness = -abs(row["alpha"] - peaks[row["reward_source"]])
        outcomes.append(Outcome([(1, "fitness", fitness), (1, "reward", 5.0)], ""))
    return outcomes


def test_each_candidate_ends_with_the_alpha_that_scored_best(pool, roska, tmp_path):
    probes = search_alphas(pool, roska, 6, tmp_path / "out", peaked)
    assert len(probes) == 2 * 9
    chosen = {probe.row["parent_id"]: probe for probe in probes if probe.chosen}
    for name, peak in (("a", 0.3), ("b", 0.9)):
        tried = [probe for probe in probes if probe.row["parent_id"] == name]
        assert chosen[name].alpha == min((p.alpha for p in tried if not p.row["failure"]), key=lambda a: abs(a - peak))
        assert abs(chosen[name].alpha - peak) <= 0.03
    assert [probe.row["slot"] for probe in probes] == list(range(18))
    assert {probe.row["origin"] for probe in probes} == {"probe"}


def test_a_probe_starts_from_the_fusion_with_its_own_alpha(pool, roska, tmp_path):
    seen = {}

    def train(rows, starts, until):
        seen.update(
            {row["alpha"]: read_checkpoint(start).arrays["actor.w"] for row, start in zip(rows, starts, strict=True)}
        )
        return peaked(rows, starts, until)

    search_alphas(pool, roska, 6, tmp_path / "out", train)
    # theta_best is 1 and theta_random 0 everywhere, so theta_f is alpha.
    assert all(array.tolist() == pytest.approx([alpha] * 2) for alpha, array in seen.items())
    assert {0.0, 0.2, 0.4, 0.6, 0.8, 1.0} <= set(seen)


def test_probes_are_as_old_as_they_were_trained_and_a_failed_one_says_why(pool, roska, tmp_path):
    probes = search_alphas(pool, roska, 6, tmp_path / "out", peaked)
    failed = [probe for probe in probes if probe.row["failure"]]
    assert [(probe.alpha, probe.row["parent_id"], probe.row["epochs"]) for probe in failed] == [(0.0, "a", 0)]
    assert {probe.row["epochs"] for probe in probes if not probe.row["failure"]} == {6}


def test_a_candidate_whose_probes_all_fail_is_one_that_failed(pool, roska, tmp_path):
    def fails(rows, starts, until):
        return [Outcome([], "it raised") for _ in rows]

    chosen = [probe for probe in search_alphas(pool, roska, 6, tmp_path / "out", fails) if probe.chosen]
    assert [probe.row["failure"] for probe in chosen] == ["it raised"] * 2
