"""Candidates from functions: a reward and a mapping of one slot are a pair; elites are carried over unchanged."""

from collections.abc import Sequence

from porse.config import Params
from porse.generation.functions import Function
from porse.identity import candidate_id
from porse.tables import Row

START_POLICY = "fused"
"""Stem of the policy that every candidate of an iteration starts from."""


def first_pool(functions: Sequence[Function], winner: Row | None, params: Params, iteration: int) -> list[Row]:
    """Returns the candidates that an iteration starts with, equal ones once, with the default alpha and beta.

    Args:
        functions: one reward and one mapping for each slot.
        winner: the previous winner, whose pair the last slots carry over; None in the first iteration.
        params: the run's parameters.
        iteration: from 1.
    """
    slots = sorted({function.slot for function in functions})
    found = {(function.kind, function.slot): function for function in functions}
    rows = [
        _candidate(
            params,
            iteration,
            slot,
            {
                "origin": "new",
                "parent_id": "",
                "reward_key": found["reward", slot].key,
                "mapping_key": found["mapping", slot].key,
                "reward_source": found["reward", slot].source,
                "mapping_source": found["mapping", slot].source,
            },
        )
        for slot in slots
    ]
    if winner is not None:
        pair = {name: winner[name] for name in ("reward_key", "mapping_key", "reward_source", "mapping_source")}
        elite = {"origin": "elite", "parent_id": winner["candidate_id"], **pair}
        rows += [_candidate(params, iteration, len(slots) + index, elite) for index in range(params.generate.elites)]
    return _distinct(rows)


def _candidate(params: Params, iteration: int, slot: int, content: Row) -> Row:
    defaults = params.candidate
    identity = candidate_id(
        params.task, content["reward_source"], content["mapping_source"], defaults.beta, defaults.alpha
    )
    return {
        "iteration": iteration,
        "slot": slot,
        "candidate_id": identity,
        **content,
        "beta": defaults.beta,
        "alpha": defaults.alpha,
        "policy": START_POLICY,
        "epochs": 0,
        "failure": "",
    }


def _distinct(rows: Sequence[Row]) -> list[Row]:
    """Returns the rows without later ones of equal content: training one candidate twice teaches nothing."""
    kept: dict[str, Row] = {}
    for row in rows:
        kept.setdefault(row["candidate_id"], row)
    return list(kept.values())
