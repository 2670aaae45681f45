"""Who is bred from whom when rewards evolve on islands, and who is admitted (Auto-REvolve).

The plan of an iteration follows from the members that it starts with and the run's seed alone, so that `generate`, which
asks, and `fuse`, which admits, agree on it without a word.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from porse.config import Params
from porse.identity import seed_for
from porse.search.feedback import feedback_rows
from porse.search.incumbent import feedback_mts
from porse.search.islands import Member, admit, choose_island, choose_operator, choose_parents, crowded, migrate, settle
from porse.tables import Row

PARENTS = {"mutation": 1, "crossover": 2}
"""How many parents each operator takes."""


@dataclass(frozen=True)
class Breeding:
    """How the reward of one slot comes about.

    Attributes:
        slot: place in the iteration.
        island: the island that it may enter.
        operator: "new" without parents, "mutation" of one, "crossover" of two.
        parents: their candidate ids, the first drawn first.
    """

    slot: int
    island: int
    operator: str
    parents: tuple[str, ...]


def plan(members: Sequence[Row], params: Params, iteration: int) -> list[Breeding]:
    """Returns one breeding for each slot; none where rewards do not evolve on islands.

    Args:
        members: rows of the members table that the iteration starts with; none in the first.
        params: the run's parameters.
        iteration: from 1.
    """
    if params.generate.parents != "islands":
        return []
    known = [member_of(row) for row in members]
    return [_breeding(slot, known, params, iteration) for slot in range(params.generate.candidates)]


def _breeding(slot: int, members: Sequence[Member], params: Params, iteration: int) -> Breeding:
    islands = params.islands
    rng = np.random.default_rng(seed_for(params.seed, "breeding", iteration, slot))
    if not members:
        return Breeding(slot, int(rng.integers(islands.count)), "new", ())
    operator = choose_operator(islands.crossover, rng)
    if operator == "crossover" and not crowded(members, 2):
        operator = "mutation"
    wanted = PARENTS[operator]
    # The operator is drawn first: with as few members as a run has, an island drawn first would often hold one alone, and
    # crossovers would be rarer than asked for.
    island = choose_island(crowded(members, wanted), islands.temperature, rng)
    parents = choose_parents(members, island, wanted, islands.temperature, rng)
    return Breeding(slot, island, operator, tuple(parent.candidate_id for parent in parents))


def member_of(row: Row) -> Member:
    """Returns the member that a row of the members table holds."""
    return Member(row["island"], row["candidate_id"], row["fitness"])


@dataclass(frozen=True)
class Population:
    """What an iteration hands on of the islands: rows of the members table and of the member-feedback table."""

    members: list[Row]
    feedback: list[Row]


def bred(
    before: Population, candidates: Sequence[Row], curves: Sequence[Row], params: Params, iteration: int
) -> Population:
    """Returns the population after an iteration: its candidates enter or ask to, then islands may exchange members.

    Candidates of the first iteration enter whatever their fitness is; later ones ask, by the mean of their island.

    Args:
        before: what the iteration started from; empty where rewards do not evolve on islands, and so is the result.
        candidates: the trained candidates; those that failed do not enter.
        curves: their series.
        params: the run's parameters.
        iteration: from 1.
    """
    if params.generate.parents != "islands":
        return Population([], [])
    islands = params.islands
    slots = {breeding.slot: breeding.island for breeding in plan(before.members, params, iteration)}
    known = [member_of(row) for row in before.members]
    sources = {row["candidate_id"]: row["reward_source"] for row in [*before.members, *candidates]}
    told = {row["candidate_id"]: list[Row]() for row in before.members}
    for row in before.feedback:
        told[row["candidate_id"]].append(row)
    enter = admit if before.members else settle
    for row in sorted(candidates, key=lambda row: row["slot"]):
        name = row["candidate_id"]
        if row["failure"] or name in told or row["slot"] not in slots:
            continue
        told[name] = [{"candidate_id": name, **point} for point in feedback_rows(curves, name, params.fuse.points)]
        known = enter(known, Member(slots[row["slot"]], name, feedback_mts(told[name])), islands.size)
    rng = np.random.default_rng(seed_for(params.seed, "migration", iteration))
    known = migrate(known, islands.migration, islands.temperature, rng)
    return Population([_row(member, sources) for member in known], [row for m in known for row in told[m.candidate_id]])


def _row(member: Member, sources: Mapping[str, str]) -> Row:
    return {
        "island": member.island,
        "candidate_id": member.candidate_id,
        "fitness": member.fitness,
        "reward_source": sources[member.candidate_id],
    }
