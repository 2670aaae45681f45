"""Islands from iteration to iteration, and whom an iteration hands on."""

import dataclasses

import pytest

from porse.search.breeding import Population, bred, plan
from porse.search.incumbent import feedback_mts, incumbent


@pytest.fixture(scope="module")
def revolve(params):
    generate = dataclasses.replace(params.generate, parents="islands", candidates=4, elites=0)
    islands = dataclasses.replace(params.islands, count=2, size=2, migration=0.0, crossover=1.0)
    return dataclasses.replace(params, generate=generate, islands=islands)


def member(island, name, fitness):
    return {"island": island, "candidate_id": name, "fitness": fitness, "reward_source": f"def {name}"}


def candidate(name, slot, failure=""):
    return {
        "iteration": 1, "slot": slot, "candidate_id": name, "reward_source": f"def {name}", "failure": failure,
        "epochs": 2,
    }  # fmt: skip


def curves(**fitness):
    return [
        {"iteration": 1, "rung": "1", "candidate_id": name, "series": "fitness", "epoch": epoch, "value": value}
        for name, values in fitness.items()
        for epoch, value in enumerate(values, 1)
    ]


def test_the_first_iteration_breeds_from_nobody_on_random_islands(revolve):
    first = plan([], revolve, 1)
    assert [(breeding.slot, breeding.operator, breeding.parents) for breeding in first] == [
        (slot, "new", ()) for slot in range(4)
    ]
    assert {breeding.island for breeding in first} <= {0, 1}
    assert plan([], revolve, 1) == first


def test_a_crossover_has_two_parents_of_one_island_and_a_lonely_member_mutates(revolve):
    members = [member(0, "a", 1.0), member(0, "b", 1.0)]
    assert {(b.operator, b.island, frozenset(b.parents)) for b in plan(members, revolve, 2)} == {
        ("crossover", 0, frozenset({"a", "b"}))
    }
    assert {(b.operator, b.parents) for b in plan(members[:1], revolve, 2)} == {("mutation", ("a",))}


def test_where_the_winner_is_refined_nobody_is_bred(params):
    assert plan([], params, 1) == []
    assert bred(Population([], []), [candidate("a", 0)], curves(a=[1.0]), params, 1) == Population([], [])


def test_children_enter_their_island_with_their_mts_and_what_was_seen_of_them(revolve):
    slots = {breeding.slot: breeding.island for breeding in plan([], revolve, 1)}
    rows = [candidate("a", 0), candidate("b", 1, failure="its reward was not finite")]
    after = bred(Population([], []), rows, curves(a=[3.0, 1.0], b=[9.0]), revolve, 1)
    assert after.members == [member(slots[0], "a", 3.0)]
    assert [(row["candidate_id"], row["epoch"], row["value"], row["maximum"]) for row in after.feedback] == [
        ("a", 1, 3.0, 3.0),
        ("a", 2, 1.0, 3.0),
    ]


def test_a_child_below_its_islands_mean_stays_out_and_a_full_island_loses_its_worst(revolve):
    one_island = dataclasses.replace(revolve, islands=dataclasses.replace(revolve.islands, count=1))
    told = [
        {"candidate_id": name, "series": "fitness", "epoch": 1, "value": 0.0, "maximum": 0.0, "mean": 0.0, "minimum": 0.0}
        for name in "xy"
    ]  # fmt: skip
    before = Population([member(0, "x", 1.0), member(0, "y", 3.0)], told)
    rows = [candidate("low", 0), candidate("high", 1)]
    after = bred(before, rows, curves(low=[1.9], high=[2.0]), one_island, 2)
    # The mean is 2: 1.9 stays out, 2.0 enters, and x leaves an island of two.
    assert [row["candidate_id"] for row in after.members] == ["y", "high"]
    assert {row["candidate_id"] for row in after.feedback} == {"y", "high"}


def test_a_member_that_is_bred_again_is_not_a_second_member(revolve):
    one_island = dataclasses.replace(revolve, islands=dataclasses.replace(revolve.islands, count=1))
    first = bred(Population([], []), [candidate("a", 0)], curves(a=[1.0]), one_island, 1)
    assert bred(first, [candidate("a", 0)], curves(a=[5.0]), one_island, 2) == first


@pytest.mark.parametrize(("score", "stays"), [(0.5, True), (1.0, True), (1.5, False)])
def test_the_best_incumbent_stays_until_its_score_is_exceeded(params, score, stays):
    best = dataclasses.replace(params, fuse=dataclasses.replace(params.fuse, incumbent="best"))
    # (2 + 0) / 2 = 1
    earlier = incumbent([candidate("old", 0)], curves(old=[2.0, 0.0]), [], [], [], best)
    assert (feedback_mts(earlier.feedback), earlier.score["score"], earlier.is_new) == (2.0, 1.0, True)
    later = incumbent(
        [candidate("new", 0)], curves(new=[score]), [earlier.row], [earlier.score], earlier.feedback, best
    )
    assert (later.row["candidate_id"] == "old") == stays == (not later.is_new)
    assert later.score["score"] == max(score, 1.0)


def test_the_latest_winner_is_the_incumbent_even_when_it_is_worse(params):
    earlier = incumbent([candidate("old", 0)], curves(old=[2.0]), [], [], [], params)
    later = incumbent(
        [candidate("new", 0)], curves(new=[1.0]), [earlier.row], [earlier.score], earlier.feedback, params
    )
    assert later.row["candidate_id"] == "new"


def test_the_winner_is_the_best_of_the_last_pool(params):
    rows = [candidate("a", 0), candidate("b", 1), {**candidate("young", 2), "epochs": 1}]
    found = incumbent(rows, curves(a=[1.0, 1.0], b=[1.0, 2.0], young=[9.0]), [], [], [], params)
    assert found.row["candidate_id"] == "b"
