"""What the search means: every formula, order, bound and seed of `porse.search`, and of the mutants, by pencil.

The numbers are asymmetric on purpose: with beta 1 of 2, or two equal candidates, a swapped pair goes unseen.
"""

import dataclasses
import json
import math

import numpy as np
import pytest

from meaning_cases import changed, named, row_of
from porse import tables
from porse.checkpoint import policy_checkpoint, read_checkpoint, write_checkpoint
from porse.errors import ParamsError
from porse.generation import answers
from porse.generation.candidates import first_pool
from porse.generation.functions import Function
from porse.generation.mutants import Swarm, write_starts
from porse.generation.values import alpha_question, beta_question
from porse.identity import candidate_id, seed_for
from porse.llm.request import Reply
from porse.pool import Pool, policy_file
from porse.search import breeding as breeding_module
from porse.search.bayes import _mean_excess
from porse.search.breeding import Breeding, Population, bred, plan
from porse.search.elimination import (
    Score,
    how_many_go_on,
    rank,
    ranked_pool,
    score,
    score_rows,
    survivor_rows,
    survivors,
)
from porse.search.feedback import STAGED, TOLD, WEIGHED, Series, feedback_rows, series_of, shown_series
from porse.search.fusion import fuse
from porse.search.incumbent import feedback_mts, incumbent, winner
from porse.search.islands import softmax
from porse.search.lengths import alpha_is_searched, probe_epochs, probe_trainings, rung_epochs, spread_trainings
from porse.search.lineage import episodes_seed, evaluation_seed, lineage
from porse.search.mutation import mutant, swarm_seed, swarm_step
from porse.search.schedule import (
    allowed_epochs,
    asked_kinds,
    find_iteration,
    first_candidates,
    is_searched,
    mutants,
    varied,
    work,
)


def curve(name, values, series="fitness", first=1):
    return [
        {"iteration": 3, "rung": "1", "candidate_id": name, "series": series, "epoch": epoch, "value": value}
        for epoch, value in enumerate(values, first)
    ]


def candidate(name, slot=0, **changes):
    values = {
        "iteration": 3, "slot": slot, "candidate_id": name, "origin": "new", "reward_key": "rk", "mapping_key": "mk",
        "reward_source": f"reward {name}", "mapping_source": f"mapping {name}", "reward_program": f"reward list {name}",
        "mapping_program": f"mapping list {name}", "beta": 0.7, "alpha": 0.3,
        "policy": "fused", "epochs": 45,
    }  # fmt: skip
    return row_of(tables.CANDIDATES, **{**values, **changes})


# Names of draws.


def test_a_seed_is_the_digest_of_the_runs_seed_and_the_draws_name():
    # printf 'seed\n[5,"policy",2]' | sha256sum: 66d63914d9424649...; without the last of its 64 bits
    assert seed_for(5, "policy", 2) == 0x66D63914D9424649 // 2 == named('[5,"policy",2]')
    assert seed_for(5, "policy", 2) not in {seed_for(2, "policy", 5), seed_for(5, "policy"), seed_for(5, 2, "policy")}


def test_draws_of_the_search_are_named_by_run_purpose_and_iteration(params):
    assert swarm_seed(5, 3) == named('[5,"swarm",3]')
    assert evaluation_seed(dataclasses.replace(params, seed=5), 2) == named('[5,"evaluate",2]')
    assert episodes_seed(dataclasses.replace(params, seed=5)) == named('[5,"episodes"]')


# Elimination.


def by(params, **values):
    return changed(params, eliminate=values).eliminate


def test_a_score_looks_at_the_last_epochs_in_the_order_of_epochs(params):
    # series whose names come before and after it in the alphabet count for nothing
    others = [*curve("a", [70.0] * 4, "bonus"), *curve("a", [90.0] * 4, "goal")]
    rows = [*curve("a", [8.0, 1.0, 2.0, 5.0])[::-1], *others]
    # last three: (1 + 2 + 5) / 3 = 8/3; highest of all four: 8
    assert score(candidate("a"), rows, by(params, window=3)) == Score("a", 8 / 3, 8.0, failed=False)
    # a window longer than the training is the whole training: 16 / 4
    assert score(candidate("a"), rows, by(params, window=9)).value == 4.0
    # the highest is of all epochs, whatever the window
    assert score(candidate("a"), rows, by(params, window=3, score="max")) == Score("a", 8.0, 8.0, failed=False)


def test_the_declared_score_ranks_a_pool_and_names_its_winner(params):
    # over two epochs: a (4 + 5) / 2 = 4.5, b (1 + 7) / 2 = 4; highest: a 5, b 9
    rows = [candidate("a", 0), candidate("b", 1)]
    curves = [*curve("a", [0.0, 4.0, 5.0]), *curve("b", [9.0, 1.0, 7.0])]
    for which, best, value in (("mean", "a", 4.5), ("max", "b", 9.0)):
        chosen = changed(params, eliminate={"window": 2, "score": which}, fuse={"pool": "eliminate-late"})
        first = ranked_pool(rows, curves, chosen.eliminate)[0]
        assert (first.candidate_id, first.value) == (best, value)
        row, survivor = winner(rows, curves, chosen)
        assert row["candidate_id"] == best
        assert survivor == {"iteration": 3, "rung": "late", "rank": 0, "candidate_id": best, "score": value}


