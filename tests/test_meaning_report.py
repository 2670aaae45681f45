"""What a run's figures mean, and what the methods and ablations change, by pencil."""

import dataclasses
import json
from types import SimpleNamespace

import pytest

from meaning_cases import changed, named, row_of
from porse import tables
from porse.checkpoint import write_checkpoint
from porse.config import Lengths, Reference, leaves, parse_params
from porse.generation.candidates import first_pool
from porse.generation.functions import Function
from porse.methods import ABLATIONS, METHODS, overridden
from porse.report.figures import (
    area_under_curve,
    curve_figures,
    epochs_to,
    evaluation_figures,
    final_success,
    human_normalised_score,
    lineage_fitness,
    run_figures,
    task_scores,
)
from porse.report.markdown import results_table
from porse.report.run import Evaluation, Run
from porse.report.summary import iteration_rows, metrics, write_summary
from porse.search.schedule import asked_kinds, mutants, varied
from porse.steps.evaluate import _episodes, _said
from porse.tasks import make_task
from porse.training import candidate as candidate_module
from porse.training.actor import policy_actor
from porse.training.episodes import play_episodes
from porse.training.rung import job_for
from porse.training.start import random_policy
from tiny import committed_params


def curve(iteration, rung, name, values, first=1, series="fitness"):
    return [
        {"iteration": iteration, "rung": rung, "candidate_id": name, "series": series, "epoch": e, "value": v}
        for e, v in enumerate(values, first)
    ]


def run_of(**parts):
    names = [field.name for field in dataclasses.fields(Run)]
    return Run(**{name: parts.get(name, []) for name in names})


# Figures.


def test_the_human_normalised_score_is_zero_at_sparse_one_at_human_and_keeps_its_sign():
    # (-0.5 - -1.25) / (-0.25 - -1.25) = 0.75
    assert human_normalised_score(-0.5, -0.25, -1.25) == 0.75
    assert human_normalised_score(-1.25, -0.25, -1.25) == 0.0
    assert human_normalised_score(-0.25, -0.25, -1.25) == 1.0
    # worse than sparse, and a human reward that is worse than sparse
    assert human_normalised_score(1.0, 4.0, 2.0) == -0.5
    assert human_normalised_score(3.0, 1.0, 2.0) == -1.0


def test_a_tasks_score_is_by_the_references_of_that_task(params):
    document = committed_params()
    document["summarise"]["references"] = {
        "Over": {"human": {"lineage": 9.0, "budget": 13.0}, "sparse": {"lineage": 1.0, "budget": 3.0}},
        "Pen": {"human": {"lineage": 5.0, "budget": 2.0}, "sparse": {"lineage": 3.0, "budget": 2.0}},
    }
    # of 5: (5 - 1) / (9 - 1) and (5 - 3) / (13 - 3); (5 - 3) / (5 - 3), and equal references
    for task, lineage, budget in (("Over", 0.5, 0.2), ("Pen", 1.0, None), ("Kettle", None, None)):
        found = task_scores(5.0, parse_params({**document, "task": task}, "params.yaml"))
        assert found == {"hns_lineage": lineage, "hns_budget": budget}


def test_epochs_are_spent_in_the_order_of_the_schedule(params):
    # 1: a1 b1 a2 b2 of rung 1; 5: m1 of the mutants; 6: a3 of rung 4, which comes after them; 7: the next iteration's
    rows = [
        *curve(2, "1", "a", [5.0]),
        *curve(1, "4", "a", [4.0], first=3),
        *curve(1, "mutants", "m", [3.0]),
        *curve(1, "1", "b", [0.0, 2.0]),
        *curve(1, "1", "a", [0.5, 1.0]),
        *curve(1, "1", "a", [99.0], series="goal"),
    ]
    reached = [epochs_to(threshold, run_of(curves=rows), params) for threshold in (0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 5.1)]
    assert reached == [1, 3, 4, 5, 6, 7, None]


