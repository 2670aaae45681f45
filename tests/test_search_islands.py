import math
from collections import Counter
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from porse.search.islands import (
    Member,
    admit,
    choose_island,
    choose_operator,
    choose_parents,
    migrate,
    softmax,
)


def rng(seed=0):
    return np.random.default_rng(seed)


def island(number, **fitness):
    return [Member(number, name, value) for name, value in fitness.items()]


def names(members):
    return [(member.island, member.candidate_id) for member in members]


FITNESS = st.integers(-3, 3).map(float)
MEMBERS = st.lists(st.tuples(st.integers(0, 4), FITNESS), min_size=1, max_size=20).map(
    lambda rows: [Member(number, f"c{index:02}", fitness) for index, (number, fitness) in enumerate(rows)]
)


def test_softmax_with_a_pencil():
    # exp(0) : exp(ln 3) = 1 : 3; at temperature 2 the ratio is its root
    assert softmax([0.0, math.log(3)], 1.0) == pytest.approx([0.25, 0.75])
    assert softmax([0.0, math.log(9)], 2.0) == pytest.approx([0.25, 0.75])
    assert softmax([5.0, 5.0], 0.1) == [0.5, 0.5]


def test_softmax_does_not_overflow():
    assert softmax([1e300, 0.0], 1e-3) == [1.0, 0.0]
    assert softmax([-1e300, -1e300], 1e-3) == [0.5, 0.5]


@pytest.mark.parametrize(
    ("values", "temperature"), [([], 1.0), ([float("nan")], 1.0), ([-math.inf], 1.0), ([1.0], 0.0), ([1.0], -2.0)]
)
def test_softmax_refuses_what_has_no_probabilities(values, temperature):
    with pytest.raises(ValueError, match="temperature above zero"):
        softmax(values, temperature)


def test_islands_are_drawn_by_their_mean_fitness():
    # means 0 and ln 3, so 1 : 3; the sums, 0 and 2 ln 3, would give 1 : 9
    members = island(2, a=-1.0, b=1.0) + island(7, c=0.0, d=2 * math.log(3))
    generator = rng()
    drawn = Counter(choose_island(members, 1.0, generator) for _ in range(4000))
    assert set(drawn) == {2, 7}
    assert drawn[7] / 4000 == pytest.approx(0.75, abs=0.03)


def test_parents_are_drawn_by_fitness_from_their_island_alone():
    members = island(1, low=0.0, high=math.log(3)) + island(2, other=50.0)
    generator = rng()
    drawn = Counter(choose_parents(members, 1, 1, 1.0, generator)[0].candidate_id for _ in range(4000))
    assert set(drawn) == {"low", "high"}
    assert drawn["high"] / 4000 == pytest.approx(0.75, abs=0.03)


def test_two_parents_are_two_members():
    # 1 : 2 : 3. First a with 1/6; b then a with 2/6 x 1/4, c then a with 3/6 x 1/3: a is among them with 5/12.
    members = island(1, a=0.0, b=math.log(2), c=math.log(3))
    generator = rng()
    pairs = [names(choose_parents(members, 1, 2, 1.0, generator)) for _ in range(4000)]
    assert all(len(set(pair)) == 2 for pair in pairs)
    assert sum((1, "a") in pair for pair in pairs) / 4000 == pytest.approx(5 / 12, abs=0.03)


def test_an_island_with_too_few_members_gives_all_it_has():
    members = island(1, a=0.0, b=-1e6)
    # b is drawn although its probability beside a is zero in floating point
    assert names(choose_parents(members, 1, 3, 1.0, rng())) == [(1, "a"), (1, "b")]
    assert choose_parents(members, 2, 2, 1.0, rng()) == []


def test_a_child_enters_when_it_reaches_its_islands_mean():
    members = island(1, a=1.0, b=3.0) + island(2, c=100.0)
    assert names(admit(members, Member(1, "d", 2.0), 8)) == [(1, "b"), (1, "d"), (1, "a"), (2, "c")]
    assert admit(members, Member(1, "d", 1.9), 8) == [members[1], members[0], members[2]]