def test_fitness_comes_before_mts_and_mts_before_the_id():
    scores = [("bb", 2, 3, False), ("0", 5, 9, True), ("a", 1, 9, False), ("b", 2, 3, False), ("c", 2, 4, False)]
    ranking = rank([Score(*entry) for entry in scores])
    assert [entry.candidate_id for entry in ranking] == ["c", "b", "bb", "a", "0"]


def test_a_candidate_younger_than_the_oldest_is_out_however_good(params):
    # equal ages are two numbers, as where they are read from a table
    ages = {"old": int("1500"), "peer": int("1500"), "young": 1499}
    rows = [candidate(name, slot, epochs=age) for slot, (name, age) in enumerate(ages.items())]
    rows.append(candidate("gone", 3, failure="late"))
    curves = [*curve("old", [1.0]), *curve("peer", [0.5]), *curve("young", [9.0]), *curve("gone", [8.0])]
    ranking = ranked_pool(rows, curves, by(params, window=1))
    assert [(entry.candidate_id, entry.failed) for entry in ranking] == [
        ("old", False),
        ("peer", False),
        ("young", True),
        ("gone", True),
    ]


def test_the_best_go_on_and_the_tables_say_who():
    ranking = rank([Score("a", 1, 6, False), Score("b", 3, 5, False), Score("c", 2, 4, False)])
    kept = survivors(ranking, 2, "here")
    assert [entry.candidate_id for entry in kept] == ["b", "c"]
    rows = score_rows(ranking, {"b", "c"}, 3, "4")
    assert [(row["candidate_id"], row["rank"], row["score"], row["mts"], row["survives"]) for row in rows] == [
        ("b", 0, 3, 5, True),
        ("c", 1, 2, 4, True),
        ("a", 2, 1, 6, False),
    ]
    assert [(row["rank"], row["candidate_id"], row["score"]) for row in survivor_rows(kept, 3, "4")] == [
        (0, "b", 3),
        (1, "c", 2),
    ]
    assert {(row["iteration"], row["rung"], row["failed"]) for row in rows} == {(3, "4", False)}


def test_how_many_go_on_is_declared_or_all_or_one(params):
    for keep, expected in (("rungs", 4), ("all", 7), ("one", 1)):
        assert how_many_go_on(changed(params, eliminate={"keep": keep}), 4, 7) == expected


# Feedback.


def test_sampled_epochs_are_the_first_the_last_and_even_ones_between():
    series = Series("fitness", tuple(range(1, 8)), tuple(10.0 * epoch for epoch in range(1, 8)))
    # from 1 in three steps of (7 - 1) / 3 = 2; in two of 3; in four of 1.5, cut off: 1, 2.5, 4, 5.5, 7
    assert series.sampled(4).epochs == (1, 3, 5, 7)
    assert series.sampled(3).values == (10.0, 40.0, 70.0)
    assert series.sampled(5).epochs == (1, 2, 4, 5, 7)
    assert series.sampled(2).epochs == (1, 7)
    assert series.sampled(7) == series.sampled(9) == series
    assert series.last(2).values == (60.0, 70.0)


def test_feedback_has_the_extremes_of_all_epochs_and_not_of_the_shown_ones():
    rows = [
        *curve("a", [9.0, 2.0, 1.0, 4.0]),
        *curve("a", [5.0, 3.0, 8.0, 6.0], "progress/x"),
        *curve("a", [7.0] * 4, "bonus"),
    ]
    # epochs 1 and 4 are shown of three with other extremes; fitness: highest 9, lowest 1, mean 16 / 4; progress 22 / 4
    found = feedback_rows(rows[::-1], "a", 2)
    assert [(r["series"], r["epoch"], r["value"], r["maximum"], r["mean"], r["minimum"]) for r in found] == [
        ("fitness", 1, 9.0, 9.0, 4.0, 1.0),
        ("fitness", 4, 4.0, 9.0, 4.0, 1.0),
        ("progress/x", 1, 5.0, 8.0, 5.5, 3.0),
        ("progress/x", 4, 6.0, 8.0, 5.5, 3.0),
    ]


def test_series_are_shown_in_the_order_of_what_they_are_for_and_then_by_name():
    names = (
        "progress/a", "component/z", "component/b", "new_cells", "cells_visited", "bonus_share", "bonus_size", "goal_size",
        "episode_length", "terminated", "reward", "goal", "bonus", "fitness",
    )  # fmt: skip
    rows = [row for name in names for row in curve("a", [1.0], name)] + curve("b", [1.0], "component/a")
    shown = {kind: [series.name for series in shown_series(rows, "a", kind)] for kind in (TOLD, WEIGHED, STAGED)}
    assert shown == {
        TOLD: ["fitness", "episode_length", "component/b", "component/z", "progress/a"],
        WEIGHED: [
            "fitness", "goal_size", "bonus_size", "bonus_share", "cells_visited", "new_cells", "component/b", "component/z",
            "progress/a",
        ],
        STAGED: ["fitness", "component/b", "component/z", "progress/a"],
    }  # fmt: skip


