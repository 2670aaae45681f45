"""`porse report`: what the page about a run says, by pencil, and that text of a model stays text."""

import dataclasses
import html
import os
import re
import subprocess
from html.parser import HTMLParser
from types import SimpleNamespace

import pytest
import yaml
from click.testing import CliRunner

import kills
from at_once import run_at_once
from meaning_cases import changed, row_of
from porse import tables
from porse.cli import main
from porse.comparison.film import winner_film
from porse.config import parse_params
from porse.errors import PorseError
from porse.generation.states import checker
from porse.methods import ABLATIONS, METHODS
from porse.pool import BEST, policy_file
from porse.printing import visible
from porse.report import page as page_module
from porse.report.answer import (
    answers,
    asked,
    beside_paper,
    budget,
    figure,
    lineage_charts,
    repliers,
    weights,
    winners_chart,
)
from porse.report.charts import MOST_POINTS, Chart, Line, Mark, draw, thinned, thinned_band, ticks
from porse.report.detail import attempts, charts, dropped, functions, series_of
from porse.report.page import Film, no_film, page_of, render
from porse.report.paper import find_mts, find_score, maximum_training_success, winners_weights
from porse.report.population import Member, Stop, members, parents
from porse.report.results import Results, incumbents, read_results
from porse.report.run import Evaluation, Run
from porse.report.source import differences, listing
from porse.report.tree import COLUMN, HEAD, ROW, Fork, tree
from porse.task_names import TASK_CLASSES
from tiny import BIN

NO_FILM = no_film("the run's policies are not beside its tables.")
EVIL = "<script>alert('x')</script>"


# Charts.