def test_an_equal_child_enters_whatever_the_rounding_of_the_mean():
    # fsum of three 2.7 divided by 3 is 2.7000000000000006
    members = island(1, a=2.7, b=2.7, c=2.7)
    assert math.fsum([2.7] * 3) / 3 > 2.7
    assert len(admit(members, Member(1, "d", 2.7), 8)) == 4


def test_an_empty_island_takes_every_child():
    assert names(admit(island(2, c=100.0), Member(1, "d", -1e9), 8)) == [(1, "d"), (2, "c")]


def test_the_worst_leaves_a_full_island():
    members = island(1, a=1.0, b=3.0, c=0.0)
    assert names(admit(members, Member(1, "d", 2.0), 3)) == [(1, "b"), (1, "d"), (1, "a")]
    # four equals: that of the highest id leaves, also when it is the child
    equals = island(1, a=1.0, b=1.0, d=1.0)
    assert names(admit(equals, Member(1, "c", 1.0), 3)) == [(1, "a"), (1, "b"), (1, "c")]
    assert names(admit(equals, Member(1, "e", 1.0), 3)) == [(1, "a"), (1, "b"), (1, "d")]


@given(MEMBERS, st.integers(0, 5), FITNESS, st.integers(1, 6))
def test_admission_follows_the_exact_mean_and_the_size(members, number, fitness, size):
    before = [member for member in members if member.island == number]
    after = admit(members, Member(number, "child", fitness), size)
    enters = not before or Fraction(fitness) >= sum(map(Fraction, (m.fitness for m in before))) / len(before)
    best = sorted([*before, Member(number, "child", fitness)], key=lambda m: (-m.fitness, m.candidate_id))[:size]
    assert [m for m in after if m.island == number] == (best if enters else sorted(before, key=lambda m: -m.fitness))
    assert {m for m in after if m.island != number} == {m for m in members if m.island != number}


def test_without_a_migration_nothing_changes():
    members = island(1, a=1.0, b=2.0) + island(2, c=0.0, d=-1.0)
    assert migrate(members, 0.0, 1.0, rng()) == [members[1], members[0], members[2], members[3]]


def test_a_migration_resets_the_weaker_half_and_moves_members_over():
    # By best member: island 3 (9), island 1 (5), island 2 (4), island 4 (3): 3 and 1 are the stronger half. Island 1 has
    # no member but its best, so both receive from island 3: of e and f, one each.
    members = (
        island(1, a=5.0) + island(2, b=4.0, c=1.0, x=0.0) + island(3, d=9.0, e=1.0, f=1.0) + island(4, g=3.0, h=2.0)
    )
    for seed in range(20):
        after = migrate(members, 1.0, 1.0, rng(seed))
        by_island = {n: {m.candidate_id for m in after if m.island == n} for n in (1, 2, 3, 4)}
        assert by_island[1] == {"a"}
        assert by_island[3] == {"d"}
        assert {frozenset(by_island[2] - {"b"}), frozenset(by_island[4] - {"g"})} == {frozenset("e"), frozenset("f")}
        assert all(m.fitness == 1.0 for m in after if m.candidate_id in "ef")


def test_who_moves_is_drawn_by_fitness_and_is_never_the_best():
    members = island(1, best=9.0, low=0.0, high=math.log(3)) + island(2, weak=-1.0)
    generator = rng()
    moved = Counter(
        next(
            m.candidate_id for m in migrate(members, 1.0, 1.0, generator) if m.island == 2 and m.candidate_id != "weak"
        )
        for _ in range(4000)
    )
    assert set(moved) == {"low", "high"}
    assert moved["high"] / 4000 == pytest.approx(0.75, abs=0.03)


def test_the_donor_is_drawn_evenly_from_the_stronger_half():
    members = island(1, a=9.0, b=8.0) + island(2, c=7.0, d=-50.0) + island(3, e=0.0) + island(4, f=-1.0)
    generator = rng()
    first = Counter(
        next(m.candidate_id for m in migrate(members, 1.0, 1.0, generator) if m.island == 3 and m.candidate_id != "e")
        for _ in range(4000)
    )
    assert set(first) == {"b", "d"}
    assert first["b"] / 4000 == pytest.approx(0.5, abs=0.03)