def test_a_series_without_a_value_in_some_epochs_is_sampled_among_those_that_have_one():
    # no episode ended in epochs 1 and 3: the mean is that of the others, (30 + 60) / 2
    rows = [
        *curve("a", [1.0, 2.0, 3.0, 4.0]),
        *curve("a", [30.0], "episode_length", 2),
        *curve("a", [60.0], "episode_length", 4),
    ]
    found = [row for row in feedback_rows(rows, "a", 3) if row["series"] == "episode_length"]
    assert [(row["epoch"], row["value"], row["mean"]) for row in found] == [(2, 30.0, 45.0), (4, 60.0, 45.0)]


# Fusion and the incumbent.


def test_fusion_weighs_the_best_by_alpha():
    best = {"actor.w": np.array([4.0], np.float32), "actor.obs_normalizer._mean": np.array([4.0], np.float32)}
    random = {"actor.w": np.array([-8.0], np.float32), "actor.obs_normalizer._mean": np.array([-8.0], np.float32)}
    # 0.25 x 4 + 0.75 x (-8) = -5; statistics are the best one's
    fused = fuse(best, random, 0.25)
    assert fused["actor.w"].tolist() == [-5.0]
    assert fused["actor.obs_normalizer._mean"].tolist() == [4.0]


def feedback_of(mts, minimum=0.0):
    row = {"epoch": 1, "value": mts}
    return [
        {**row, "series": "component/a", "maximum": 99.0, "mean": 98.0, "minimum": 97.0},
        {**row, "series": "fitness", "maximum": mts, "mean": mts - 1.0, "minimum": minimum},
    ]


def test_the_winner_is_the_first_of_the_ranking(params):
    rows = [candidate("a", 0), candidate("b", 1), candidate("c", 2)]
    curves = [*curve("a", [9.0, 1.0]), *curve("b", [0.0, 3.0]), *curve("c", [5.0, 2.0])]
    for listed in (rows, rows[::-1]):
        assert winner(listed, curves, changed(params, eliminate={"window": 1}))[0]["candidate_id"] == "b"


@pytest.mark.parametrize(
    ("which", "score", "is_new"),
    [("mean", 1.9, True), ("mean", 2.0, False), ("mean", 2.9, False), ("max", 2.9, True), ("max", 3.0, False)],
)
def test_the_best_so_far_stays_unless_its_score_is_exceeded(params, which, score, is_new):
    # the new one reaches 3 on the way, ends at 1, and 2 in the mean
    best = changed(params, fuse={"incumbent": "best", "points": 2}, eliminate={"score": which})
    rows, curves, earlier = [candidate("new")], curve("new", [3.0, 1.0]), candidate("old")
    # the earlier one's MTS is above everything, and is not what ranks
    told = feedback_of(9.0)
    standing = row_of(tables.SURVIVORS, candidate_id="old", score=score)
    found = incumbent(rows, curves, [earlier], [standing], told, best)
    assert found.is_new is is_new
    own = {"iteration": 3, "rung": "6", "rank": 0, "candidate_id": "new", "score": {"mean": 2.0, "max": 3.0}[which]}
    assert found.score == (own if is_new else standing)
    assert found.row["candidate_id"] == ("new" if is_new else "old")
    assert found.feedback == (feedback_rows(curves, "new", 2) if is_new else told)
    latest = changed(params, fuse={"incumbent": "latest"})
    assert incumbent(rows, curves, [earlier], [standing], told, latest).is_new


def test_the_highest_fitness_of_a_training_is_that_of_its_fitness_wherever_it_is_listed():
    row = {"series": "progress/x", "epoch": 1, "value": 1.0, "maximum": 55.0, "mean": 1.0, "minimum": 0.0}
    assert feedback_mts([row, *feedback_of(7.0), row]) == 7.0


# The search of alpha.


def test_an_improvement_that_is_certain_is_what_it_is_and_never_below_zero():
    assert (_mean_excess(0.3, 0.0), _mean_excess(-0.3, 0.0)) == (0.3, 0.0)
    # mean 1, deviation 2: Phi(0.5) + 2 phi(0.5) = 0.691462 + 2 x 0.352065
    assert _mean_excess(1.0, 2.0) == pytest.approx(1.395592, abs=1e-5)


# Lengths and the schedule.


def test_a_rung_of_one_policy_is_as_long_as_a_lineages_or_takes_the_whole_budget(params):
    seven = changed(params, train={"rung_epochs": 7}, generate={"candidates": 4})
    assert len(params.iterations) == 5
    # 7; times 5 iterations; times 4 candidates of each
    lengths = {name: rung_epochs(changed(seven, train={"length": name})) for name in ("iteration", "lineage", "budget")}
    assert lengths == {"iteration": 7, "lineage": 35, "budget": 140}
    # six such rungs are what any method may spend
    assert 6 * lengths["budget"] == allowed_epochs(seven)


def probing(params, share, least, trainings=14, initial=6, rung=7):
    probe = {"share": share, "least_epochs": least, "trainings": trainings, "initial": initial}
    return changed(params, train={"rung_epochs": rung}, probe=probe)


def test_a_probe_is_a_share_of_a_rung_or_longer_but_no_longer_than_the_rung(params):
    # 0.4 of 7 is 2.8, 0.3 of 7 is 2.1, and 0.01 of 7 is next to nothing
    assert [probe_epochs(probing(params, share, 1)) for share in (0.4, 0.3, 0.01)] == [3, 2, 1]
    assert [probe_epochs(probing(params, 0.4, least)) for least in (3, 5, 7, 9)] == [3, 5, 7, 7]


