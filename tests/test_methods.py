"""Methods and ablations as values: what they cost, and what they replace."""

import copy
import dataclasses

import pytest

from porse.config import Params, parse_params
from porse.errors import ParamsError
from porse.methods import ABLATIONS, METHODS, overridden
from porse.report.figures import (
    area_under_curve,
    chain_fitness,
    epochs_to,
    evaluation_figures,
    human_normalised_score,
)
from porse.report.run import Run
from porse.search.lineage import lineage
from porse.search.schedule import allowed_epochs, total_epochs, work
from tiny import committed_params

PAPER = {
    # paper/tables/budget.csv says 90 000 for each of these; ROSKA's own schedule with 14 trainings falls 100 short:
    # 6 x 500 + 2500, then 4 x (6 (14 x 200 + 300) + 2500)
    "porse": 90_000,
    "eureka": 90_000,
    "roska": 89_900,
    "roska-ce": 89_900,
    "revolve-auto": 90_000,
    "llmcount": 90_000,
    "simhash": 90_000,
    # One policy, trained for 3 000 epochs.
    "human": 3_000,
    "sparse": 3_000,
}


def parsed(method: str = "porse", ablation: str = "none", **sections) -> Params:
    document = {**committed_params(), "method": method, "ablation": ablation}
    for name, values in sections.items():
        document[name] = {**document[name], **values}
    return parse_params(document, "params.yaml")


@pytest.mark.parametrize("method", METHODS)
def test_with_the_papers_parameters_every_method_spends_the_same_budget(method):
    params = parsed(method, train={"rung_epochs": 500})
    assert total_epochs(params) == PAPER[method]
    assert allowed_epochs(params) == 90_000


def test_roska_pays_its_probes_from_the_budget():
    params = parsed("roska", train={"rung_epochs": 500})
    assert [cost.epochs for cost in work(params, 1)] == [6 * 500, 500, 500, 0, 500, 500, 500]
    assert work(params, 2)[0].epochs == 6 * (14 * 200 + 300)


def test_llmcount_trains_six_policies_for_15000_epochs_each():
    params = parsed("llmcount", train={"rung_epochs": 500})
    assert sum(cost.epochs for cost in work(params, 1)) == 6 * 15_000
    assert work(params, 2) == []


@pytest.mark.parametrize("ablation", [name for name in ABLATIONS if name not in ("without-bonus", "fixed-beta")])
def test_an_ablation_spends_what_porse_spends(ablation):
    assert total_epochs(parsed(ablation=ablation)) == total_epochs(parsed())


@pytest.mark.parametrize("ablation", ["without-bonus", "fixed-beta"])
def test_without_a_beta_to_vary_the_first_iteration_has_no_mutants(ablation):
    # J = 5 mutants x 3 rungs x 16 epochs less, and every other iteration varies alpha.
    assert total_epochs(parsed()) - total_epochs(parsed(ablation=ablation)) == 5 * 3 * 16


@pytest.mark.parametrize("kind", ["method", "ablation"])
def test_every_set_replaces_parameters_that_exist_by_others(kind):
    document = committed_params()
    for name, sections in {"method": METHODS, "ablation": ABLATIONS}[kind].items():
        changed = overridden({**document, kind: name}, "params.yaml")
        for section, values in sections.items():
            assert values.keys() <= document[section].keys(), f"{name}: {section}"
            assert {key: changed[section][key] for key in values} == values
        untouched = set(document) - set(sections) - {kind}
        assert {key: changed[key] for key in untouched} == {key: document[key] for key in untouched}


def test_the_document_itself_is_not_changed():
    document = {**committed_params(), "method": "eureka"}
    before = copy.deepcopy(document)
    overridden(document, "params.yaml")
    assert document == before


def test_an_ablation_is_laid_over_the_method():
    params = parsed("eureka", "weights-sum-to-1")
    assert (params.candidate.beta, params.candidate.scale, params.candidate.bonus) == (0.5, 1.0, "none")