def test_the_area_is_the_mean_over_the_chains_epochs_in_order():
    rows = [*curve(1, "1", "a", [4.0], first=2), *curve(1, "1", "a", [1.0]), *curve(2, "1", "b", [10.0])]
    rows += [*curve(1, "1", "b", [77.0]), *curve(2, "1", "a", [88.0]), *curve(1, "1", "a", [55.0], series="reward")]
    links = [{"iteration": 1, "candidate_id": "a"}, {"iteration": 2, "candidate_id": "b"}]
    assert lineage_fitness(rows, links) == [(links[0], 1.0), (links[0], 4.0), (links[1], 10.0)]
    assert area_under_curve([1.0, 4.0, 10.0]) == 5.0


def test_the_spread_over_seeds_is_that_of_a_sample_of_those_that_did_not_fail(params):
    values = {3: [2.0, 0.0], 1: [-4.0, -6.0], 2: [5.0, 4.0], 4: [99.0]}
    rows = [
        {"seed": seed, "iteration": 1, "epoch": epoch, "fitness": value}
        for seed, series in values.items()
        for epoch, value in enumerate(series, 1)
    ]
    seeds = [{"seed": seed, "links": 1, "failure": "late" if seed == 4 else ""} for seed in (1, 2, 3, 4)]
    # MTS -4, 5, 2: mean 1, (25 + 16 + 1) / 2 = 21. The fourth was good, and failed.
    expected = {
        "evaluation_seeds": 3, "evaluation_failed": 1, "evaluation_mts_mean": 1.0, "evaluation_mts_std": pytest.approx(21**0.5),
    }  # fmt: skip
    assert part(evaluation_figures(rows, seeds, by(params)), expected) == expected


def test_a_seeds_score_is_that_of_its_last_link_and_its_mts_of_all(params):
    # the last link is iteration 4: its last two of 1, 3, 8 are 5.5 in the mean, and 8 is its highest; the first link had 9
    series = {(1, 1): 9.0, (1, 2): 9.0, (4, 1): 1.0, (4, 3): 8.0, (4, 2): 3.0}
    rows = [{"seed": 1, "iteration": n, "epoch": epoch, "fitness": value} for (n, epoch), value in series.items()]
    seeds = [{"seed": 1, "links": 2, "failure": ""}]
    for which, score in (("mean", 5.5), ("max", 8.0)):
        found = evaluation_figures(rows, seeds, by(params, window=2, score=which))
        assert (found["evaluation_score_mean"], found["evaluation_mts_mean"]) == (score, 9.0)


def by(params, **values):
    return changed(params, eliminate=values).eliminate


def played(*outcomes):
    return [{"episode": n, "candidate_id": "a", "steps": 9, "outcome": float(o)} for n, o in enumerate(outcomes)]


def test_final_success_of_solved_and_unsolved_episodes_is_a_share_with_wilsons_interval():
    """3 of 8, z = 1.959964: the middle is (0.375 + 3.841459 / 16) / (1 + 3.841459 / 8) = 0.615091 / 1.480182 = 0.415551,
    half the width 1.959964 sqrt(0.375 x 0.625 / 8 + 3.841459 / 256) / 1.480182
        = 1.959964 sqrt(0.029297 + 0.015006) / 1.480182 = 0.278706."""
    found = final_success(played(1, 0, 0, 1, 0, 0, 1, 0))
    assert found == {
        "success": 0.375, "success_low": pytest.approx(0.136845, abs=2e-6), "success_high": pytest.approx(0.694257, abs=2e-6),
        "episodes": 8,
    }  # fmt: skip
    # none of 4 is no proof of never: the upper end is 3.841459 / (4 + 3.841459)
    found = final_success(played(0, 0, 0, 0))
    assert (found["success"], found["success_low"]) == (0.0, pytest.approx(0.0, abs=1e-9))
    assert found["success_high"] == pytest.approx(0.489890, abs=2e-6)


def test_final_success_of_other_outcomes_is_a_mean_with_students_interval():
    """-1, -2, -6: mean -3, deviation sqrt((4 + 1 + 9) / 2) = 2.645751, over sqrt(3) 1.527525; t of 2 degrees is 4.302653."""
    found = final_success(played(-1, -2, -6))
    half = 4.302653 * 1.527525
    assert found == {
        "success": -3.0, "success_low": pytest.approx(-3 - half, abs=2e-5), "success_high": pytest.approx(-3 + half, abs=2e-5),
        "episodes": 3,
    }  # fmt: skip
    # halves are no shares; and where all are equal, there is nothing to be unsure of
    equal = {"success": 0.5, "success_low": 0.5, "success_high": 0.5, "episodes": 2}
    assert final_success(played(0.5, 0.5)) == equal