def test_longer_probes_are_fewer_and_cost_no_more(params):
    # 14 of 0.4 x 500 epochs: the 13 that are thrown away may cost 2600. Of 300 epochs these are 8, of 500 they are 5.
    paper = [probing(params, 0.4, least, rung=500) for least in (63, 200, 300, 500)]
    assert [probe_epochs(each) for each in paper] == [200, 200, 300, 500]
    assert [probe_trainings(each) for each in paper] == [14, 14, 9, 6]
    # 6 of 14 alphas are evenly spread: of 9 they are 3.86, of 6 they are 2.57.
    assert [spread_trainings(each) for each in paper] == [6, 6, 4, 3]
    # 2 x 0.3 x 7 = 4.2 epochs pay for none of 7; one is compared with another in any case.
    assert probe_trainings(probing(params, 0.3, 7, trainings=3)) == 2
    # 7 x 0.7 x 10 = 49, which is a last bit less in the numbers of a computer, pays for 7 of 7.
    assert probe_trainings(probing(params, 0.7, 1, trainings=8, rung=10)) == 8
    # No more of them are spread than there are, and never fewer than both ends.
    assert spread_trainings(probing(params, 0.4, 1, trainings=3, initial=6, rung=5)) == 3
    assert spread_trainings(probing(params, 0.4, 5, trainings=6, initial=2, rung=5)) == 2


def test_alpha_is_searched_from_the_second_iteration_on(params):
    searching = changed(params, probe={"trainings": 1})
    assert [alpha_is_searched(searching, n) for n in (1, 2, 3)] == [False, True, True]
    assert not alpha_is_searched(changed(params, probe={"trainings": 0}), 2)


def test_what_mutants_vary_goes_round_from_the_first_entry(params):
    cycle = changed(params, mutate={"vary": ["beta", "alpha", "alpha"]})
    assert [varied(cycle, n) for n in range(1, 8)] == ["beta", "alpha", "alpha", "beta", "alpha", "alpha", "beta"]


def test_there_are_no_mutants_of_alpha_where_there_is_nothing_to_fuse(params):
    four = changed(params, mutate={"mutants": 4, "vary": ["alpha", "beta"]})
    assert [mutants(four, n) for n in (1, 2, 3)] == [0, 4, 4]
    # names that were read from a file are equal to those in the program, and others
    from_scratch = changed(four, fuse={"policy": "-random"[1:]}, mutate={"vary": ["-alpha"[1:], "-beta"[1:]]})
    assert [mutants(from_scratch, n) for n in (1, 2, 3)] == [0, 4, 0]


def test_a_candidate_is_made_of_what_is_generated(params):
    def with_candidate(**values):
        return changed(params, candidate=values, generate={"candidates": 4})

    kinds = {
        ("generated", "mapping"): ("reward", "mapping"),
        ("generated", "none"): ("reward",),
        ("generated", "simhash"): ("reward",),
        ("sparse", "mapping"): ("mapping",),
        ("human", "none"): (),
    }
    for (goal, bonus), expected in kinds.items():
        chosen = with_candidate(goal=goal, bonus=bonus)
        assert asked_kinds(chosen) == expected
        assert first_candidates(chosen) == (4 if expected else 1)


def test_only_the_first_iteration_has_candidates_where_functions_are_asked_for_once(params):
    once = changed(params, generate={"iterations": "first"})
    assert [is_searched(once, n) for n in (1, 2, 5)] == [True, False, False]
    assert [is_searched(params, n) for n in (1, 2, 5)] == [True, True, True]


def test_the_cost_of_an_uneven_schedule_by_pencil(params):
    # 5 candidates, rungs of 7 epochs, 3 mutants: 5, then 5, then 4 candidates, 3 mutants x 3 rungs, 3, 2, 1.
    uneven = changed(params, train={"rung_epochs": 7}, generate={"candidates": 5}, mutate={"mutants": 3})
    keeps = {"1": 5, "2": 4, "3": 4}
    rungs = [dataclasses.replace(rung, keep=keeps.get(str(rung.rung), rung.keep)) for rung in params.rungs]
    uneven = dataclasses.replace(uneven, rungs=rungs)
    assert [(cost.rung, cost.candidates, cost.epochs) for cost in work(uneven, 1)] == [
        ("1", 5, 35), ("2", 5, 35), ("3", 4, 28), ("mutants", 3, 63), ("4", 3, 21), ("5", 2, 14), ("6", 1, 7),
    ]  # fmt: skip
    # allowed: 5 iterations x 5 candidates x 6 rungs x 7 epochs
    assert allowed_epochs(uneven) == 1050


def test_who_is_older_than_a_rung_costs_nothing_in_it(params):
    # 3 mutants are trained for 2 rungs of 7 epochs beside 4 survivors of 3 rungs; then 3 of all go on from rung 2 to 4
    short = changed(params, train={"rung_epochs": 7}, mutate={"mutants": 3})
    rungs = [dataclasses.replace(rung, until=2) if rung.rung == "mutants" else rung for rung in params.rungs]
    costs = {cost.rung: (cost.candidates, cost.epochs) for cost in work(dataclasses.replace(short, rungs=rungs), 1)}
    assert (costs["mutants"], costs["4"]) == ((3, 42), (3, 42))