def test_an_unknown_method_is_refused_with_its_nearest_name():
    with pytest.raises(ParamsError, match="did you mean eureka"):
        parsed("eureca")


def test_too_many_summed_cells_are_refused_with_their_limit():
    with pytest.raises(ParamsError, match=r"at most 1872 where exploration\.discretiser is sum"):
        parsed("llmcount", "cells-3000")


def test_the_human_normalised_score_of_the_papers_swingcup():
    # table 3: MTS 0.995, sparse 0.001, human 0.025; figure 7 says 41.42
    assert human_normalised_score(0.995, 0.025, 0.001) == pytest.approx(41.42, abs=0.005)


def test_the_human_normalised_score_is_undefined_where_human_and_sparse_are_equal():
    assert human_normalised_score(0.349, 0.0, 0.0) is None


def test_the_area_under_a_curve_is_its_mean():
    assert area_under_curve([1.0, 2.0, 6.0]) == 3.0


def curve(iteration, rung, name, values, first=1):
    return [
        {"iteration": iteration, "rung": rung, "candidate_id": name, "series": "fitness", "epoch": e, "value": v}
        for e, v in enumerate(values, first)
    ]


def run_of(*curves):
    return Run([], [], [], [row for rows in curves for row in rows], [], [], [], [])


def test_epochs_to_a_threshold_count_those_of_all_candidates(params):
    # Spent in the order of the schedule: a1 b1 a2 b2 | a3; b's second epoch is the fourth.
    run = run_of(curve(1, "1", "a", [0.0, 0.1]), curve(1, "1", "b", [0.2, 0.5]), curve(1, "2", "a", [0.9], first=3))
    assert epochs_to(0.5, run, params) == 4
    assert epochs_to(0.6, run, params) == 5
    assert epochs_to(1.0, run, params) is None
    assert epochs_to(None, run, params) is None


def test_the_chains_fitness_is_that_of_its_links_one_after_the_other():
    rows = [*curve(1, "1", "a", [1.0, 2.0]), *curve(1, "1", "b", [9.0]), *curve(2, "1", "a", [3.0])]
    chain = [{"iteration": 1, "candidate_id": "a"}, {"iteration": 2, "candidate_id": "a"}]
    assert [fitness for _, fitness in chain_fitness(rows, chain)] == [1.0, 2.0, 3.0]


def test_the_evaluation_is_mean_and_sample_deviation_over_seeds():
    rows = [{"seed": seed, "fitness": fitness} for seed, fitness in [(1, 0.0), (1, 1.0), (2, 3.0), (2, 2.0)]]
    # MTS 1 and 3: mean 2, deviation sqrt((1 + 1) / 1)
    assert evaluation_figures(rows) == {"seeds": 2, "mts_mean": 2.0, "mts_std": pytest.approx(2**0.5)}
    assert evaluation_figures(rows[:2]) == {"seeds": 1, "mts_mean": 1.0, "mts_std": None}
    assert evaluation_figures([]) == {"seeds": 0, "mts_mean": None, "mts_std": None}


def test_the_lineage_is_the_chain_of_incumbents_each_once(params):
    rows = [{"iteration": n, "candidate_id": name} for n, name in [(1, "a"), (1, "a"), (3, "c")]]
    assert lineage(rows, [0.1, 0.1, 0.2], params) == [rows[0], rows[2]]


def test_without_fusion_the_lineage_is_the_best_alone(params):
    alone = dataclasses.replace(params, fuse=dataclasses.replace(params.fuse, policy="random"))
    rows = [{"iteration": n, "candidate_id": str(n)} for n in (1, 2, 3)]
    assert lineage(rows, [0.1, 0.3, 0.2], alone) == [rows[1]]
    assert lineage(rows, [0.3, 0.3, 0.2], alone) == [rows[0]]
