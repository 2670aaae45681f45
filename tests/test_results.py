"""The page of results: its statistics worked out by hand, its tables that grow, and that the committed page is current."""

import re
from statistics import fmean

import pytest

import kills
from at_once import run_at_once
from porse import tables
from porse.comparison.evidence import (
    RUN_COLUMNS,
    WINNER_COLUMNS,
    Evidence,
    changed,
    evidence_of,
    merged,
    read_evidence,
    write_evidence,
)
from porse.comparison.reliable import interquartile_mean, probability_of_improvement
from porse.comparison.results_page import FOLDER, PAGE, page
from porse.config import parse_params
from porse.errors import PorseError
from porse.generation.states import checker
from porse.report.answer import author_of
from porse.suite.plan import Entry, load_suite


def test_the_interquartile_mean_leaves_out_a_quarter_at_each_end():
    # Of eight values, two at each end: (3 + 4 + 7 + 10) / 4.
    found = interquartile_mean([[1.0, 100.0, 3.0, 4.0], [7.0, -50.0, 10.0, 20.0]])
    assert found.value == 6.0
    assert -50.0 <= found.low < 6.0 < found.high <= 100.0
    # Of five values one at each end, and of one task with one seed nothing is known about the spread.
    assert interquartile_mean([[5.0, 1.0, 9.0, 2.0, 40.0]]).value == pytest.approx(16.0 / 3)
    assert interquartile_mean([[2.5]]).low is None


def test_a_tie_is_half_an_improvement_and_tasks_count_alike():
    # First task: 3 beats 1 and 2, 2 beats 1 and ties 2: 3.5 of 4. Second task: 0 beats none of 3.
    found = probability_of_improvement([[3.0, 2.0], [0.0, 0.0]], [[1.0, 2.0], [5.0, 6.0, 7.0]])
    assert found.value == pytest.approx((3.5 / 4 + 0.0) / 2)
    assert probability_of_improvement([[1.0, 2.0]], [[3.0, 2.0]]).value == pytest.approx(0.125)


def test_resampling_draws_seeds_within_their_task():
    """Seeds of a task are equal: whatever is drawn within it, each task keeps its value. Drawn from both, it would not."""
    found = interquartile_mean([[1.0, 1.0], [3.0, 3.0]])
    assert (found.value, found.low, found.high) == (2.0, 2.0, 2.0)


@pytest.mark.parametrize(
    ("method", "generator", "author"),
    [
        ("porse", "model", "model"),
        ("porse", "grammar", "grammar"),
        # Its goal is the task's own, but its mapping is not.
        ("llmcount", "model", "model"),
        ("eureka", "model", "model"),
        ("human", "model", "nobody"),
        ("sparse", "grammar", "nobody"),
    ],
)
def test_a_run_without_functions_of_its_own_has_no_author(method, generator, author):
    document = kills.tiny_params() | {"method": method, "generator": generator}
    assert author_of(parse_params(document, "a test")) == author


def run_line(**changes):
    line = dict.fromkeys(RUN_COLUMNS, "0") | {
        "suite": "s", "task": "Quadcopter", "method": "porse", "ablation": "none", "variant": "", "seed": "1", "author": "grammar",
        "mts": "-0.25", "score": "-0.5", "success": "-0.75", "epochs_spent": "1000", "epochs_allowed": "2000", "functions": "12",
        "valid_functions": "9", "curves": "aa", "evaluation_mts_mean": "",
    } | {name: str(value) for name, value in changes.items()}  # fmt: skip
    name = line["method"] if line["ablation"] == "none" else f"{line['method']}-{line['ablation']}"
    return line | {"entry": f"{line['task']}-{name}-{line['seed']}"}


def winner_line(run, iteration, mts):
    return {
        "suite": run["suite"],
        "entry": run["entry"],
        "iteration": str(iteration),
        "score": "0",
        "mts": str(mts),
        "beta": "1",
        "alpha": "0",
    }


def test_runs_that_are_finished_here_replace_their_rows_and_others_stay():
    old = [run_line(seed=1), run_line(seed=2, mts=-9), run_line(seed=3, suite="other")]
    new = [run_line(seed=2, mts=-1, curves="bb"), run_line(seed=4)]
    winners = [winner_line(run, 1, -2) for run in old]
    order = [("s", f"Quadcopter-porse-{seed}") for seed in (4, 2, 1)]
    found = merged(Evidence(old, winners), Evidence(new, [winner_line(new[0], 1, -3)]), order)
    assert [(line["suite"], line["seed"], line["mts"]) for line in found.runs] == [
        ("other", "3", "-0.25"), ("s", "4", "-0.25"), ("s", "2", "-1"), ("s", "1", "-0.25"),
    ]  # fmt: skip
    assert [(line["entry"], line["mts"]) for line in found.winners] == [
        ("Quadcopter-porse-3", "-2"), ("Quadcopter-porse-2", "-3"), ("Quadcopter-porse-1", "-2"),
    ]  # fmt: skip