# A whole run: two iterations, the last of them worse than the first.


def candidate(iteration, slot, name, **changes):
    values = {"iteration": iteration, "slot": slot, "candidate_id": name, "beta": 1.0, "alpha": 0.8, "epochs": 2}
    return row_of(tables.CANDIDATES, **{**values, **changes})


def verdict(iteration, slot, attempt, passed):
    return row_of(
        tables.VERDICTS, iteration=iteration, kind="reward", slot=slot, attempt=attempt, passed=passed, check="ok"
    )


def reply(iteration, kind, prompt, completion, usd):
    tokens = {"prompt_tokens": prompt, "completion_tokens": completion}
    return row_of(tables.REPLIES, iteration=iteration, kind=kind, recorded_usd=usd, **tokens)


def survivor(iteration, rung, rank, name, score):
    return row_of(tables.SURVIVORS, iteration=iteration, rung=rung, rank=rank, candidate_id=name, score=score)


def part(found, expected):
    """Returns the entries of `found` that `expected` has: tables and metrics may gain others."""
    return {name: found[name] for name in expected}


@pytest.fixture
def whole():
    return run_of(
        candidates=[
            candidate(1, 0, "a", beta=0.7, alpha=0.3),
            candidate(1, 1, "b", failure="late"),
            candidate(2, 0, "a", beta=1.6, alpha=0.9),
            candidate(2, 1, "c"),
        ],
        curves=[
            *curve(1, "1", "a", [1.0, 6.0]), *curve(1, "6", "a", [4.0], first=3), *curve(1, "1", "b", [8.0]),
            *curve(1, "1", "a", [0.0, 0.0], series="reward"),
            *curve(1, "1", "a", [0.5, 0.25], series="bonus_share"), *curve(1, "1", "b", [0.125], series="bonus_share"),
            *curve(1, "6", "a", [0.9], first=3, series="bonus_share"),
            *curve(1, "1", "a", [0.3, 0.7], series="cells_visited"), *curve(1, "1", "b", [0.8], series="cells_visited"),
            *curve(1, "6", "a", [0.4], first=3, series="cells_visited"), *curve(2, "1", "a", [5.0, 3.0]), *curve(2, "1", "c", [2.0]),
            *curve(1, "1", "a", [9.0, 3.0], series="new_cells"), *curve(1, "6", "a", [7.5], first=3, series="new_cells"),
            *curve(1, "1", "b", [90.0], series="new_cells"), *curve(2, "1", "c", [4.0], series="new_cells"),
        ],
        survivors=[
            survivor(1, "1", 0, "b", 9.0), survivor(1, "6", 0, "a", 4.5), survivor(2, "6", 0, "a", 3.5),
            survivor(2, "6", 1, "c", 3.0),
        ],
        verdicts=[verdict(1, 0, 0, True), verdict(1, 1, 0, False), verdict(1, 1, 1, True), verdict(2, 0, 0, False)],
        replies=[reply(1, "reward", 10, 1, 0.5), reply(1, "beta", 30, 2, 0.25), reply(2, "reward", 5, 4, 0.0)],
    )  # fmt: skip


def test_an_iteration_reports_its_winner_and_the_best_of_all_its_trainings(params, whole):
    small = changed(params, train={"num_envs": 3, "steps_per_epoch": 7})
    first, second = iteration_rows(whole, small)
    expected = {
        "iteration": 1, "winner_id": "a", "beta": 0.7, "alpha": 0.3,
        # b reached 8, and the winner 6 on the way to a mean of 4.5 over its last epochs
        "mts": 8.0, "winner_mts": 6.0, "score": 4.5,
        # of both in the first rung, (0.5 + 0.25 + 0.125) / 3; the winner's at its last epoch, when counts had begun anew
        "bonus_share": pytest.approx(0.875 / 3), "cells_visited": 0.4,
        # the winner's own, (9 + 3 + 7.5) / 3
        "new_cells": 6.5,
        # three epochs of a and one of b, each of 3 x 7 steps
        "epochs": 4, "environment_steps": 84, "replies": 3, "valid_replies": 2, "repairs": 1,
    }  # fmt: skip
    assert part(first, expected) == expected
    assert (second["winner_id"], second["beta"], second["alpha"], second["new_cells"]) == ("a", 1.6, 0.9, 0.0)
    assert (second["mts"], second["winner_mts"], second["score"], second["epochs"]) == (5.0, 5.0, 3.5, 3)