def test_probes_cost_their_own_epochs_beside_the_rung(params):
    # Probes of round(0.4 x 7) = 3 epochs for 2 candidates. 4 x 2.8 pay for 3 beside the best, which goes on: 2 (7 + 3 x 3) = 32
    roska = changed(
        params,
        train={"rung_epochs": 7},
        generate={"candidates": 2},
        probe={"trainings": 5, "share": 0.4, "least_epochs": 1},
        eliminate={"keep": "one"},
        mutate={"mutants": 0},
    )
    assert [cost.epochs for cost in work(roska, 2)] == [32, 7, 7, 0, 7, 7, 7]
    assert [cost.epochs for cost in work(roska, 1)] == [14, 7, 7, 0, 7, 7, 7]


def test_an_iteration_is_found_by_its_number(params):
    assert (find_iteration(params.iterations, 2).next, find_iteration(params.iterations, 5).next) == (3, "result")
    with pytest.raises(ParamsError, match="found 6"):
        find_iteration(params.iterations, 6)
    # the one behind a gap is not the one that was meant
    with pytest.raises(ParamsError, match="found 2"):
        find_iteration([params.iterations[0], params.iterations[2]], 2)


# The lineage.


def test_a_candidate_that_wins_again_in_a_later_iteration_is_another_link(params):
    rows = [candidate("a", iteration=1), candidate("b", iteration=2), candidate("a", iteration=3)]
    assert lineage(rows, [0.1, 0.9, 0.2], params) == rows
    stays = [candidate("a", iteration=1), candidate("a", iteration=1), candidate("c", iteration=3)]
    assert lineage(stays, [0.1, 0.1, 0.2], params) == [stays[0], stays[2]]


def test_from_scratch_the_lineage_is_the_one_of_highest_score_and_the_first_of_equals(params):
    scratch = changed(params, fuse={"policy": "random"})
    rows = [candidate(name, iteration=n) for n, name in enumerate("abc", 1)]
    assert lineage(rows, [-3.0, -1.0, -2.0], scratch) == [rows[1]]
    assert lineage(rows, [-3.0, -1.0, -1.0], scratch) == [rows[1]]


# Mutation.


def test_the_swarm_step_is_drawn_toward_the_survivor_and_the_memory_by_their_own_weights(params):
    draws = np.random.default_rng(11).random((2, 2)).tolist()
    for social, cognitive in ((2.0, 0.0), (0.0, 3.0)):
        weights = dataclasses.replace(params.mutate, inertia=0.0, social=social, cognitive=cognitive)
        found = swarm_step([0.2, 0.6], 0.9, 0.1, (-9.0, 9.0), weights, 11)
        # cognitive: r1 toward the previous winner's 0.1; social: r2 toward the survivor's 0.9
        expected = [
            x + (cognitive * r1 * (0.1 - x) if cognitive else social * r2 * (0.9 - x))
            for x, (r1, r2) in zip([0.2, 0.6], draws, strict=True)
        ]
        assert found == pytest.approx(expected, abs=1e-6)


def test_inertia_goes_on_away_from_the_survivor_and_bounds_hold(params):
    weights = dataclasses.replace(params.mutate, inertia=0.5, social=0.0, cognitive=0.0)
    # v = x - 0.7: 0.3 - 0.2 = 0.1; 1.1 + 0.2 = 1.3; 0.1 - 0.3 = -0.2 -> 0; 1.3 + 0.3 = 1.6 -> 1.5
    assert swarm_step([0.3, 1.1, 0.1, 1.3], 0.7, 5.0, (0.0, 1.5), weights, 1) == [0.1, 1.3, 0.0, 1.5]
    # six decimals are kept
    still = dataclasses.replace(params.mutate, inertia=0.0, social=0.0, cognitive=0.0)
    assert swarm_step([0.12345649], 0.7, 5.0, (0.0, 1.5), still, 1) == [0.123456]


def test_a_mutant_of_beta_keeps_alpha_and_one_of_alpha_keeps_beta():
    parent = candidate("p", 2, beta=0.7, alpha=0.3, failure="none yet")
    for kind, value, weights in (("beta", 1.6, (1.6, 0.3)), ("alpha", 0.9, (0.7, 0.9))):
        child = mutant("T", parent, kind, value, 8, "stem")
        assert (child["beta"], child["alpha"]) == weights
        assert child["candidate_id"] == candidate_id("T", "reward p", "mapping p", *weights)
        assert (child["slot"], child["policy"], child["epochs"], child["failure"]) == (8, "stem", 0, "")
        assert (child["parent_id"], child["origin"], child["iteration"]) == ("p", "mutant", 3)


def scripted(monkeypatch, text):
    """A model that always answers with this text, and the questions that it was asked."""
    asked = []

    def ask(questions, llm, cache):
        asked.extend(questions)
        return [Reply("key", text, "stop", 0, 0, "test", 0.0) for _ in questions]

    monkeypatch.setattr(answers, "ask", ask)
    return asked