def test_a_run_that_is_computed_again_has_the_same_bits_or_is_named():
    old = Evidence([run_line(seed=1), run_line(seed=2)], [])
    new = Evidence([run_line(seed=1), run_line(seed=2, curves="bb"), run_line(seed=3)], [])
    assert changed(old, new) == (["Quadcopter-porse-1"], ["Quadcopter-porse-2"])


def test_the_tables_are_read_as_they_were_written_and_others_are_refused(tmp_path):
    assert read_evidence(tmp_path) == Evidence([], [])
    run = run_line()
    kept = Evidence([run], [winner_line(run, 1, -2)])
    write_evidence(kept, tmp_path)
    assert read_evidence(tmp_path) == kept
    (tmp_path / "winners.csv").write_text("suite,mts\ns,1\n")
    with pytest.raises(PorseError, match=r"expected the columns suite, entry, iteration.* found suite, mts"):
        read_evidence(tmp_path)


def test_a_row_has_what_the_run_reached(tmp_path):
    with checker(parse_params(kills.tiny_params(), "a test")) as check:
        run_at_once(tmp_path / "run", kills.tiny_params(), check)
    found = evidence_of("suite", Entry("Quadcopter", "porse", "none", "", 7, {}), tmp_path / "run")
    row, iterations = found.runs[0], tables.read(tmp_path / "run" / "results" / "iterations.parquet", tables.ITERATIONS)
    assert tuple(row) == RUN_COLUMNS
    assert tuple(found.winners[0]) == WINNER_COLUMNS
    assert (row["suite"], row["entry"], row["author"]) == (
        "suite",
        "Quadcopter-porse-7",
        kills.tiny_params()["generator"],
    )
    assert float(row["mts"]) == pytest.approx(max(line["mts"] for line in iterations), rel=1e-5)
    assert [float(line["beta"]) for line in found.winners] == pytest.approx(
        [line["beta"] for line in iterations], rel=1e-5
    )
    # One further seed: its highest fitness of any epoch.
    further = tables.read(tmp_path / "run" / "results" / "evaluation.parquet", tables.EVALUATION)
    assert float(row["evaluation_mts_mean"]) == pytest.approx(max(line["fitness"] for line in further), rel=1e-5)
    assert len(row["curves"]) == 16


def test_the_page_has_a_row_for_each_method_with_the_paper_beside_it():
    porse = [run_line(seed=seed, mts=mts) for seed, mts in ((1, -0.5), (2, -0.25), (3, -0.125))]
    other = [run_line(method="eureka", seed=seed, mts=mts) for seed, mts in ((1, -0.3), (2, -1.0))]
    apart = [
        run_line(ablation="fixed-beta", suite="t", seed=1, mts=-0.2),
        run_line(seed=1, suite="u", epochs_allowed=77, mts=9),
    ]
    runs = [*porse, *other, *apart]
    text, pictures = page(Evidence(runs, [winner_line(run, n, run["mts"]) for run in runs for n in (1, 2)]))
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    found = {(line[0], line[1]): line for line in lines}
    assert found["porse", "3"][2].startswith("-0.292 ± 0.191")
    assert (found["porse", "3"][4], found["porse", "3"][9]) == ("", "-0.014 ± 0.005")
    # -0.5 beats -1.0, -0.25 and -0.125 beat both: five of six.
    assert found["eureka", "2"][4].startswith("0.833 (")
    assert (found["eureka", "2"][7:9], found["eureka", "2"][9]) == (["1,000", "0.75"], "-0.023 ± 0.007")
    # Against all three runs of PoRSE of the other suite, but not against one of another length: only -0.125 is better.
    assert found["porse fixed-beta", "1"][4] == "0.333"
    assert sorted(pictures) == ["s-Quadcopter.svg", "t-Quadcopter.svg", "u-Quadcopter.svg"]
    assert "## Table 5" in text
    assert "not run; paper -0.067" in text