def test_a_runs_figures_by_pencil(params, whole):
    chosen = changed(params, train={"num_envs": 3, "steps_per_epoch": 7, "rung_epochs": 2}, generate={"candidates": 4})
    references = {"Quadcopter": Reference(human=Lengths(3.0, 4.5), sparse=Lengths(-2.0, 1.0))}
    chosen = changed(chosen, summarise={"thresholds": {"Quadcopter": 6.0}, "references": references})
    lineage = [candidate(1, 0, "a"), candidate(2, 0, "a")]
    rows = [{"seed": seed, "iteration": 2, "epoch": 1, "fitness": value} for seed, value in ((1, 2.0), (2, 4.0))]
    seeds = [{"seed": seed, "links": 2, "failure": ""} for seed in (1, 2)]
    evaluation = Evaluation(lineage, rows, seeds, played(-1, -2, -6))
    iterations = iteration_rows(whole, chosen)
    found = run_figures(iterations, evaluation, chosen) | curve_figures(whole, evaluation, chosen)
    # (8 + 2) / (3 + 2), and (8 - 1) / (4.5 - 1)
    assert (found["hns_lineage"], found["hns_budget"]) == (2.0, 2.0)
    assert (found["mts"], found["score"]) == (8.0, 3.5)
    # where the run's winner won in iteration 1, its score is from there
    alone = run_figures(iterations, Evaluation(lineage[:1], rows, seeds, played(1, 0)), chosen)
    assert alone["score"] == 4.5
    assert (found["success"], found["episodes"]) == (-3.0, 3)
    # a's three epochs, then its two: (1 + 6 + 4 + 5 + 3) / 5
    assert found["fitness_area"] == pytest.approx(3.8)
    # in order a1 b1: 1, 8
    assert found["epochs_to_threshold"] == 2
    assert (found["evaluation_mts_mean"], found["evaluation_mts_std"]) == (3.0, pytest.approx(2**0.5))
    # allowed: 5 iterations x 4 candidates x 6 rungs x 2 epochs
    assert (found["epochs_spent"], found["epochs_allowed"], found["environment_steps"]) == (7, 240, 147)
    assert found["failed_candidates"] == 1
    replies = {
        "functions": 4, "valid_functions": 2, "valid_share": 0.5, "replies": 3, "prompt_tokens": 45, "completion_tokens": 7,
        "recorded_usd": 0.75,
    }  # fmt: skip
    assert part(found, replies) == replies


def test_metrics_are_few_and_flat_and_say_first_whose_they_are(params, whole):
    chosen = changed(
        dataclasses.replace(params, method="eureka", ablation="fixed-beta", seed=7), summarise={"references": {}}
    )
    evaluation = Evaluation([candidate(1, 0, "a")], [], [], played(1, 0, 1, 1))
    found = metrics(iteration_rows(whole, chosen), evaluation, chosen)
    # Four functions were read, and two of them passed; seven epochs were spent; a's score is from iteration 1.
    assert [*found.items()] == [
        ("Task", "Quadcopter"), ("Method", "eureka fixed-beta"), ("Seed", 7), ("score", 4.5), ("mts", 8.0),
        ("hns_lineage", None), ("success", 0.75), ("epochs_spent", 7), ("valid_share", 0.5),
    ]  # fmt: skip
    # DVC sorts them so.
    assert {*sorted(found)[:3]} == {"Task", "Method", "Seed"}