@pytest.fixture
def start(tmp_path):
    """Where an iteration started from: theta_best is 4, theta_random -8, theta_f 1; the winner before had 0.2 and 0.1."""
    for stem, weight in (("best", 4.0), ("random", -8.0), ("fused", 1.0)):
        arrays = {"actor.w": np.full((1,), weight, np.float32)}
        write_checkpoint(policy_file(tmp_path, stem), policy_checkpoint(arrays))
    before = candidate("before", iteration=2, beta=0.2, alpha=0.1)
    tables.write(tmp_path / "winner.parquet", tables.CANDIDATES, [before])
    told = [*feedback_rows(curve("before", [555.0, 666.0]), "before", 2)]
    tables.write(tmp_path / "feedback.parquet", tables.FEEDBACK, told)
    return tmp_path


def survivors_pool(folder):
    """Three survivors: b is the best, a the worst."""
    rows = [candidate(name, slot, beta=0.7 + slot, alpha=0.3 + slot / 10) for slot, name in enumerate("abc")]
    return Pool(folder, rows, [*curve("a", [1.0, 1.0]), *curve("b", [0.0, 3.0]), *curve("c", [2.0, 2.0])])


def swarm(params, start, root, iteration, **mutate):
    few = changed(params, mutate={"mutants": 2, **mutate}, eliminate={"window": 1}, candidate={"scale": 2.5})
    return Swarm.propose(survivors_pool(start), start, few, iteration, root / "prompts", start)


def test_mutants_are_of_the_best_survivor_and_beta_may_reach_the_scale(params, start, root, monkeypatch):
    asked = scripted(monkeypatch, json.dumps([{"goal": 0.0, "bonus": 1.0}, {"goal": 4.0, "bonus": 1.0}]))
    found = swarm(params, start, root, 3)
    # scale 2.5: all bonus is beta 2.5, one part of five is 0.5
    assert [(row["beta"], row["alpha"], row["parent_id"]) for row in found.mutants] == [
        (2.5, 0.4, "b"),
        (0.5, 0.4, "b"),
    ]
    assert [(row["slot"], row["policy"]) for row in found.mutants] == [(6, "fused"), (7, "fused")]
    assert [(row["index"], row["varied"], row["proposed"], row["value"]) for row in found.rows] == [
        (0, "beta", 2.5, 2.5),
        (1, "beta", 0.5, 0.5),
    ]
    # b has beta 1.7 of 2.5: the question says so, the goal's 0.8 beside it
    text = asked[0].request.messages[1].content
    assert "1.7" in text
    assert "0.8" in text


ABOUT = {"description": "hover", "starts": "", "ends": "", "fitness": "", "limit": 7}


def test_the_question_for_betas_shows_the_recent_epochs_at_the_points_asked_for(params, root):
    few = changed(params, mutate={"window": 4, "points": 2, "mutants": 3}, candidate={"scale": 2.5})
    record = [Series("fitness", tuple(range(1, 9)), tuple(1000.0 + epoch for epoch in range(1, 9)))]
    survivor = candidate("b", beta=1.7, alpha=0.4)
    [system, task] = beta_question(survivor, record, ABOUT, few, root / "prompts")
    # of the last four of eight epochs the first and the last one; the goal reward has 2.5 - 1.7
    assert [epoch for epoch in range(1, 9) if f"{1000 + epoch}" in task.content] == [5, 8]
    assert "The record of the last 4 epochs, sampled at the epochs 5, 8." in task.content
    assert "The goal reward counts 0.8 and the bonus 1.7." in task.content
    assert "0.4" not in task.content
    assert "add up to 2.5" in system.content
    assert (system.role, task.role) == ("system", "user")


def test_the_question_for_alphas_shows_the_whole_stage_that_the_previous_winner_came_out_of(params, root):
    few = changed(params, mutate={"window": 4, "points": 2, "mutants": 3}, fuse={"points": 3})
    told = feedback_rows(curve("before", [float(1000 + epoch) for epoch in range(1, 10)]), "before", 3)
    survivor = candidate("b", beta=1.7, alpha=0.4)
    [system, task] = alpha_question(survivor, series_of(told, STAGED), ABOUT, few, root / "prompts")
    # 9 epochs at three points: the window and the points of the recent record count for nothing here
    assert [epoch for epoch in range(1, 10) if f"{1000 + epoch}" in task.content] == [1, 5, 9]
    assert "over the 9 epochs of its training there, sampled at the epochs 1, 5, 9." in task.content
    assert "alpha = 0.4" in task.content
    assert "1.7" not in task.content
    assert "Give 3 values" in system.content


def test_alpha_is_held_at_one_and_its_mutants_start_from_their_own_fusion(params, start, root, monkeypatch):
    scripted(monkeypatch, "[0.25, 1.0]")
    # b has alpha 0.4; inertia 1: 0.25 - 0.15 = 0.1, and 1 + 0.6, held at 1
    found = swarm(params, start, root, 2, inertia=1.0)
    assert [(row["beta"], row["alpha"], row["policy"]) for row in found.mutants] == [
        (1.7, 0.1, "alpha-0.100000"),
        (1.7, 1.0, "alpha-1.000000"),
    ]
    write_starts(found.mutants, start, lambda stem: start / f"{stem}.out")
    # 0.1 x 4 + 0.9 x (-8) = -6.8; all of theta_best is 4
    assert read_checkpoint(start / "alpha-0.100000.out").arrays["actor.w"].tolist() == pytest.approx([-6.8])
    assert read_checkpoint(start / "alpha-1.000000.out").arrays["actor.w"].tolist() == [4.0]