def rows_of_group(name, runs):
    """Returns the cells of the page's table of a suite and a task, by method and column."""
    text, _ = page(Evidence(runs, [winner_line(run, 1, run["mts"]) for run in runs]))
    lines = [
        line for line in text.partition(f"## {name}\n")[2].partition("\n![")[0].splitlines() if line.startswith("|")
    ]
    names, _, *cells = ([cell.strip() for cell in line.split("|")[1:-1]] for line in lines)
    return {line[0]: dict(zip(names, line, strict=True)) for line in cells}


def test_each_row_is_compared_with_porses_runs_by_its_own_author():
    runs = [
        run_line(author="nobody", method="human", mts=-0.3),
        run_line(author="grammar", seed=1, mts=-0.5),
        run_line(author="grammar", seed=2, mts=-0.2),
        run_line(author="grammar", seed=3, mts=-0.1),
        run_line(author="model", method="roska", mts=-0.3),
        run_line(author="grammar", method="eureka", mts=-0.6),
        run_line(author="model", suite="t", seed=1, mts=-0.25),
        run_line(author="model", suite="t", seed=2, mts=-0.75),
        run_line(author="nobody", method="sparse", suite="t", mts=-0.4),
        run_line(author="nobody", method="sparse", suite="alone", task="Over", mts=-0.4),
    ]
    found = rows_of_group("s: Quadcopter", runs)
    # The first author of the group is the grammar: two of its three beat -0.3. Of the model's two, in the other suite, one does.
    assert {name: row["better"] for name, row in found.items()} == {
        "human": "0.667", "porse": "", "roska": "0.5", "eureka": "1",
    }  # fmt: skip
    # There the first author is the model.
    assert rows_of_group("t: Quadcopter", runs)["sparse"]["better"] == "0.5"
    assert rows_of_group("alone: Over", runs)["sparse"]["better"] == ""


def test_a_score_that_is_a_maximum_is_marked_and_a_figure_that_compares_is_shown_where_runs_have_it():
    runs = [
        run_line(seed=1, score=-0.5),
        run_line(seed=2, score=-0.25),
        run_line(method="eureka", score=-0.75),
        run_line(method="revolve-auto", score=-0.875),
        run_line(method="human", author="nobody", score=-1),
    ]
    found = rows_of_group("s: Quadcopter", runs)
    assert {name: row["score"] for name, row in found.items()} == {
        "porse": "-0.375 ± 0.177", "eureka": "-0.750 max", "revolve-auto": "-0.875 max", "human": "-1.000",
    }  # fmt: skip
    assert "further MTS" not in found["porse"]
    # The second seed of PoRSE has one since it is kept; the first and REvolve's run are from before.
    later = [
        runs[0],
        runs[1] | {"evaluation_mts_mean": "-0.3125"},
        runs[2] | {"evaluation_mts_mean": "-0.5"},
        *runs[3:],
    ]
    found = rows_of_group("s: Quadcopter", later)
    assert {name: row["further MTS"] for name, row in found.items()} == {
        "porse": "-0.312", "eureka": "-0.500", "revolve-auto": "", "human": "",
    }  # fmt: skip
    assert found["porse"]["final"] == "-0.750 ± 0.000"


def test_a_table_of_the_paper_has_a_row_for_each_author_and_everybodys_references():
    runs = [
        run_line(author="grammar", seed=1, mts=-0.5),
        run_line(author="grammar", seed=2, mts=-0.25),
        run_line(author="model", suite="t", seed=1, mts=-0.125),
        run_line(author="model", suite="t", method="eureka", seed=1, mts=-0.75),
        run_line(author="nobody", suite="t", method="human", seed=1, mts=-0.0625),
    ]
    text, _ = page(Evidence(runs, [winner_line(run, 1, run["mts"]) for run in runs]))
    five = text.partition("## Table 5\n\n")[2].partition("\n\n")[0].splitlines()
    names = [cell.strip() for cell in five[0].split("|")[1:-1]]
    rows = [dict(zip(names, (cell.strip() for cell in line.split("|")[1:-1]), strict=True)) for line in five[2:]]
    assert [row["functions by"] for row in rows] == ["the grammar", "a language model"]
    # -0.5 and -0.25 have mean -0.375.
    assert rows[0]["porse"].startswith("-0.375 ± 0.177, n = 2; ")
    assert rows[1]["porse"].startswith("-0.125, n = 1; ")
    assert rows[0]["eureka"].startswith("not run; ")
    assert rows[1]["eureka"].startswith("-0.750, n = 1; ")
    assert {row["human"].partition(";")[0] for row in rows} == {"-0.062, n = 1"}
    assert "3 runs; functions by a language model; at most" in text
    alone, _ = page(Evidence(runs[4:], [winner_line(runs[4], 1, -0.0625)]))
    assert "| Quadcopter | nobody |" in alone
    assert "\n1 run; functions by nobody;" in alone


