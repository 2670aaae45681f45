"""What the steps of an iteration hand on, by pencil: which policies are fused, with which share, and whose episodes are played."""

import dataclasses

import numpy as np
import pytest

from meaning_cases import changed, row_of
from porse import tables
from porse.checkpoint import policy_checkpoint, read_checkpoint, write_checkpoint
from porse.config import Iteration
from porse.pool import BEST, RANDOM, START_POLICY, policy_file, write_pool
from porse.steps.evaluate import evaluate
from porse.steps.fuse import fuse
from porse.training.start import random_policy


def policy(weight, seen):
    """A policy whose weights are all equal, and what its normaliser has seen."""
    return policy_checkpoint(
        {
            "actor.mlp.weight": np.array([weight, weight], np.float32),
            "critic.mlp.weight": np.array([weight], np.float32),
            "actor.obs_normalizer._mean": np.array([seen], np.float32),
        }
    )


def candidate(iteration, name, **values):
    return row_of(tables.CANDIDATES, iteration=iteration, candidate_id=name, **values)


def fitness(iteration, name, value):
    return row_of(
        tables.CURVES, iteration=iteration, rung="6", candidate_id=name, series="fitness", epoch=1, value=value
    )


def write_start(folder, winner=None, score=0.0):
    """Writes what an iteration starts from: the candidate that the one before handed on, if any."""
    won = {"iteration": winner["iteration"], "candidate_id": winner["candidate_id"]} if winner else {}
    rows = {
        tables.CANDIDATES: ("winner", [winner] if winner else []),
        tables.SURVIVORS: ("score", [row_of(tables.SURVIVORS, rung="6", score=score, **won)] if winner else []),
        tables.FEEDBACK: ("feedback", []),
        tables.MEMBERS: ("members", []),
        tables.MEMBER_FEEDBACK: ("member_feedback", []),
    }
    for table, (name, lines) in rows.items():
        tables.write(folder / f"{name}.parquet", table, lines)


@pytest.fixture
def fusing(params, tmp_path, monkeypatch):
    """A pool of a loser and a winner with shares of their own, and parameters with another share."""
    drawn = []

    def drawing(_, iteration):
        drawn.append(iteration)
        return policy(8.0, 80.0)

    monkeypatch.setattr("porse.training.start.random_policy", drawing)
    write_checkpoint(tmp_path / "win.safetensors", policy(4.0, 40.0))
    write_checkpoint(tmp_path / "lose.safetensors", policy(-16.0, -160.0))
    pool = [candidate(2, "a", slot=0, policy="lose", alpha=0.125), candidate(2, "b", slot=1, policy="win", alpha=0.5)]
    write_pool(
        tmp_path / "pool",
        pool,
        [fitness(2, "a", 0.25), fitness(2, "b", 0.75)],
        {stem: tmp_path / f"{stem}.safetensors" for stem in ("win", "lose")},
    )
    write_start(tmp_path / "start")
    return changed(params, candidate={"alpha": 0.75}, eliminate={"window": 1}), drawn


def test_the_next_iteration_starts_with_the_default_share_of_the_winner_whatever_share_the_winner_had(fusing, tmp_path):
    """Algorithm 1, line 15: each iteration starts with the default alpha. Of 4 and 8, 0.75 x 4 + 0.25 x 8 is 5.

    The winner's own share, 0.5, would give 6; the two exchanged, 0.25 x 4 + 0.75 x 8, would give 7.
    """
    params, drawn = fusing
    fuse(params, 2, tmp_path / "start", tmp_path / "pool", tmp_path / "out")
    found = {stem: read_checkpoint(policy_file(tmp_path / "out", stem)) for stem in (BEST, RANDOM, START_POLICY)}
    for name in ("actor.mlp.weight", "critic.mlp.weight"):
        assert {stem: {*each.arrays[name].tolist()} for stem, each in found.items()} == {
            BEST: {4.0}, RANDOM: {8.0}, START_POLICY: {5.0},
        }  # fmt: skip
    # What was seen is the winner's, and the random policy is that of the iteration to come.
    assert found[START_POLICY].arrays["actor.obs_normalizer._mean"].tolist() == [40.0]
    assert drawn == [3]
    (row,) = tables.read(tmp_path / "out" / "winner.parquet", tables.CANDIDATES)
    assert (row["candidate_id"], row["alpha"]) == ("b", 0.5)


def test_without_fusion_the_next_iteration_starts_from_the_random_policy_as_it_was_drawn(fusing, tmp_path):
    params, _ = fusing
    fuse(changed(params, fuse={"policy": "random"}), 2, tmp_path / "start", tmp_path / "pool", tmp_path / "out")
    found = read_checkpoint(policy_file(tmp_path / "out", START_POLICY))
    assert (found.arrays["actor.mlp.weight"].tolist(), found.arrays["actor.obs_normalizer._mean"].tolist()) == (
        [8.0, 8.0],
        [80.0],
    )


def test_the_last_link_of_the_lineage_plays_the_episodes(small, tmp_path):
    chosen = dataclasses.replace(small, iterations=(Iteration(1, 2), Iteration(2, "result")))
    chosen = changed(chosen, evaluate={"seeds": 0, "episodes": 2}, fuse={"pool": "eliminate-6"})
    for iteration, name in ((1, "first"), (2, "last")):
        write_start(
            tmp_path / str(chosen.iterations[iteration - 1].next) / "start",
            candidate(iteration, name, policy=f"{name}-policy"),
        )
        pool = tmp_path / str(iteration) / "eliminate-6"
        write_checkpoint(policy_file(pool, f"{name}-policy"), random_policy(chosen, iteration))
    said = evaluate(chosen, tmp_path, tmp_path)
    episodes = tables.read(tmp_path / "episodes.parquet", tables.EPISODES)
    assert [(row["episode"], row["candidate_id"]) for row in episodes] == [(0, "last"), (1, "last")]
    assert said.startswith("2 links of the winning lineage, 0 further seeds")
