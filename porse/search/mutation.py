"""Mutants of the best survivor: the model's values as a swarm around it, moved by one particle-swarm step."""

from collections.abc import Sequence

import numpy as np

from porse.config import MutateParams
from porse.identity import candidate_id, seed_for
from porse.search.schedule import ALPHA, BETA, DRAW
from porse.tables import Row

_DIGITS = 6
"""Decimals of a mutated value: enough to tell values apart, few enough to read."""


def swarm_step(
    proposed: Sequence[float],
    survivor: float,
    memory: float,
    bounds: tuple[float, float],
    params: MutateParams,
    seed: int,
) -> list[float]:
    """Returns the values after one particle-swarm step (Kennedy and Eberhart, 1995), inside `bounds`.

    Particle i sits at the model's value x_i, with the velocity that took it there from the survivor, v_i = x_i - survivor:
    x_i + inertia v_i + cognitive r1 (memory - x_i) + social r2 (survivor - x_i), r1 and r2 uniform on [0, 1).

    Args:
        proposed: the model's values.
        survivor: the best survivor's value.
        memory: the value of the previous iteration's winner.
        bounds: smallest and largest value.
        params: the weights; with all of them zero the values stay as they are.
        seed: names the draws.
    """
    draws = np.random.default_rng(seed).random((len(proposed), 2))
    moved = [
        x + params.inertia * (x - survivor) + params.cognitive * r1 * (memory - x) + params.social * r2 * (survivor - x)
        for x, (r1, r2) in zip(proposed, draws.tolist(), strict=True)
    ]
    low, high = bounds
    return [round(min(max(value, low), high), _DIGITS) for value in moved]


def mutant(task: str, parent: Row, varied: str, value: float, slot: int, policy: str) -> Row:
    """Returns the candidate that differs from `parent` in beta, alpha or its draws alone; its code is never changed.

    Args:
        task: the task's name.
        parent: the best survivor's row.
        varied: "beta", "alpha" or "draw".
        value: the mutated value; of a draw its number, from 1.
        slot: its place in the iteration.
        policy: stem of the file of its first policy.
    """
    own = {BETA: parent["beta"], ALPHA: parent["alpha"], DRAW: parent["draw"], varied: value}
    own[DRAW] = int(own[DRAW])
    identity = candidate_id(task, parent["reward_source"], parent["mapping_source"], own[BETA], own[ALPHA], own[DRAW])
    return {
        **parent,
        **own,
        "slot": slot,
        "candidate_id": identity,
        "origin": "mutant",
        "parent_id": parent["candidate_id"],
        "policy": policy,
        "epochs": 0,
        "failure": "",
    }


def swarm_seed(seed: int, iteration: int) -> int:
    """Returns the seed of an iteration's swarm step."""
    return seed_for(seed, "swarm", iteration)