def lines_of_table(number, runs, winners):
    """Returns the cells of a table of the page, by the names of their columns."""
    text, _ = page(Evidence(runs, winners))
    found = text.partition(f"## Table {number}\n\n")[2].partition("\n\n")[0].splitlines()
    names, _, *lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in found] or [[], []]
    return [dict(zip(names, line, strict=True)) for line in lines]


def test_the_drop_of_an_ablation_is_a_share_of_porses_mts_by_the_same_author():
    runs = [
        run_line(seed=1, mts=-0.4),
        run_line(seed=2, mts=-0.6),
        run_line(seed=1, ablation="fixed-beta", mts=-0.8),
        run_line(seed=1, ablation="without-fusion", mts=-0.45),
        run_line(seed=1, author="model", suite="t", mts=-0.2),
        run_line(seed=1, task="FrankaCabinet", mts=0.8),
        run_line(seed=1, task="FrankaCabinet", ablation="without-bonus", mts=0.6),
        run_line(seed=1, task="PushBlock", mts=0.0),
        run_line(seed=1, task="PushBlock", ablation="fixed-alpha", mts=0.5),
    ]
    first, second, third = lines_of_table(16, runs, [winner_line(run, 1, run["mts"]) for run in runs])
    # PoRSE's mean is -0.5; the model's run has no ablation beside it, so that it has no row.
    assert (first["task"], first["functions by"]) == ("Quadcopter", "the grammar")
    assert first["porse fixed-beta"] == "60.0 %; paper 35.7 %"
    assert first["porse without-fusion"] == "-10.0 %; paper 142.9 %"
    assert first["porse without-bonus"] == "not run; paper 171.4 %"
    assert (second["task"], second["porse without-bonus"]) == ("FrankaCabinet", "25.0 %; paper 4.7 %")
    # Against 0 there is no share. The paper's is that of table 2, where PoRSE has 0.318, not 0.378.
    assert third["porse fixed-alpha"] == "undefined; paper 2.8 %"
    assert "porse" not in first


def test_the_weights_are_those_that_porses_winners_have_where_mutants_vary_them():
    runs = [run_line(seed=1), run_line(seed=2), run_line(seed=1, method="simhash"), run_line(seed=9, task="Over")]
    winners = [
        winner_line(run, n, 0) | {"beta": str(beta), "alpha": str(alpha)}
        for run, weights in zip(
            runs,
            (((0.7, 0.2), (0.5, 0.3)), ((1.1, 0.4), (0.6, 0.9)), ((9, 9), (9, 9)), ((8, 8), (8, 8))),
            strict=True,
        )
        for n, (beta, alpha) in enumerate(weights, start=1)
    ]
    (only,) = lines_of_table(18, runs, winners)
    assert (only["task"], only["runs"]) == ("Quadcopter", "2")
    # (0.7 + 1.1) / 2, and half their distance times the root of 2; alpha in the second iteration, (0.3 + 0.9) / 2.
    assert only["1: beta"] == "0.900 ± 0.283; paper 1.734"
    assert only["2: alpha"] == "0.600 ± 0.424; paper 0.214"
    assert only["3: beta"] == "not run; paper 1.462"


def test_a_table_without_a_task_of_ours_is_named():
    run, other = run_line(), run_line(task="BlockStack")
    text, _ = page(Evidence([run], [winner_line(run, 1, 0)]))
    assert (
        "Table 17 has no task on which a suite has run: Humanoid, LiftUnderarm, BlockStack, TwoCatchUnderarm." in text
    )
    text, _ = page(Evidence([run, other], [winner_line(each, 1, 0) for each in (run, other)]))
    assert "Table 17 has no task" not in text
    assert "## Table 17" in text


