"""Candidates from functions: a reward and a mapping of one slot are a pair; elites are carried over unchanged."""

from collections.abc import Mapping, Sequence

from porse.config import Params
from porse.generation.functions import Function
from porse.identity import candidate_id
from porse.pool import START_POLICY
from porse.search.breeding import Breeding
from porse.search.schedule import is_searched
from porse.tables import Row

_PARTS = ("key", "source", "program")
"""What a candidate's row holds of a function."""


def first_pool(
    functions: Sequence[Function],
    winner: Row | None,
    breedings: Mapping[int, Breeding],
    params: Params,
    iteration: int,
) -> list[Row]:
    """Returns the candidates that an iteration starts with, equal ones once, with the default alpha and beta.

    Args:
        functions: for each slot one function of each kind that candidates are made of.
        winner: the previous winner, whose functions the last slots carry over; None in the first iteration.
        breedings: slot -> how its reward was bred; empty where rewards do not evolve on islands.
        params: the run's parameters.
        iteration: from 1.
    """
    if not is_searched(params, iteration):
        return []
    elites = params.generate.elites if winner is not None else 0
    new = params.generate.candidates - elites
    found = {(function.kind, function.slot): function for function in functions}
    rows = []
    for slot in range(new):
        bred = breedings.get(slot)
        reward, mapping = found.get(("reward", slot)), found.get(("mapping", slot))
        content = {
            "origin": bred.operator if bred else "new",
            "parent_id": "+".join(bred.parents) if bred else "",
            "reward_key": reward.key if reward else "",
            "mapping_key": mapping.key if mapping else "",
            "reward_source": reward.source if reward else "",
            "mapping_source": mapping.source if mapping else "",
            "reward_program": reward.program if reward else "",
            "mapping_program": mapping.program if mapping else "",
        }
        rows.append(_candidate(params, iteration, slot, content))
    if winner is not None:
        pair = {f"{kind}_{part}": winner[f"{kind}_{part}"] for kind in ("reward", "mapping") for part in _PARTS}
        elite = {"origin": "elite", "parent_id": winner["candidate_id"], **pair}
        rows += [_candidate(params, iteration, new + index, elite) for index in range(elites)]
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
        "draw": 0,
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