def test_betas_are_asked_for_with_the_best_survivors_record_and_alphas_with_the_previous_winners(
    params, start, root, monkeypatch
):
    asked = scripted(monkeypatch, json.dumps([{"goal": 3.0, "bonus": 1.0}, {"goal": 4.0, "bonus": 1.0}]))
    swarm(params, start, root, 3)
    alphas = scripted(monkeypatch, "[0.25, 1.0]")
    swarm(params, start, root, 2)
    # b came to 0, 3 in this iteration, the winner before to 555, 666 in its own
    assert "fitness = [0, 3]" in asked[0].request.messages[1].content
    assert "fitness = [555, 666]" in alphas[0].request.messages[1].content


def test_where_nothing_else_varies_mutants_are_the_best_survivor_with_draws_of_their_own(
    params, start, root, monkeypatch
):
    asked = scripted(monkeypatch, "nobody is asked")
    found = swarm(params, start, root, 1, vary=["draw", "alpha"], mutants=3)
    assert (asked, found.replies) == ([], [])
    assert [(row["draw"], row["beta"], row["alpha"], row["parent_id"]) for row in found.mutants] == [
        (1, 1.7, 0.4, "b"),
        (2, 1.7, 0.4, "b"),
        (3, 1.7, 0.4, "b"),
    ]
    # each is a candidate of its own, from the iteration's own start
    assert len({row["candidate_id"] for row in found.mutants} | {"a", "b", "c"}) == 6
    assert {row["policy"] for row in found.mutants} == {"fused"}
    assert [(row["varied"], row["proposed"], row["value"]) for row in found.rows] == [
        ("draw", 1.0, 1.0),
        ("draw", 2.0, 2.0),
        ("draw", 3.0, 3.0),
    ]


def test_mutants_of_beta_start_from_the_default_fusion(params, start, root, monkeypatch):
    scripted(monkeypatch, json.dumps([{"goal": 3.0, "bonus": 1.0}, {"goal": 4.0, "bonus": 1.0}]))
    write_starts(swarm(params, start, root, 3).mutants, start, lambda stem: start / f"{stem}.out")
    assert read_checkpoint(start / "fused.out").arrays["actor.w"].tolist() == [1.0]


def test_the_memory_is_the_previous_winners_value_of_what_is_varied(params, start, root, monkeypatch):
    scripted(monkeypatch, "[0.5, 0.5]")
    found = swarm(params, start, root, 2, cognitive=1.0)
    draws = np.random.default_rng(swarm_seed(params.seed, 2)).random((2, 2)).tolist()
    # toward alpha 0.1 of the winner before, whose beta is 0.2
    expected = [0.5 + r1 * (0.1 - 0.5) for r1, _ in draws]
    assert [row["alpha"] for row in found.mutants] == pytest.approx(expected, abs=1e-6)


def test_a_mutant_that_is_in_the_pool_already_is_no_mutant(params, start, root, monkeypatch):
    # b itself has alpha 0.4
    scripted(monkeypatch, "[0.4, 0.6]")
    few = changed(params, mutate={"mutants": 2}, eliminate={"window": 1})
    pool = survivors_pool(start)
    pool.candidates[1]["candidate_id"] = candidate_id(params.task, "reward b", "mapping b", 1.7, 0.4)
    curves = [{**row, "candidate_id": row["candidate_id"].replace("b", pool.candidates[1]["candidate_id"])} for row in pool.curves]  # fmt: skip
    found = Swarm.propose(Pool(start, pool.candidates, curves), start, few, 2, root / "prompts", start)
    assert [(row["alpha"], row["slot"]) for row in found.mutants] == [(0.6, 7)]


# The first pool.


def test_pairs_are_of_one_slot_and_the_elites_fill_the_last_ones(params):
    three = changed(params, generate={"candidates": 3, "elites": 1}, candidate={"beta": 0.7, "alpha": 0.3})
    functions = [Function(kind, slot, f"{kind[0]}k{slot}", f"{kind} {slot}", f"{kind} list {slot}") for kind in ("mapping", "reward") for slot in (1, 0)]  # fmt: skip
    before = candidate("w", iteration=2, beta=1.9, alpha=0.9)
    rows = first_pool(functions, before, {}, three, 3)
    assert [(r["slot"], r["origin"], r["parent_id"], r["reward_source"], r["mapping_source"]) for r in rows] == [
        (0, "new", "", "reward 0", "mapping 0"),
        (1, "new", "", "reward 1", "mapping 1"),
        (2, "elite", "w", "reward w", "mapping w"),
    ]
    assert [(r["reward_program"], r["mapping_program"]) for r in rows] == [
        ("reward list 0", "mapping list 0"),
        ("reward list 1", "mapping list 1"),
        ("reward list w", "mapping list w"),
    ]
    assert [(r["reward_key"], r["mapping_key"]) for r in rows] == [("rk0", "mk0"), ("rk1", "mk1"), ("rk", "mk")]
    # everybody, the elite too, begins with the default weights
    assert {(r["beta"], r["alpha"], r["policy"], r["epochs"], r["iteration"]) for r in rows} == {(0.7, 0.3, "fused", 0, 3)}  # fmt: skip
    assert rows[0]["candidate_id"] == candidate_id(params.task, "reward 0", "mapping 0", 0.7, 0.3)


