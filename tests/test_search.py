import dataclasses
import itertools

import numpy as np
import pytest

from porse.config import EliminateParams
from porse.errors import SearchError
from porse.search.elimination import Score, rank, ranked_pool, score, survivors
from porse.search.feedback import TOLD, Series, feedback_rows, shown_series
from porse.search.fusion import fuse
from porse.search.mutation import mutant, swarm_step
from porse.search.schedule import total_epochs, varied, work


def with_rungs(params, **changes):
    return dataclasses.replace(params, train=dataclasses.replace(params.train, **changes))


def test_the_papers_parameters_cost_18000_epochs_an_iteration_and_90000_in_all(params):
    paper = with_rungs(params, rung_epochs=500)
    costs = {entry.rung: (entry.candidates, entry.epochs) for entry in work(paper, 1)}
    # 500 (6 + 5 + 4) + 5 x 1500 + 500 (3 + 2 + 1) = 18 000; the four survivors wait while the mutants are trained.
    assert costs == {
        "1": (6, 3000),
        "2": (5, 2500),
        "3": (4, 2000),
        "mutants": (5, 7500),
        "4": (3, 1500),
        "5": (2, 1000),
        "6": (1, 500),
    }
    assert sum(entry.epochs for entry in work(paper, 2)) == 18_000
    assert total_epochs(paper) == 90_000


def test_odd_iterations_vary_beta_and_even_ones_alpha(params):
    assert [varied(params, n) for n in (1, 2, 3, 4, 5)] == ["beta", "alpha", "beta", "alpha", "beta"]


def curve(name, values, series="fitness"):
    return [
        {"iteration": 1, "rung": "1", "candidate_id": name, "series": series, "epoch": epoch, "value": value}
        for epoch, value in enumerate(values, 1)
    ]


def by(window, which="mean"):
    return EliminateParams(keep="rungs", score=which, window=window)


def test_a_score_is_the_mean_of_the_last_epochs_or_the_highest_of_all():
    rows = curve("a", [5.0, 1.0, 2.0, 3.0]) + curve("a", [9.0] * 4, "bonus") + curve("b", [7.0])
    # (2 + 3) / 2 = 2.5; max 5
    assert score({"candidate_id": "a", "failure": ""}, rows, by(2)) == Score("a", 2.5, 5.0, failed=False)
    assert score({"candidate_id": "a", "failure": ""}, rows, by(2, "max")) == Score("a", 5.0, 5.0, failed=False)


def test_a_failed_training_has_no_score_and_ranks_last():
    failed = score({"candidate_id": "a", "failure": "its reward was not finite"}, curve("a", [5.0]), by(2))
    assert failed == Score("a", 0.0, 0.0, failed=True)
    assert rank([failed, Score("b", -9.0, -9.0, failed=False)])[0].candidate_id == "b"


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_a_fitness_that_is_no_number_ranks_last(value):
    scores = [
        score({"candidate_id": name, "failure": ""}, curve(name, values), by(2))
        for name, values in (("a", [9.0, value, 9.0, 9.0]), ("b", [-9.0]))
    ]
    assert scores[0] == Score("a", 0.0, 0.0, failed=True)
    assert [entry.candidate_id for entry in rank(scores)] == ["b", "a"]


def test_ranks_do_not_depend_on_the_order_of_rows_and_what_failed_outranks_nothing():
    # c is a probe that another one beat: of age 1, and below zero. d has failed, and e has a fitness that is no number.
    ages = {"a": 2, "b": 2, "c": 1, "d": 0, "e": 2}
    rows = [
        {"candidate_id": name, "epochs": age, "failure": "it raised" if name == "d" else ""}
        for name, age in ages.items()
    ]
    curves = [
        *curve("a", [-3.0, -2.0]), *curve("b", [-2.0, -1.0]), *curve("c", [-5.0]), *curve("d", [7.0]),
        *curve("e", [9.0, float("nan")]),
    ]  # fmt: skip
    for order in itertools.permutations(rows):
        ranked = ranked_pool(order, curves[:: 1 if order[0] is rows[0] else -1], by(1))
        assert [(entry.candidate_id, entry.failed) for entry in ranked] == [
            ("b", False), ("a", False), ("c", True), ("d", True), ("e", True),
        ]  # fmt: skip


def test_ties_go_by_mts_then_by_id():
    scores = [Score(n, f, m, failed=False) for n, f, m in [("d", 1, 1), ("c", 1, 2), ("b", 1, 1), ("a", 0, 9)]]
    assert [entry.candidate_id for entry in rank(scores)] == ["c", "b", "d", "a"]
    assert rank(scores) == rank(scores[::-1])


def test_survivors_are_the_best_that_did_not_fail():
    ranked = rank([Score("a", 1, 1, failed=True), Score("b", 0, 0, failed=False), Score("c", 2, 2, failed=False)])
    assert [entry.candidate_id for entry in survivors(ranked, 3, "here")] == ["c", "b"]
    with pytest.raises(SearchError, match="iteration 1, rung 2"):
        survivors([Score("a", 1, 1, failed=True)], 1, "iteration 1, rung 2")