def test_with_nobody_to_give_the_weaker_half_only_loses():
    members = island(1, a=2.0) + island(2, b=1.0, c=0.0)
    assert names(migrate(members, 1.0, 1.0, rng())) == [(1, "a"), (2, "b")]


def test_the_middle_island_of_three_is_of_the_stronger_half():
    members = island(1, a=1.0, x=0.5) + island(2, b=2.0, y=0.5) + island(3, c=3.0, z=0.5)
    for seed in range(10):
        after = migrate(members, 1.0, 1.0, rng(seed))
        [newcomer] = {m.candidate_id for m in after if m.island == 1} - {"a"}
        assert newcomer in {"y", "z"}
        assert {m.candidate_id for m in after} == {"a", "b", "c", "y", "z"}


def test_one_island_alone_stays_as_it_is():
    members = island(1, b=2.0, a=1.0)
    assert migrate(members, 1.0, 1.0, rng()) == members


def test_a_migration_happens_as_often_as_it_should():
    members = island(1, a=2.0) + island(2, b=1.0, c=0.0)
    generator = rng()
    happened = sum(len(migrate(members, 0.3, 1.0, generator)) == 2 for _ in range(4000))
    assert happened / 4000 == pytest.approx(0.3, abs=0.03)


@given(MEMBERS, st.integers(0, 2**32))
def test_a_migration_invents_nobody_and_keeps_every_best(members, seed):
    after = migrate(members, 1.0, 1.0, rng(seed))
    assert len(set(after)) == len(after)
    assert {m.candidate_id: m.fitness for m in after}.items() <= {m.candidate_id: m.fitness for m in members}.items()
    for number in {m.island for m in members}:
        best = min((m for m in members if m.island == number), key=lambda m: (-m.fitness, m.candidate_id))
        assert best in after


@given(MEMBERS, st.randoms(use_true_random=False), st.integers(0, 2**32))
def test_the_order_of_the_members_does_not_matter(members, random, seed):
    shuffled = members[:]
    random.shuffle(shuffled)
    first = members[0].island
    assert choose_island(members, 1.0, rng(seed)) == choose_island(shuffled, 1.0, rng(seed))
    assert choose_parents(members, first, 2, 1.0, rng(seed)) == choose_parents(shuffled, first, 2, 1.0, rng(seed))
    assert migrate(members, 0.5, 1.0, rng(seed)) == migrate(shuffled, 0.5, 1.0, rng(seed))
    child = Member(first, "child", 0.0)
    assert admit(members, child, 3) == admit(shuffled, child, 3)


def test_operators_are_drawn_by_their_probability():
    generator = rng()
    drawn = Counter(choose_operator(0.25, generator) for _ in range(4000))
    assert set(drawn) == {"crossover", "mutation"}
    assert drawn["crossover"] / 4000 == pytest.approx(0.25, abs=0.03)
    assert choose_operator(1.0, generator) == "crossover"
    assert choose_operator(0.0, generator) == "mutation"


class Drawn:
    """A generator whose next number is known."""

    def __init__(self, number):
        self.number = number

    def random(self):
        return self.number


def test_what_has_a_probability_happens_where_the_draw_is_below_it_and_not_where_it_is_that():
    # draws are of [0, 1): where they were 0 alone, a probability of 0 would happen
    assert [choose_operator(0.25, Drawn(draw)) for draw in (0.2499, 0.25)] == ["crossover", "mutation"]
    assert choose_operator(0.0, Drawn(0.0)) == "mutation"
    members = island(1, a=2.0) + island(2, b=1.0, c=0.0)
    assert [len(migrate(members, 0.25, 1.0, Drawn(draw))) for draw in (0.2499, 0.25)] == [2, 3]
    assert migrate(members, 0.0, 1.0, Drawn(0.0)) == members


def test_of_islands_whose_best_are_equal_that_of_the_lower_id_is_the_stronger_one():
    # b of island 2 comes before c of island 1, whoever else lives there: island 1 loses a and receives d
    members = island(1, c=5.0, a=0.0) + island(2, b=5.0, d=0.0)
    assert names(migrate(members, 1.0, 1.0, rng())) == [(1, "c"), (1, "d"), (2, "b")]
