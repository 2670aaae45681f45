"""Islands of candidates (Auto-REvolve; Hazra et al., ICLR 2025): who becomes a parent, who is admitted, who moves.

Only candidates whose training did not fail are members. Results do not depend on the order in which members are given:
islands are taken by number, members of an island best first, equal ones by candidate id.
"""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np


@dataclass(frozen=True)
class Member:
    """A candidate on an island, with its fitness (higher is better)."""

    island: int
    candidate_id: str
    fitness: float


def softmax(values: Sequence[float], temperature: float) -> list[float]:
    """Returns the probabilities exp(value / temperature) / sum.

    Raises:
        ValueError: there is no value, one is not finite, or the temperature is not above zero.
    """
    if not values or not all(map(math.isfinite, values)) or temperature <= 0.0:
        raise ValueError(
            f"expected finite values and a temperature above zero, found {list(values)} and {temperature};"
            " leave out candidates that failed"
        )
    # The highest value is subtracted first: exp then never overflows.
    powers = [math.exp((value - max(values)) / temperature) for value in values]
    total = math.fsum(powers)
    return [power / total for power in powers]


def choose_island(members: Sequence[Member], temperature: float, rng: np.random.Generator) -> int:
    """Returns an island that has members, drawn by the softmax of the islands' mean fitness.

    Raises:
        ValueError: there are no members, or a fitness is not finite.
    """
    islands = _islands(members)
    means = [_mean_fitness(_residents(members, island)) for island in islands]
    return islands[_draw(means, temperature, rng)]


def choose_parents(
    members: Sequence[Member], island: int, count: int, temperature: float, rng: np.random.Generator
) -> list[Member]:
    """Returns `count` members of `island` drawn one after another by the softmax of their fitness, none of them twice.

    An island with fewer members gives all it has, in drawn order.
    """
    left = _residents(members, island)
    drawn: list[Member] = []
    while left and len(drawn) < count:
        drawn.append(left.pop(_draw([member.fitness for member in left], temperature, rng)))
    return drawn


def crowded(members: Sequence[Member], count: int) -> list[Member]:
    """Returns the members of the islands that have at least `count` of them."""
    return [member for member in members if len(_residents(members, member.island)) >= count]


def settle(members: Sequence[Member], child: Member, size: int) -> list[Member]:
    """Returns the members after `child` entered its island.

    If the island then has more than `size` members, its worst leaves; of equal ones, that of the highest candidate id.
    """
    others = [member for member in members if member.island != child.island]
    return _ordered(others + _ordered([*_residents(members, child.island), child])[:size])


def admit(members: Sequence[Member], child: Member, size: int) -> list[Member]:
    """Returns the members after `child` asked to enter its island.

    It enters when its fitness is at least the island's mean, or when the island is empty.
    """
    residents = _residents(members, child.island)
    if residents and child.fitness < _mean_fitness(residents):
        return _ordered(members)
    return settle(members, child, size)


def migrate(
    members: Sequence[Member], probability: float, temperature: float, rng: np.random.Generator
) -> list[Member]:
    """Returns the members after a migration, which happens with `probability`.

    The islands are ranked by their best member. The weaker half of them (of an odd number, the smaller half) keep only
    that one. Each of them, the strongest first, then receives one member that moves over from an island of the stronger
    half: the island drawn evenly among those that have more than their best member left, the member by the softmax of
    fitness among all but the best.
    """
    if rng.random() >= probability:
        return _ordered(members)
    groups = {island: _residents(members, island) for island in _islands(members)}
    ranking = sorted(groups, key=lambda island: (-groups[island][0].fitness, groups[island][0].candidate_id, island))
    split = len(ranking) - len(ranking) // 2
    for island in ranking[split:]:
        del groups[island][1:]
        donors = [donor for donor in ranking[:split] if len(groups[donor]) > 1]
        if donors:
            donor = donors[int(rng.integers(len(donors)))]
            place = 1 + _draw([member.fitness for member in groups[donor][1:]], temperature, rng)
            moved = groups[donor].pop(place)
            groups[island].append(Member(island, moved.candidate_id, moved.fitness))
    return _ordered([member for group in groups.values() for member in group])


def choose_operator(crossover_probability: float, rng: np.random.Generator) -> Literal["crossover", "mutation"]:
    """Returns "crossover" with the given probability, else "mutation"."""
    return "crossover" if rng.random() < crossover_probability else "mutation"


def _draw(values: Sequence[float], temperature: float, rng: np.random.Generator) -> int:
    """Returns an index, drawn by the softmax of `values`."""
    return int(rng.choice(len(values), p=softmax(values, temperature)))


def _ordered(members: Sequence[Member]) -> list[Member]:
    """Returns the members by island, the best first, equal ones by candidate id."""
    return sorted(members, key=lambda member: (member.island, -member.fitness, member.candidate_id))


def _islands(members: Sequence[Member]) -> list[int]:
    """Returns the numbers of the islands that have members, rising."""
    return sorted({member.island for member in members})


def _residents(members: Sequence[Member], island: int) -> list[Member]:
    """Returns the members of one island, best first."""
    return _ordered([member for member in members if member.island == island])


def _mean_fitness(residents: Sequence[Member]) -> float:
    # Exact until it is rounded once: fsum(values) / n rounds twice, and three members of fitness 2.7 would then have a
    # mean above 2.7 and turn away a fourth.
    return statistics.mean(member.fitness for member in residents)