def test_the_plots_show_the_chains_fitness_epoch_by_epoch(params, whole, tmp_path):
    lineage = [candidate(1, 0, "a"), candidate(2, 0, "a")]
    evaluation = Evaluation(lineage, [], [], played(1, 0))
    write_summary(whole, evaluation, params, tmp_path / "r", tmp_path / "m.json", tmp_path / "p")
    assert (tmp_path / "p" / "fitness.csv").read_text().splitlines() == [
        "epoch,fitness,candidate", "1,1.0,a", "2,6.0,a", "3,4.0,a", "4,5.0,a", "5,3.0,a",
    ]  # fmt: skip
    assert (tmp_path / "p" / "iterations.csv").read_text().splitlines()[1] == "1,4.5,8.0,6.0,0.7,0.3"
    assert json.loads((tmp_path / "m.json").read_text())["mts"] == 8.0
    assert len(tables.read(tmp_path / "r" / "iterations.parquet", tables.ITERATIONS)) == 2
    assert tables.read(tmp_path / "r" / "episodes.parquet", tables.EPISODES) == played(1, 0)


def test_the_table_for_people_has_a_line_for_each_iteration_and_the_runs_own_below():
    iterations = [{"iteration": n, "mts": n / 2, "score": -n, "beta": 0.25 * n, "alpha": 0.5} for n in (2, 10)]
    figures = {
        "mts": 5.0, "score": -10.0, "evaluation_seeds": 3, "evaluation_failed": 2, "evaluation_score_mean": -2.5,
        "evaluation_score_std": 0.75, "evaluation_mts_mean": 1.5, "evaluation_mts_std": 0.25,
        "success": 0.75, "success_low": 0.5, "success_high": 0.875, "episodes": 64,
    }  # fmt: skip
    found = results_table(iterations, figures).splitlines()
    assert found[2:] == [
        "| 2 | -2.000 | 1.000 | 0.5 | 0.5 |",
        "| 10 | -10.000 | 5.000 | 2.5 | 0.5 |",
        "| all | -10.000 | **5.000** | | |",
        "| 3 further seeds | -2.500 +- 0.750 | 1.500 +- 0.250 | | |",
        "| 2 further seeds | failed | failed | | |",
        "",
        "Final success in 64 episodes, with its 95 % interval: **0.750 (0.500 to 0.875)**",
    ]


# Methods and ablations: what each changes, in full.


def resolved(method="porse", ablation="none"):
    return parse_params({**committed_params(), "method": method, "ablation": ablation}, "params.yaml")


def weights(params):
    """What is paid, and the weights of bonus and goal."""
    candidate = params.candidate
    return candidate.bonus, candidate.goal, candidate.beta, candidate.scale - candidate.beta


PAID = {
    "porse": ("mapping", "generated", 1.0, 1.0),
    "eureka": ("none", "generated", 0.0, 1.0),
    "roska": ("none", "generated", 0.0, 1.0),
    "roska-ce": ("simhash", "generated", 1.0, 1.0),
    "revolve-auto": ("none", "generated", 0.0, 1.0),
    "llmcount": ("mapping", "sparse", 1.0, 1.0),
    "simhash": ("simhash", "generated", 1.0, 1.0),
    "human": ("none", "human", 0.0, 1.0),
    "sparse": ("none", "sparse", 0.0, 1.0),
    "human-budget": ("none", "human", 0.0, 1.0),
    "sparse-budget": ("none", "sparse", 0.0, 1.0),
}

SEARCHED = {
    # who goes on, mutants, what the next iteration starts from, which winner, probes, elites, iterations, length
    "porse": ("rungs", 5, "fused", "latest", 0, 1, "every", "iteration"),
    "eureka": ("all", 0, "random", "latest", 0, 0, "every", "iteration"),
    "roska": ("one", 0, "fused", "best", 14, 0, "every", "iteration"),
    "roska-ce": ("one", 0, "fused", "best", 14, 0, "every", "iteration"),
    "revolve-auto": ("all", 0, "random", "latest", 0, 0, "every", "iteration"),
    "llmcount": ("all", 0, "fused", "latest", 0, 1, "first", "lineage"),
    "simhash": ("rungs", 5, "fused", "latest", 0, 1, "every", "iteration"),
    "human": ("all", 0, "fused", "latest", 0, 0, "first", "lineage"),
    "sparse": ("all", 0, "fused", "latest", 0, 0, "first", "lineage"),
    "human-budget": ("all", 0, "fused", "latest", 0, 0, "first", "budget"),
    "sparse-budget": ("all", 0, "fused", "latest", 0, 0, "first", "budget"),
}