def test_every_run_of_a_suite_is_on_the_page_and_the_page_is_current(root):
    found = read_evidence(root / "docs" / FOLDER)
    text, pictures = page(found)
    assert (root / "docs" / PAGE).read_text(encoding="utf-8") == text
    for name, picture in pictures.items():
        assert (root / "docs" / FOLDER / name).read_text(encoding="utf-8") == picture
    for name in {line["suite"] for line in found.runs}:
        wanted = {entry.name for entry in load_suite(root / "suites" / f"{name}.yaml").entries}
        assert {line["entry"] for line in found.runs if line["suite"] == name} == wanted
    keys = [(line["suite"], line["entry"]) for line in found.runs]
    assert len(set(keys)) == len(keys)
    assert {(line["suite"], line["entry"]) for line in found.winners} == set(keys)


WORDS = {
    "PoRSE": ("porse", "none", ""),
    "PoRSE without bonus": ("porse", "without-bonus", ""),
    "Eureka": ("eureka", "none", ""),
    "REvolve": ("revolve-auto", "none", ""),
    "ROSKA": ("roska", "none", ""),
    "LLMCount": ("llmcount", "none", ""),
    "human": ("human", "none", ""),
    "sparse": ("sparse", "none", ""),
    "without fusion": ("porse", "without-fusion", ""),
    "without bonus": ("porse", "without-bonus", ""),
    "SimHash cells": ("simhash", "none", ""),
    "2000 cells": ("porse", "cells-2000", ""),
    "3000 cells": ("porse", "cells-3000", ""),
    "weights sum to 1": ("porse", "weights-sum-to-1", ""),
    "spliced mappings": ("porse", "spliced-mapping", ""),
    "fixed alpha": ("porse", "fixed-alpha", ""),
    "fixed beta": ("porse", "fixed-beta", ""),
    "without goal reward": ("porse", "without-goal-reward", ""),
    "with its best winner as incumbent": ("porse", "none", "incumbent-best"),
}
"""What docs/results.md calls a method, an ablation and a variant."""


def measured(found, own, full):
    """Returns the numbers of each cell of the page's tables in words, and whether they are maxima.

    Args:
        found: the tables.
        own: the rows of a method's runs on a task, by seed.
        full: those of PoRSE's.
    """
    mts = {seed: float(row["mts"]) for seed, row in own.items()}
    scores = [float(row["score"]) for row in own.values()]
    above = sum(float(full[seed]["mts"]) > value for seed, value in mts.items() if seed in full)
    row = own["1"]
    again = [row["evaluation_score_mean"], row["evaluation_score_std"]]
    won = [line for line in found.winners if (line["suite"], line["entry"]) == (row["suite"], row["entry"])]
    return {
        **{name: [mts[seed]] for seed in mts for name in (seed, f"seed {seed}", f"MTS, seed {seed}")},
        "MTS": [mts["1"]],
        "mean": [fmean(mts.values())],
        "PoRSE above": [above, len(mts)],
        "score": [scores[0]],
        "score, mean": [fmean(scores)],
        "score with three further seeds": [float(value) for value in again if value],
        "final": [float(row["success"])],
        "MTS by iteration": [float(line["mts"]) for line in won],
    }


@pytest.mark.parametrize(
    ("section", "suites"),
    [
        *(
            (f"Methods: {task}", ["methods"])
            for task in ("Quadcopter", "FrankaCabinet", "DoorOpenOutward", "PushBlock")
        ),
        *((f"Parts of PoRSE: {task}", ["mechanisms", "ablations"]) for task in ("Quadcopter", "PushBlock")),
    ],
)
def test_the_page_in_words_has_the_tables_numbers_and_marks_maxima(section, suites, root):
    found = read_evidence(root / "docs" / FOLDER)
    text = (
        (root / "docs" / "results.md")
        .read_text(encoding="utf-8")
        .partition(f"\n## {section}\n")[2]
        .partition("\n## ")[0]
    )
    names, _, *lines = (
        [cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")
    )
    runs = [row for row in found.runs if row["suite"] in suites and row["task"] == section.rpartition(" ")[2]]
    by_name = {
        name: {row["seed"]: row for row in runs if (row["method"], row["ablation"], row["variant"]) == what}
        for name, what in WORDS.items()
    }
    assert {line[0] for line in lines} <= {name for name, own in by_name.items() if own}
    checked = 0
    for label, *cells in lines:
        expected = measured(found, by_name[label], by_name["PoRSE"])
        for name, cell in zip(names[1:], cells, strict=True):
            numbers = [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", cell)]
            if numbers and name in expected:
                assert numbers == pytest.approx(expected[name], abs=0.00050001), (label, name)
                checked += len(numbers)
            if numbers and name.startswith("score"):
                assert cell.endswith(" max") == (label in ("Eureka", "REvolve")), (label, name)
    assert checked > 20