def test_ticks_are_round_numbers_inside_the_range():
    assert ticks(0.0, 10.0) == [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    assert ticks(-0.31, -0.02) == [-0.3, -0.25, -0.2, -0.15, -0.1, -0.05]
    assert ticks(1.0, 9000.0) == [2000.0, 4000.0, 6000.0, 8000.0]


def test_a_line_is_where_its_values_are_and_higher_is_further_up():
    drawing = draw(Chart("t", "x", "y", [Line("a", [(1, -3.0), (2, 1.0), (5, 0.0)])], [Mark(2, "here"), Mark(9)]))
    # x from 64 to 468 for 1 to 5, y from 200 up to 18 for -3 to 1: a quarter of the way, and three quarters up
    assert drawing.strokes[0].paths == ["64,200 165,18 468,63.5"]
    assert [(tick.at, tick.word) for tick in drawing.y_ticks] == [
        (200.0, "-3"), (154.5, "-2"), (109.0, "-1"), (63.5, "0"), (18.0, "1"),
    ]  # fmt: skip
    # a mark beyond the axis is not drawn
    assert [(mark.at, mark.mark.word) for mark in drawing.marks] == [(165.0, "here")]


def test_a_wide_chart_has_more_room_across_and_the_same_height():
    drawing = draw(Chart("t", "x", "y", [Line("a", [(1, -3.0), (2, 1.0), (5, 0.0)])], wide=True))
    # As above, but from 64 to 948: 64 + 884 / 4.
    assert drawing.strokes[0].paths == ["64,200 285,18 948,63.5"]
    assert drawing.width == 960


def test_a_band_goes_there_along_its_lower_end_and_back_along_its_upper_one():
    line = Line("a", [(1, 0.0), (2, 2.0)], band=[(1, -1.0, 1.0), (2, 0.0, 3.0)])
    # y from -1 at 200 to 3 at 18: 45.5 for each unit.
    (stroke,) = draw(Chart("t", "x", "y", [line])).strokes
    assert stroke.areas == ["64,200 468,154.5 468,18 64,109"]
    assert stroke.paths == ["64,154.5 468,63.5"]


def test_a_line_that_stands_out_among_others_has_the_ink_and_takes_no_colour_from_them():
    def styles(*strong):
        lines = [Line(str(n), [(1, 0.0), (2, n)], strong=each) for n, each in enumerate(strong)]
        return [stroke.style for stroke in draw(Chart("t", "x", "y", lines)).strokes]

    assert styles(False, True, False) == ["c0", "ink strong", "c1"]
    assert styles(True, True) == ["c0 strong", "c1 strong"]
    assert styles(*[False] * 9)[8] == "c0 dashed"


def test_a_value_that_is_no_number_breaks_its_line_and_one_left_alone_is_a_dot():
    nan = float("nan")
    drawing = draw(Chart("t", "x", "y", [Line("a", [(1, 0.0), (2, 4.0), (3, nan), (4, 2.0), (5, float("inf"))])]))
    assert drawing.strokes[0].paths == ["64,200 198.7,18"]
    assert drawing.strokes[0].dots == [(468.0, 109.0)]
    assert draw(Chart("t", "x", "y", [Line("a", [(1, nan)])])) is None


def test_a_flat_line_and_a_line_of_one_point_can_be_drawn():
    assert draw(Chart("t", "x", "y", [Line("a", [(1, 7.0), (2, 7.0)])])).strokes[0].paths == ["64,109 468,109"]
    assert draw(Chart("t", "x", "y", [Line("a", [(3, 0.0)])])).strokes[0].dots == [(266.0, 109.0)]


def test_a_long_line_keeps_its_peaks():
    points = [(epoch, 0.0) for epoch in range(5000)]
    points[1234], points[1235], points[4321] = (1234, 9.0), (1235, -6.0), (4321, 5.0)
    kept = thinned(points)
    assert len(kept) <= MOST_POINTS
    assert {(1234, 9.0), (1235, -6.0), (4321, 5.0)} <= {*kept}
    assert kept == sorted(kept)
    assert thinned(points[:7]) == points[:7]


def test_a_long_band_keeps_its_widest_places():
    edges = [(epoch, -1.0, 1.0) for epoch in range(6000)]
    edges[1234], edges[4321] = (1234, -7.0, 1.0), (4321, -1.0, 9.0)
    kept = thinned_band(edges)
    # 60 stretches of 100 epochs.
    assert (len(kept), kept[0], kept[12], kept[43]) == (60, (50, -1.0, 1.0), (1250, -7.0, 1.0), (4350, -1.0, 9.0))
    assert thinned_band(edges[:7]) == edges[:7]


# Code.


def test_code_is_escaped_and_signs_that_hide_something_are_written_out():
    for shown in (listing(f"# {EVIL}\nx = '<b>'"), differences("a", EVIL), differences(EVIL, "a")):
        assert "<script" not in shown
        assert "&lt;" in shown
        assert {*re.findall(r"<(\w+)", shown)} == {"span"}
    assert visible("a\u202eb\x00c\n\td\u200b") == "a\\u202eb\\u0000c\n\td\\u200b"
    assert visible("\x9d\u2028\udc80\U000e0041ä字", keep="") == "\\u009d\\u2028\\udc80\\U000e0041ä字"
    assert visible("a\n\r\tb", keep="") == "a\\u000a\\u000d\\u0009b"
    assert visible(visible(EVIL)) == visible(EVIL)


def test_differences_are_what_was_taken_and_what_was_added():
    shown = html.unescape(re.sub(r"<[^>]+>", "", differences("a = 1\nb = 2\nc = 3", "a = 1\nb = 5\nc = 3\nd = 4")))
    assert shown.splitlines() == ["@@ -1,3 +1,4 @@", " a = 1", "-b = 2", "+b = 5", " c = 3", "+d = 4"]
    assert differences("a = 1", "a = 1") == ""


# The population.


def candidate(iteration, slot, name, **values):
    return row_of(tables.CANDIDATES, iteration=iteration, slot=slot, candidate_id=name, **values)


def ranking(iteration, rung, *places):
    """Rows of the scores table, best first: (name, score, failed, survives)."""
    return [
        row_of(tables.SCORES, iteration=iteration, rung=rung, candidate_id=name, rank=rank, score=score, failed=failed,
               survives=survives)
        for rank, (name, score, failed, survives) in enumerate(places)
    ]  # fmt: skip


def curve(iteration, name, values, rung="1", series="fitness", first=1):
    return [
        row_of(tables.CURVES, iteration=iteration, rung=rung, candidate_id=name, series=series, epoch=e, value=v)
        for e, v in enumerate(values, first)
    ]


def run_of(**parts):
    return Run(**{field.name: parts.get(field.name, []) for field in dataclasses.fields(Run)})


@pytest.fixture
def run():
    """Iteration 3: `a` is the best of rung 1 and has the mutants `m` and `n`; `b` fails, `c` is dropped; `m` wins."""
    return run_of(
        candidates=[
            candidate(2, 1, "old", origin="new", reward_source="r = 1"),
            candidate(3, 0, "c", origin="new"),
            candidate(3, 1, "a", origin="elite", parent_id="old"),
            candidate(3, 2, "b", origin="new", failure="the reward was not finite"),
            candidate(3, 3, "n", origin="mutant", parent_id="a", beta=0.25),
            candidate(3, 4, "m", origin="mutant", parent_id="a", beta=1.75),
        ],
        scores=[
            *ranking(3, "1", ("a", -0.5, False, True), ("c", -0.75, False, False), ("b", 0.0, True, False)),
            *ranking(3, "mutants", ("m", -0.25, False, True), ("a", -0.375, False, True), ("n", -2.0, False, False)),
        ],
        curves=[*curve(3, "a", [-1.0, -0.5]), *curve(3, "c", [-0.75]), *curve(3, "m", [-0.25])],
    )


def test_a_mutant_stands_below_its_parent_and_slots_keep_their_order(run):
    found = members(run, 3, "m", ["1", "mutants"])
    assert [(member.row["candidate_id"], member.depth) for member in found] == [
        ("c", 0), ("a", 0), ("n", 1), ("m", 1), ("b", 0),
    ]  # fmt: skip


def test_every_candidate_says_how_it_ended(run):
    ends = {member.row["candidate_id"]: member.end for member in members(run, 3, "m", ["1", "mutants"])}
    assert ends == {
        "a": "went on to the end, ranked 2 of 3 there",
        "b": "failed in rung 1: the reward was not finite",
        "c": "eliminated after rung 1, ranked 2 of 3 with score -0.750",
        "m": "won the iteration",
        "n": "eliminated after rung mutants, ranked 3 of 3 with score -2.000",
    }


def test_a_failure_without_a_reason_is_a_beaten_probe_or_a_fitness_that_is_no_number():
    run = run_of(
        candidates=[candidate(2, 0, "p", origin="probe"), candidate(2, 1, "q", origin="probe")],
        scores=ranking(2, "1", ("p", 0.0, True, False), ("q", 0.0, True, False)),
        curves=[*curve(2, "p", [-1.0]), *curve(2, "q", [-1.0, float("nan")])],
    )
    assert [member.end for member in members(run, 2, "w", ["1"])] == [
        "failed in rung 1: another probe of the same candidate was better",
        "failed in rung 1: its fitness was not a finite number",
    ]


def test_parents_that_go_round_in_a_circle_end():
    run = run_of(candidates=[candidate(1, 0, "x", parent_id="y"), candidate(1, 1, "y", parent_id="x")])
    assert [(m.row["candidate_id"], m.depth) for m in members(run, 1, "x", [])] == [("x", 0), ("y", 1)]


def test_a_parent_is_of_the_same_iteration_else_of_the_latest_before():
    run = run_of(
        candidates=[
            candidate(1, 0, "e"), candidate(2, 0, "e", parent_id="e"), candidate(3, 0, "e", parent_id="e"),
            candidate(3, 1, "m", parent_id="e+gone"), candidate(4, 0, "m"),
        ]
    )  # fmt: skip
    of = {(row["iteration"], row["candidate_id"]): parents(run, row) for row in run.candidates}
    assert [(row["iteration"], row["candidate_id"]) for row in of[3, "e"]] == [(2, "e")]
    assert [(row["iteration"], row["candidate_id"]) for row in of[3, "m"]] == [(3, "e")]
    assert of[1, "e"] == []


# One candidate.


def verdict(iteration, slot, attempt, key, passed, **values):
    where = {"iteration": iteration, "kind": "reward", "slot": slot, "attempt": attempt, "key": key}
    return row_of(tables.VERDICTS, **where, passed=passed, **values)


def test_a_function_has_the_replies_of_its_slot_up_to_its_own_also_when_it_was_carried_over():
    run = run_of(
        verdicts=[
            verdict(1, 0, 0, "k0", True),
            verdict(1, 2, 0, "k1", False, check="variable"),
            verdict(1, 2, 1, "k2", True),
            verdict(1, 3, 0, "k4", False),
            verdict(1, 3, 1, "k5", False),
        ],
        replies=[row_of(tables.REPLIES, iteration=1, kind="reward", slot=2, attempt=0, text="broken")],
    )
    found = attempts(run, "reward", "k2", 4)
    assert [(each.verdict["key"], each.text) for each in found] == [("k1", "broken"), ("k2", "")]
    assert attempts(run, "mapping", "k2", 4) == []
    assert [[each.verdict["key"] for each in slot] for slot in dropped(run, 1)] == [["k4", "k5"]]
    assert dropped(run, 2) == []


def test_a_new_function_is_compared_with_the_winner_before_it_and_others_with_their_parents(run):
    before = run.candidates[0]
    new = {**run.candidates[1], "reward_source": "r = 2"}
    (found,) = functions(run, new, before)
    assert (found.kind, found.differences[0].since) == ("reward", before)
    assert "-r = 1" in found.differences[0].lines
    (carried,) = functions(run, {**run.candidates[2], "reward_source": "r = 1"}, None)
    assert [(each.since["candidate_id"], each.why, each.lines) for each in carried.differences] == [
        ("old", "its parent", "")
    ]
    (first,) = functions(run, new, None)
    assert first.differences == []


def test_series_are_grouped_into_charts_and_what_is_not_there_is_left_out():
    rows = [
        *curve(1, "a", [0.5, 0.75], series="component/near"), *curve(1, "a", [3.0], series="component/far"),
        *curve(1, "a", [-1.0], rung="2", first=3), *curve(1, "a", [-3.0, -2.0]),
        *curve(1, "a", [0.125], series="bonus_size"), *curve(1, "b", [9.0]),
    ]  # fmt: skip
    found = {
        chart.title: [(line.name, line.points) for line in chart.lines] for chart in charts(series_of(rows)[1, "a"])
    }
    assert found == {
        "Fitness": [("fitness", [(1, -3.0), (2, -2.0), (3, -1.0)])],
        "Components of the reward": [("far", [(1, 3.0)]), ("near", [(1, 0.5), (2, 0.75)])],
        "Size of goal and bonus": [("bonus", [(1, 0.125)])],
    }


# The run as a whole.


FIGURES = {
    "score": -0.25, "mts": -0.125, "hns_lineage": 1.5, "hns_budget": None, "epochs_to_threshold": None,
    "success": 0.75, "success_low": 0.5, "success_high": 0.875, "episodes": 4, "evaluation_seeds": 2, "evaluation_failed": 1,
    "evaluation_score_mean": -0.5, "evaluation_score_std": 0.25, "evaluation_mts_mean": -0.375, "evaluation_mts_std": 0.125,
    "epochs_spent": 30, "epochs_allowed": 40, "environment_steps": 61440, "replies": 9, "functions": 7, "valid_functions": 5,
}  # fmt: skip


@pytest.fixture
def results(params):
    """Two iterations; the winner `w` of the first has three epochs in two rungs, the mutant `v` of the second two."""
    params = changed(params, summarise={"references": {}, "thresholds": {"Quadcopter": -0.1}})
    candidates = [
        candidate(1, 0, "w", origin="new", reward_source=f"# {EVIL}", failure=""),
        candidate(2, 0, "v", origin="mutant", parent_id="w", reward_source="r = 2"),
        candidate(2, 1, "u", origin=EVIL, failure=f"it said {EVIL}"),
    ]
    run = run_of(
        candidates=candidates,
        curves=[
            *curve(1, "w", [-3.0, -2.0]), *curve(1, "w", [-1.0], rung="2", first=3), *curve(2, "v", [-0.75, -0.5]),
            *curve(2, "v", [1.0], series=f"component/{EVIL}"),
        ],
        scores=[*ranking(1, "1", ("w", -2.0, False, True)), *ranking(2, "1", ("v", -0.5, False, True), ("u", 0.0, True, False))],
        mutants=[
            row_of(tables.MUTANTS, iteration=2, index=index, varied="alpha", value=value)
            for index, value in enumerate((0.25, 0.875))
        ],
        verdicts=[verdict(2, 1, 0, "k", False, check=EVIL, message=EVIL)],
        replies=[
            row_of(tables.REPLIES, iteration=2, kind="reward", slot=1, text=EVIL, answered_by=EVIL, prompt_tokens=100,
                   completion_tokens=20, recorded_usd=0.25),
        ],
        incumbents=candidates[:2],
    )  # fmt: skip
    iterations = [
        row_of(tables.ITERATIONS, iteration=1, winner_id="w", beta=1.25, alpha=0.75, score=-2.0, mts=-1.0),
        row_of(tables.ITERATIONS, iteration=2, winner_id="v", beta=1.0, alpha=0.875, score=-0.5, mts=-0.5),
    ]
    episodes = [row_of(tables.EPISODES, episode=n, outcome=outcome) for n, outcome in enumerate((1.0, 1.0, 0.0, 1.0))]
    seeds = [row_of(tables.SEEDS, seed=1, links=1), row_of(tables.SEEDS, seed=2, failure=f"no {EVIL}")]
    evaluation = Evaluation(candidates[:2], [], seeds, episodes)
    return Results(params, run, iterations, evaluation, FIGURES, {"cpu": EVIL})


def test_the_answer_comes_in_the_order_of_what_matters_and_says_what_it_measures(results):
    found = answers(results)
    assert [(fact.name, fact.value) for fact in found] == [
        ("Final success", "0.750 (0.500 to 0.875)"),
        ("Score", "-0.250"),
        ("MTS", "-0.125"),
        ("Human normalised score, by lineage", "1.500"),
        ("Human normalised score, by budget", "undefined"),
        ("Score, 2 further seeds", "-0.500 ± 0.250"),
        ("MTS, 2 further seeds", "-0.375 ± 0.125"),
        ("Seed 2", "failed"),
    ]
    assert "share of whole episodes that it solved" in found[0].note
    assert found[4].note == "no reference is given for Quadcopter (summarise.references)"
    # One outcome that is neither 0 nor 1: a mean fitness.
    results.evaluation.episodes[0]["outcome"] = -0.5
    assert "mean fitness over whole episodes" in answers(results)[0].note


def test_the_lineage_is_one_line_with_a_mark_where_a_link_and_where_a_rung_begins(results):
    chart = winners_chart(results)
    assert list(chart.lines[0].points) == [(1, -3.0), (2, -2.0), (3, -1.0), (4, -0.75), (5, -0.5)]
    # At the end of iteration 2 one of its two candidates had failed.
    assert list(chart.marks) == [Mark(1, "1: new"), Mark(3), Mark(4, "2: mutant"), Mark(5, went="\u22121")]


def test_goal_and_bonus_of_the_lineage_are_strung_together_by_epoch(results):
    results.run.curves.extend(
        [
            *curve(1, "w", [0.5, 0.25, 0.75], series="goal_size"),
            *curve(2, "v", [0.125, 1.0], series="goal_size"),
            *curve(2, "v", [0.0, 2.0], series="bonus_size"),
            *curve(2, "u", [9.0], series="cells_visited"),
        ]
    )
    (found,) = lineage_charts(results)
    assert [(line.name, line.points) for line in found.lines] == [
        ("goal", [(1, 0.5), (2, 0.25), (3, 0.75), (4, 0.125), (5, 1.0)]),
        ("bonus", [(4, 0.0), (5, 2.0)]),
    ]
    assert list(found.marks) == [Mark(1, "1"), Mark(4, "2")]


def test_a_mark_says_how_many_mutants_came_and_how_many_candidates_went(run):
    schedule = SimpleNamespace(rungs=[SimpleNamespace(rung=name) for name in ("1", "mutants", "2")])
    lineage = [run.candidates[2], candidate(4, 0, "z", origin="new")]
    scores = [*run.scores, *ranking(3, "2", ("a", -0.25, False, True), ("m", -0.5, False, False))]
    curves = [*curve(3, "a", [-1.0, -0.5]), *curve(3, "a", [-0.25], rung="2", first=3), *curve(4, "z", [-0.125])]
    found = winners_chart(
        SimpleNamespace(
            params=schedule,
            run=dataclasses.replace(run, scores=scores, curves=curves),
            evaluation=SimpleNamespace(lineage=lineage),
        )
    )
    # Rung 1: b and c went. Then m and n came, and n went. In rung 2 m went. Iteration 4 has no ranking.
    assert list(found.marks) == [
        Mark(1, "3: elite"), Mark(3, "", "+2", "\u22123"), Mark(4, "4: new", "", "\u22121"), Mark(4),
    ]  # fmt: skip


def test_a_tree_has_a_branch_for_each_candidate_and_a_fork_where_it_leaves_its_parent(run):
    old = Member(run.candidates[0], 0, [Stop("1", 1, 1, -1.0, -1.0, False, True)], True, "won", [])
    found = tree([[old], members(run, 3, "m", ["1", "mutants"])], ["1", "mutants"])
    rungs = [
        (each.member.row["candidate_id"], each.start // COLUMN, each.stop // COLUMN, each.member.kind)
        for each in found.branches
    ]
    # Two rungs an iteration; mutants come in the second one. `old` had one rung.
    assert rungs == [
        ("old", 0, 1, "won"), ("c", 2, 3, "dropped"), ("a", 2, 4, "stayed"), ("n", 3, 4, "dropped"), ("m", 3, 4, "won"),
        ("b", 2, 3, "failed"),
    ]  # fmt: skip
    down = [HEAD + ROW // 2 + ROW * place for place in range(6)]
    assert [each.at for each in found.branches] == down
    # `a` is `old` again, which ended a rung before.
    assert found.forks == [
        Fork(COLUMN, 2 * COLUMN, down[0], down[2]),
        Fork(3 * COLUMN, 3 * COLUMN, down[2], down[3]),
        Fork(3 * COLUMN, 3 * COLUMN, down[2], down[4]),
    ]
    assert [(border.at, border.word) for border in found.borders] == [(0, "iteration 2"), (2 * COLUMN, "iteration 3")]
    assert [tick.word for tick in found.rungs] == ["1", "m", "1", "m"]


def test_the_paper_stands_beside_the_run_with_what_differs(results, root, monkeypatch):
    monkeypatch.chdir(root)
    found = {row.name: (row.here, row.paper) for row in beside_paper(results)}
    assert found["MTS"] == ("-0.125", "-0.014 ± 0.005 (table 5)")
    # (-0.014 + 1.382) / (-0.067 + 1.382)
    assert found["Human normalised score"] == ("1.500", "1.040")
    assert found["Environments"] == ("128", "8,192")
    # The winner of the first iteration has three epochs.
    assert found["Epochs of a winner in an iteration"] == ("3", "3,000")
    other = dataclasses.replace(results, params=dataclasses.replace(results.params, task="SwitchReachable"))
    assert beside_paper(other) == []


def test_outside_a_project_the_originals_numbers_are_not_known(results, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = {row.name: row.paper for row in beside_paper(results)}
    assert (found["Environments"], found["Network"]) == ("not known", "not known")


def test_the_papers_values_are_found_by_table_and_names():
    values = maximum_training_success()
    assert values[2, "PushBlock", "porse", "none"].mean == 0.318
    assert values[6, "PushBlock", "porse", "none"].mean == 0.378
    assert find_mts("PushBlock", "porse", "none").table == 6
    assert find_mts("BlockStack", "porse", "cells-3000").mean == 0.763
    assert find_mts("Quadcopter", "human-budget", "none") is None
    # Humans and sparse rewards both reach 0 in Switch.
    assert find_score("Switch", "porse", "none") is None
    assert winners_weights()["Quadcopter", 2, "alpha"] == 0.214
    assert {key[1] for key in values} <= {*TASK_CLASSES}
    assert {key[2] for key in values} <= {*METHODS}
    assert {key[3] for key in values} <= {*ABLATIONS}


def test_a_film_is_in_the_page_itself_and_a_missing_one_is_said(results):
    text = render(page_of(results, Film(b"GIF89a", 32, 24, "two seconds")))
    assert 'src="data:image/gif;base64,R0lGODlh"' in text
    assert "two seconds" in text
    shown = html.unescape(render(page_of(results, NO_FILM)))
    assert "No film of the winner: the run's policies are not beside its tables." in shown


def test_what_mutants_varied_stands_beside_the_winners_weights(results):
    first, second = weights(results)
    assert (first["beta"], first["varied"], first["values"]) == (1.25, "", [])
    assert (second["alpha"], second["varied"], second["values"]) == (0.875, "alpha", [0.25, 0.875])


def test_those_who_answered_are_counted_with_tokens_and_cost():
    def reply(who, kind, tokens, usd):
        return row_of(
            tables.REPLIES, kind=kind, answered_by=who, prompt_tokens=tokens, completion_tokens=1, recorded_usd=usd
        )

    rows = [
        reply("m", "reward", 10, 0.5),
        reply("", "beta", 3, 0.0),
        reply("m", "mapping", 30, 0.25),
        reply("m", "reward", 7, 0.0),
    ]
    assert repliers(rows) == [
        {"name": "m", "replies": 3, "kinds": "1 mapping, 2 reward", "prompt_tokens": 47, "completion_tokens": 3, "usd": 0.75},
        {"name": "not said", "replies": 1, "kinds": "1 beta", "prompt_tokens": 3, "completion_tokens": 1, "usd": 0.0},
    ]  # fmt: skip


def test_the_budget_says_what_share_was_spent_and_that_a_threshold_was_never_reached(results):
    assert [(fact.value, fact.note) for fact in budget(results)] == [
        ("30", "75 % of the 40 that any method may spend"),
        ("61,440", ""),
        ("never reached", "until a fitness first reached -0.100"),
    ]


def test_the_question_says_task_method_ablation_and_who_writes(params):
    found = {fact.name: (fact.value, fact.note) for fact in asked(params)}
    assert found["Task"] == ("Quadcopter", "size cpu")
    assert "hover" in found["Task text"][0]
    assert found["Functions written by"] == ("the model offline", "")
    assert found["Seed"] == ("1", "numeric profile portable")
    eureka = {fact.name: fact for fact in asked(dataclasses.replace(params, method="eureka"))}
    assert 'candidate.bonus: "none"' in eureka["Method"].note
    # Its module would have to be imported, and the run may be somebody else's.
    own = {fact.name: fact.value for fact in asked(dataclasses.replace(params, task="no_such_module:Cart"))}
    assert (own["Task"], own["Task text"]) == ("no_such_module:Cart", "not shown")


def test_an_incumbent_stays_until_its_score_is_exceeded(params):
    rows = [candidate(n, 0, f"w{n}") for n in (1, 2, 3, 4)]
    iterations = [
        row_of(tables.ITERATIONS, iteration=n, winner_id=f"w{n}", score=score)
        for n, score in ((1, -2.0), (2, -2.0), (3, -1.0), (4, -1.5))
    ]
    keeping = dataclasses.replace(params, fuse=dataclasses.replace(params.fuse, incumbent="best"))
    assert [row["candidate_id"] for row, _ in incumbents(iterations, rows, keeping)] == ["w1", "w1", "w3", "w3"]
    assert [row["candidate_id"] for row, _ in incumbents(iterations, rows, params)] == ["w1", "w2", "w3", "w4"]
    with pytest.raises(PorseError, match="expected the winner w4 of iteration 4 among the candidates"):
        incumbents(iterations, rows[:3], params)


def test_figures_are_read_by_people():
    values = (None, 0.0, -0.25, 0.00123456, 1234567, float("nan"), float("inf"))
    assert [figure(value) for value in values] == [
        "undefined", "0.000", "-0.250", "0.00123", "1,234,567", "not a number", "infinite",
    ]  # fmt: skip


# The page.


class Tags(HTMLParser):
    """Collects the names of elements, their attributes, and the ids and targets among them."""

    def __init__(self, text):
        super().__init__()
        self.names, self.attributes, self.ids, self.targets = set(), set(), [], set()
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.names.add(tag)
        for name, value in attrs:
            self.attributes.add(name)
            if name == "id":
                self.ids.append(value)
            if name == "href":
                self.targets.add(value)


def test_text_of_a_model_stays_text_wherever_it_stands(results):
    text = render(page_of(results, NO_FILM))
    tags = Tags(text)
    assert "script" not in tags.names
    # In the reward, the origin, the failure, the series, the verdict, the reply, who answered, the seed, the manifest.
    assert text.count("&lt;script&gt;") >= 9
    assert not {name for name in tags.attributes if name.startswith("on")}
    assert "default-src &#39;none&#39;" in text or "default-src 'none'" in text


def test_the_page_needs_nothing_else_and_every_link_leads_to_a_place_on_it(results):
    tags = Tags(render(page_of(results, NO_FILM)))
    assert not {"link", "img", "iframe", "object"} & tags.names
    assert "src" not in tags.attributes
    assert tags.targets == {target for target in tags.targets if target.startswith("#")}
    assert {target[1:] for target in tags.targets} <= {*tags.ids}
    assert len(tags.ids) == len({*tags.ids})


def test_a_page_that_is_too_large_is_refused(results, monkeypatch):
    monkeypatch.setattr(page_module, "MOST_BYTES", 999)
    with pytest.raises(PorseError, match="expected a page of at most 999 bytes, found"):
        render(page_of(results, NO_FILM))


# A real run.


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A tiny run of one iteration."""
    folder = tmp_path_factory.mktemp("page") / "run"
    with checker(parse_params(kills.tiny_params(), "a test")) as check:
        run_at_once(folder, kills.tiny_params(), check)
    return folder


def test_a_real_run_becomes_a_page_that_is_the_same_each_time(finished, tmp_path, root, monkeypatch):
    monkeypatch.chdir(root)
    pages = [tmp_path / name for name in ("once.html", "twice.html")]
    for path in pages:
        done = CliRunner().invoke(main, ["report", str(finished), "--no-film", "--out", str(path)])
        assert done.exit_code == 0, done.output
        assert done.output.startswith(f"{path}: ")
    text = pages[0].read_text()
    assert text == pages[1].read_text()
    # No path and no name of this machine.
    assert str(finished) not in text
    results = read_results(finished)
    shown = html.unescape(re.sub(r"<[^>]+>", "", text))
    found = results.figures
    assert f"{found['success']:.3f} ({found['success_low']:.3f} to {found['success_high']:.3f})" in shown
    for row in results.run.candidates:
        assert f'id="1-{row["candidate_id"]}"' in text
        assert all(line in shown for line in row["reward_source"].splitlines())
    # Three candidates: each has fitness, sizes, share and cells at least; and three charts are of the run.
    assert len(results.run.candidates) == 3
    assert text.count("<figcaption>") >= 3 * 4 + 3
    assert {"svg", "details", "table"} <= Tags(text).names


@pytest.mark.parametrize("films", [True, False])
def test_where_mujoco_cannot_even_be_imported_as_it_is_told_to_the_page_has_no_film(finished, tmp_path, root, films):
    page = tmp_path / "page.html"
    done = subprocess.run(
        [BIN / "porse", "report", finished, "--film" if films else "--no-film", "--out", page],
        cwd=root, env=os.environ | {"MUJOCO_GL": "no-such-renderer"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    warning = "warning: the page has no film: expected no-such-renderer to draw a picture, found RuntimeError: invalid"
    assert (warning in done.stderr) == films
    assert ("expected no-such-renderer to draw a picture" in page.read_text()) == films


def test_the_lineage_of_the_page_is_the_one_that_was_evaluated(finished):
    results = read_results(finished)
    links = {(row["iteration"], row["candidate_id"]) for row in results.evaluation.rows}
    assert {(row["iteration"], row["candidate_id"]) for row in results.evaluation.lineage} == links


def test_a_run_that_is_not_finished_and_a_page_that_cannot_be_written_are_said_in_a_sentence(
    finished, tmp_path, root, monkeypatch
):
    monkeypatch.chdir(root)
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(kills.tiny_params()))
    done = CliRunner().invoke(main, ["report", str(tmp_path)])
    assert (done.exit_code, "iterations.parquet, found no such file; run `porse repro`" in done.output) == (1, True)
    done = CliRunner().invoke(main, ["report", str(finished), "--no-film", "--out", str(tmp_path / "no" / "page.html")])
    assert (done.exit_code, "expected the folder" in done.output) == (1, True)


def test_an_installed_package_has_the_pages_templates(root):
    declared = __import__("tomllib").loads((root / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]
    assert declared["porse.report"] == ["pages/*"]
    assert declared["porse.report.paper"] == ["*.csv"]
    assert declared["porse.comparison"] == ["pages/*"]
    found = {path.name for path in (root / "porse" / "report" / "pages").iterdir()}
    assert found == {"page.html.jinja", "candidate.jinja", "charts.jinja", "charts.css", "chart.svg.jinja", "style.css"}


# The film.


def test_a_run_without_its_policies_and_one_of_an_own_task_have_words_in_the_films_place(params, tmp_path):
    assert winner_film(params, tmp_path) == no_film("the run's policies are not beside its tables.")
    # Its code may be anybody's: it is not imported to be shown.
    own = winner_film(dataclasses.replace(params, task="no_such_module:Cart"), tmp_path)
    assert (own.gif, "its code is not run" in own.words) == (b"", True)


def test_where_nothing_can_be_drawn_the_page_says_what_to_do(params, tmp_path, monkeypatch):
    policy = policy_file(tmp_path / "run" / str(params.iterations[-1].next) / "start", BEST)
    policy.parent.mkdir(parents=True)
    policy.touch()
    monkeypatch.setenv("MUJOCO_GL", "no-such-renderer")
    found = winner_film(params, tmp_path)
    assert (found.gif, "expected no-such-renderer to draw a picture" in found.words) == (b"", True)