def test_a_bred_candidate_names_its_parents_and_operator(params):
    two = changed(params, generate={"candidates": 2, "elites": 0})
    functions = [Function("reward", slot, "k", f"reward {slot}", "list") for slot in (0, 1)]
    bred_from = {0: Breeding(0, 1, "crossover", ("x", "y")), 1: Breeding(1, 0, "mutation", ("z",))}
    rows = first_pool(functions, None, bred_from, two, 2)
    assert [(row["origin"], row["parent_id"]) for row in rows] == [("crossover", "x+y"), ("mutation", "z")]


# Islands from iteration to iteration.


def test_a_higher_temperature_makes_the_draws_more_alike():
    # exp(1 / 2) : exp(3 / 2) = 1 : e
    assert softmax([1.0, 3.0], 2.0) == pytest.approx([1 / (1 + math.e), math.e / (1 + math.e)])


@pytest.fixture(scope="module")
def revolve(params):
    return changed(
        params,
        generate={"parents": "islands", "candidates": 6, "elites": 0},
        islands={"count": 3, "size": 2, "migration": 0.0, "crossover": 0.5},
    )


def member(island, name, fitness):
    return {"island": island, "candidate_id": name, "fitness": fitness, "reward_source": f"reward {name}"}


def test_every_slot_and_iteration_and_run_breeds_by_draws_of_its_own(revolve):
    members = [member(island, f"{island}{n}", 0.0) for island in range(3) for n in range(3)]
    plans = [plan(members, revolve, 2), plan(members, revolve, 3), plan(members, dataclasses.replace(revolve, seed=9), 2)]  # fmt: skip
    whole = [tuple((b.island, b.operator, b.parents) for b in breedings) for breedings in plans]
    assert len(set(whole)) == 3
    assert all(len({(b.island, b.operator, b.parents) for b in breedings}) > 1 for breedings in plans)


def test_breeding_and_migration_draw_by_names_of_their_own(revolve, monkeypatch):
    asked = []

    def named_draw(*names):
        asked.append(names)
        return seed_for(*names)

    monkeypatch.setattr(breeding_module, "seed_for", named_draw)
    two = changed(dataclasses.replace(revolve, seed=5), generate={"candidates": 2})
    plan([], two, 3)
    assert asked == [(5, "breeding", 3, 0), (5, "breeding", 3, 1)]
    bred(Population([], []), [], [], two, 3)
    assert asked[-1] == (5, "migration", 3)


def test_a_breeding_with_two_parents_is_a_crossover_and_happens_as_often_as_configured(revolve):
    members = [member(0, name, 0.0) for name in "abcd"]
    for crossover, operators in ((1.0, {"crossover"}), (0.0, {"mutation"})):
        planned = plan(members, changed(revolve, islands={"crossover": crossover}), 2)
        assert {breeding.operator for breeding in planned} == operators
        assert {len(breeding.parents) for breeding in planned} == ({2} if operators == {"crossover"} else {1})
    often = plan(members, changed(revolve, islands={"crossover": 0.8}, generate={"candidates": 400}), 2)
    assert sum(breeding.operator == "crossover" for breeding in often) / 400 == pytest.approx(0.8, abs=0.06)


def test_a_population_keeps_who_was_there_and_tells_of_each_member_what_was_seen(revolve):
    slots = {breeding.slot: breeding.island for breeding in plan([], revolve, 1)}
    before = Population([member(slots[0], "old", 2.0)], [{"candidate_id": "old", **row} for row in feedback_of(2.0)])
    again = {breeding.slot: breeding.island for breeding in plan(before.members, revolve, 2)}
    rows = [candidate("new", 1), candidate("bad", 0, failure="late"), candidate("mutant", 17)]
    curves = [*curve("new", [7.0, 5.0]), *curve("bad", [9.0]), *curve("mutant", [9.0])]
    after = bred(before, rows, curves, revolve, 2)
    # one that failed and one without a slot of its own stay out; the new one, after it, enters with its highest fitness, 7
    assert {row["candidate_id"]: (row["island"], row["fitness"]) for row in after.members} == {
        "old": (slots[0], 2.0),
        "new": (again[1], 7.0),
    }
    assert {row["candidate_id"]: row["reward_source"] for row in after.members} == {"old": "reward old", "new": "reward new"}  # fmt: skip
    assert [row["maximum"] for row in after.feedback if row["candidate_id"] == "new"] == [7.0, 7.0]


def test_members_migrate_by_the_runs_own_draws(revolve):
    moving = changed(revolve, islands={"migration": 0.5, "size": 4})
    members = [member(island, f"{island}{n}", float(island)) for island in range(3) for n in range(4)]
    told = [{"candidate_id": row["candidate_id"], **point} for row in members for point in feedback_of(row["fitness"])]
    outcomes = {
        seed: len(bred(Population(members, told), [], [], dataclasses.replace(moving, seed=seed), 2).members)
        for seed in range(40)
    }
    # a migration costs the weaker island all but its best; the one it gains is lost to another: 12 - 3
    assert set(outcomes.values()) == {12, 9}
    over_time = {len(bred(Population(members, told), [], [], moving, n).members) for n in range(2, 14)}
    assert over_time == {12, 9}
