"""Islands from iteration to iteration, and whom an iteration hands on."""

import dataclasses

import numpy as np
import pytest

from porse.config import parse_params
from porse.search.breeding import Population, bred, plan
from porse.search.incumbent import feedback_mts, incumbent
from tiny import committed_params


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


def test_in_the_first_iteration_every_valid_individual_enters(revolve):
    # One island: by the mean of those before, 3, then 2, then 4/3, the second, third and fifth would stay out.
    roomy = dataclasses.replace(revolve.islands, count=1, size=5)
    one_island = dataclasses.replace(revolve, islands=roomy)
    six = dataclasses.replace(one_island, generate=dataclasses.replace(one_island.generate, candidates=6))
    fitness = {"a": [3.0], "b": [1.0], "c": [0.0], "d": [9.0], "e": [-5.0]}
    rows = [candidate(name, slot) for slot, name in enumerate(fitness)] + [candidate("f", 5, failure="not finite")]
    after = bred(Population([], []), rows, curves(**fitness, f=[50.0]), six, 1)
    assert [row["candidate_id"] for row in after.members] == ["d", "a", "b", "c", "e"]
    # Whoever comes later asks: of the two, one is at the mean of (9 + 3 + 1 + 0 - 5) / 5 = 1.6.
    later = bred(after, [candidate("g", 0), candidate("h", 1)], curves(g=[1.5], h=[1.6]), six, 2)
    assert [row["candidate_id"] for row in later.members] == ["d", "a", "h", "b", "c"]


def test_a_crossover_looks_for_an_island_with_two_members_and_is_as_frequent_as_configured(revolve):
    # Three islands, one of two members: chosen first, it would be the island of every third crossover only.
    members = [member(0, "a", 0.0), member(1, "b", 0.0), member(1, "c", 0.0), member(2, "d", 0.0)]
    half = dataclasses.replace(revolve.islands, count=3, crossover=0.5)
    many = dataclasses.replace(revolve, islands=half, generate=dataclasses.replace(revolve.generate, candidates=1000))
    plans = plan(members, many, 2)
    crossed = [breeding for breeding in plans if breeding.operator == "crossover"]
    assert {(b.island, frozenset(b.parents)) for b in crossed} == {(1, frozenset({"b", "c"}))}
    # 500 +- 3 x sqrt(1000 / 4)
    assert abs(len(crossed) - 500) < 48
    # Mutations come from all islands, each as often as its mean fitness says: here a third of them.
    mutated = [breeding.island for breeding in plans if breeding.operator == "mutation"]
    assert all(abs(mutated.count(island) / len(mutated) - 1 / 3) < 0.07 for island in (0, 1, 2))


def test_over_whole_runs_half_of_the_rewards_are_crossed_where_half_are_asked_for(params):
    revolve = parse_params({**committed_params(), "method": "revolve-auto"}, "params.yaml")
    operators, drawn = [], np.random.default_rng(3)
    for seed in range(60):
        run = dataclasses.replace(revolve, seed=seed)
        population = Population([], [])
        for n in range(1, 6):
            operators += [breeding.operator for breeding in plan(population.members, run, n)]
            fitness = {f"{n}-{slot}": [float(drawn.normal())] for slot in range(6)}
            rows = [candidate(name, slot) for slot, name in enumerate(fitness)]
            population = bred(population, rows, curves(**fitness), run, n)
    # 60 runs of 4 bred iterations of 6; three deviations of a fair coin are 0.04.
    bred_ones = [operator for operator in operators if operator != "new"]
    assert len(bred_ones) == 1440
    assert abs(bred_ones.count("crossover") / 1440 - 0.5) < 0.04


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