def policy(weight, mean):
    return {
        "actor.mlp.0.weight": np.full((2, 2), weight, np.float32),
        "actor.obs_normalizer._mean": np.full((1, 2), mean, np.float32),
        "actor.obs_normalizer.count": np.array(int(mean), np.int64),
        "critic.mlp.0.bias": np.full(2, 2 * weight, np.float32),
    }


def test_fusion_averages_weights_and_inherits_the_observation_statistics():
    fused = fuse(policy(1.0, 7.0), policy(-1.0, 0.0), 0.75)
    # 0.75 x 1 + 0.25 x (-1) = 0.5, and twice that for the critic
    assert fused["actor.mlp.0.weight"].tolist() == [[0.5, 0.5], [0.5, 0.5]]
    assert fused["critic.mlp.0.bias"].tolist() == [1.0, 1.0]
    assert fused["actor.obs_normalizer._mean"].tolist() == [[7.0, 7.0]]
    assert fused["actor.obs_normalizer.count"] == 7
    assert fused["actor.mlp.0.weight"].dtype == np.float32


def test_alpha_one_is_the_best_policy_and_alpha_zero_the_random_one():
    best, random = policy(0.3, 1.0), policy(-0.7, 0.0)
    for name in ("actor.mlp.0.weight", "critic.mlp.0.bias"):
        assert fuse(best, random, 1.0)[name].tobytes() == best[name].tobytes()
        assert fuse(best, random, 0.0)[name].tobytes() == random[name].tobytes()


def test_policies_of_other_networks_do_not_fuse():
    with pytest.raises(ValueError, match="other names or shapes"):
        fuse(policy(1.0, 1.0), {"actor.mlp.0.weight": np.zeros((3, 2), np.float32)}, 0.5)


def test_zero_weights_keep_the_models_values(params):
    assert swarm_step([0.1, 0.9], 0.5, 0.4, (0.0, 1.0), params.mutate, 1) == [0.1, 0.9]


def test_the_swarm_step_with_a_pencil(params):
    weights = dataclasses.replace(params.mutate, inertia=0.5, cognitive=0.0, social=0.0)
    # x + 0.5 (x - 1): 1.2 + 0.1 = 1.3; 0.2 - 0.4 = -0.2, held at 0; 1.8 + 0.4 = 2.2, held at 2
    assert swarm_step([1.2, 0.2, 1.8], 1.0, 1.0, (0.0, 2.0), weights, 1) == [1.3, 0.0, 2.0]
    weights = dataclasses.replace(params.mutate, inertia=0.0, cognitive=1.0, social=2.0)
    [[r1, r2]] = np.random.default_rng(3).random((1, 2)).tolist()
    expected = round(1.2 + 1.0 * r1 * (0.8 - 1.2) + 2.0 * r2 * (1.0 - 1.2), 6)
    assert swarm_step([1.2], 1.0, 0.8, (0.0, 2.0), weights, 3) == [expected]


def test_a_mutant_changes_one_number_and_never_the_code():
    parent = {
        "iteration": 1, "slot": 2, "candidate_id": "p", "origin": "new", "parent_id": "", "reward_source": "r",
        "mapping_source": "m", "beta": 1.0, "alpha": 0.8, "draw": 0, "policy": "p", "epochs": 45, "failure": "",
    }  # fmt: skip
    child = mutant("T", parent, "beta", 1.5, 6, "fused")
    assert (child["beta"], child["alpha"], child["origin"], child["parent_id"]) == (1.5, 0.8, "mutant", "p")
    assert (child["epochs"], child["policy"], child["slot"]) == (0, "fused", 6)
    assert (child["reward_source"], child["mapping_source"]) == ("r", "m")
    assert child["candidate_id"] != mutant("T", parent, "alpha", 0.5, 6, "x")["candidate_id"]


def test_sampled_points_are_evenly_spaced_from_the_first_epoch_to_the_last():
    series = Series("fitness", tuple(range(1, 91)), tuple(map(float, range(1, 91))))
    assert series.sampled(10).epochs == (1, 10, 20, 30, 40, 50, 60, 70, 80, 90)
    assert series.last(3).epochs == (88, 89, 90)
    assert Series("x", (1, 2), (0.0, 1.0)).sampled(10).epochs == (1, 2)


def test_feedback_shows_fitness_components_and_progress_with_their_extremes():
    rows = [
        *curve("a", [1.0, 3.0]),
        *curve("a", [0.5, 0.7], "component/c"),
        *curve("a", [1, 1], "goal"),
        *curve("b", [9]),
    ]
    assert [series.name for series in shown_series(rows, "a", TOLD)] == ["fitness", "component/c"]
    first = feedback_rows(rows, "a", 2)[0]
    assert first == {"series": "fitness", "epoch": 1, "value": 1.0, "maximum": 3.0, "mean": 2.0, "minimum": 1.0}