@pytest.mark.parametrize("method", METHODS)
def test_a_method_pays_and_searches_as_its_paper_says(method):
    params = resolved(method)
    assert weights(params) == PAID[method]
    assert (
        params.eliminate.keep, params.mutate.mutants, params.fuse.policy, params.fuse.incumbent, params.probe.trainings,
        params.generate.elites, params.generate.iterations, params.train.length,
    ) == SEARCHED[method]  # fmt: skip
    assert params.generate.parents == ("islands" if method == "revolve-auto" else "winner")
    assert params.exploration.discretiser == ("sum" if method == "llmcount" else "grid")


VARIED = {
    "without-bonus": ["draw", "alpha"],
    "without-fusion": ["beta", "draw"],
    "fixed-beta": ["draw", "alpha"],
    "fixed-alpha": ["beta", "draw"],
}
CELLS = {"cells-2000": 2000, "cells-3000": 3000}


@pytest.mark.parametrize("method", METHODS)
def test_eureka_and_revolve_choose_by_the_maximum_and_the_others_by_the_declared_mean(method):
    assert resolved(method).eliminate.score == ("max" if method in ("eureka", "revolve-auto") else "mean")


CHANGED = {
    "none": set(),
    "without-goal-reward": {"candidate.goal"},
    "without-bonus": {"candidate.bonus", "mutate.vary"},
    "without-fusion": {"fuse.policy", "mutate.vary"},
    "fixed-beta": {"mutate.vary"},
    "fixed-alpha": {"mutate.vary"},
    "spliced-mapping": {"generate.mappings"},
    "beyond-goal": {"generate.beyond_goal"},
    "cells-1000": set(),
    "cells-2000": {"exploration.cells"},
    "cells-3000": {"exploration.cells"},
    "weights-sum-to-1": {"candidate.beta", "candidate.scale"},
    "gpt-4o-mini": {"llm.profile"},
    "literal-bonus": {"exploration.form", "exploration.lambda", "train.scaling"},
}
"""The resolved parameters that an ablation changes, every one of them."""


@pytest.mark.parametrize("ablation", ABLATIONS)
def test_an_ablation_changes_these_parameters_and_no_other(ablation):
    plain, other = (
        dict(leaves(overridden({**committed_params(), "ablation": name}, "params.yaml"))) for name in ("none", ablation)
    )
    assert {name for name in plain if plain[name] != other[name]} - {"ablation"} == CHANGED[ablation]


# R_total = beta R_e + (scale - beta) R_g of a state with R_e = 0.25, a generated goal reward of -3 and a fitness of 7.
TOTALS = {
    # 1 x 0.25 + 1 x -3
    **dict.fromkeys(CHANGED, -2.75),
    # 1 x 0.25 + 1 x 7
    "without-goal-reward": 7.25,
    # 1 x 0 + 1 x -3: the goal reward weighs what it weighed
    "without-bonus": -3.0,
    # 0.5 x 0.25 + 0.5 x -3
    "weights-sum-to-1": -1.375,
}


@pytest.mark.parametrize("ablation", ABLATIONS)
def test_an_ablation_pays_what_its_name_says(ablation, monkeypatch, tmp_path):
    params = resolved(ablation=ablation)
    streams = {"generated": lambda *_: -3.0, "sparse": lambda *_: 7.0, "MappingBonus": 0.25, "NoBonus": 0.0}
    monkeypatch.setattr(candidate_module, "generated", lambda _: streams["generated"])
    monkeypatch.setattr(candidate_module, "sparse", streams["sparse"])
    monkeypatch.setattr(candidate_module, "Function", lambda *_: SimpleNamespace(rises=(True, False)))
    totals = []

    def mixed(goal, bonus, beta, scale, *_):
        totals.append(beta * streams[type(bonus).__name__] + (scale - beta) * goal())
        raise candidate_module.CandidateFailed("seen")

    monkeypatch.setattr(candidate_module, "Reward", mixed)
    functions = [Function(kind, 0, "key", f"{kind} source", f"{kind} list") for kind in asked_kinds(params)]
    [row, *_] = first_pool(functions, None, {}, changed(params, generate={"candidates": 1, "elites": 0}), 1)
    candidate_module.train_candidate(job_for(row, tmp_path, 1, params, tmp_path), params, lambda *_: None)
    assert totals == [TOTALS[ablation]]


@pytest.mark.parametrize("ablation", ABLATIONS)
def test_an_ablation_changes_what_its_name_says(ablation):
    params = resolved(ablation=ablation)
    assert params.candidate.goal == ("sparse" if ablation == "without-goal-reward" else "generated")
    assert params.candidate.bonus == ("none" if ablation == "without-bonus" else "mapping")
    assert params.candidate.scale == (1.0 if ablation == "weights-sum-to-1" else 2.0)
    assert params.candidate.beta == (0.5 if ablation == "weights-sum-to-1" else 1.0)
    assert params.fuse.policy == ("random" if ablation == "without-fusion" else "fused")
    assert list(params.mutate.vary) == VARIED.get(ablation, ["beta", "alpha"])
    assert params.generate.mappings == ("spliced" if ablation == "spliced-mapping" else "generator")
    assert params.generate.beyond_goal == (ablation == "beyond-goal")
    assert params.exploration.cells == CELLS.get(ablation, 1000)
    assert params.llm.profile == ("gpt-4o-mini" if ablation == "gpt-4o-mini" else "offline")


def test_what_is_fixed_is_never_varied():
    for ablation, kinds in (
        ("none", ["beta", "alpha", "beta", "alpha", "beta"]),
        ("fixed-beta", ["draw", "alpha", "draw", "alpha", "draw"]),
        ("without-bonus", ["draw", "alpha", "draw", "alpha", "draw"]),
        ("fixed-alpha", ["beta", "draw", "beta", "draw", "beta"]),
        ("without-fusion", ["beta", "draw", "beta", "draw", "beta"]),
    ):
        params = resolved(ablation=ablation)
        assert [varied(params, n) for n in range(1, 6) if mutants(params, n)] == kinds


# The step that evaluates.


def test_an_evaluation_says_which_seeds_failed_and_that_all_did():
    lineage = [candidate(1, 0, "a"), candidate(2, 0, "b"), candidate(3, 0, "c")]
    fine, late = {"seed": 1, "links": 3, "failure": ""}, {"seed": 2, "links": 1, "failure": "its reward was not finite"}
    assert _said(lineage, [fine]) == ["3 links of the winning lineage, 1 further seed"]
    assert _said(lineage, [fine, late]) == [
        "3 links of the winning lineage, 2 further seeds, 1 of them failed",
        "seed 2 failed after 1 link: its reward was not finite",
    ]
    assert (
        _said(lineage, [late])[0]
        == "3 links of the winning lineage, 1 further seed: all of them failed, there is no evaluation"
    )


def test_the_runs_winner_plays_as_it_was_when_it_won_on_a_task_of_the_runs_own_seed(small, tmp_path):
    chosen = changed(dataclasses.replace(small, seed=5), evaluate={"episodes": 3}, fuse={"pool": "eliminate-late"})
    # It won iteration 2, and stayed in the third.
    winner = candidate(2, 0, "w", policy="own")
    path = tmp_path / "2" / "eliminate-late" / "policies" / "own.safetensors"
    write_checkpoint(path, random_policy(chosen, 1))
    rows = _episodes(chosen, winner, tmp_path)
    task = make_task("Quadcopter", 3, named('[5,"episodes"]'))
    played = play_episodes(task, policy_actor(task, path, chosen.train))
    assert [(row["episode"], row["candidate_id"]) for row in rows] == [(0, "w"), (1, "w"), (2, "w")]
    assert [(row["steps"], row["outcome"]) for row in rows] == [(each.steps, each.outcome) for each in played]
    assert len({row["outcome"] for row in rows}) == 3
    # nothing is drawn: again gives the same bits
    assert _episodes(chosen, winner, tmp_path) == rows
