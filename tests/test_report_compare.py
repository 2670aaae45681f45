"""`porse report --compare`: figures worked out by hand, in every form, from folders and from a suite."""

import csv
import dataclasses
import html
import re
import shutil

import pytest
import yaml
from click.testing import CliRunner

import kills
from at_once import run_at_once
from browser import CHROMIUM, browser
from porse import tables
from porse.cli import main
from porse.comparison.compare import comparison
from porse.comparison.forms import csv_of, mean_text
from porse.comparison.sources import read_sources
from porse.config import parse_params
from porse.errors import PorseError
from porse.generation.states import checker
from porse.report.intervals import SIDE, WIDTH, Interval, intervals
from porse.report.results import read_figures
from porse.report.trends import read_finished
from porse.suite.folders import folders_of, write_json
from porse.suite.plan import load_suite
from porse.suite.resolve import code_id, resolve, tracked_files

MTS = {("porse", 1): -0.25, ("porse", 2): -0.5, ("eureka", 1): -1.0, ("eureka", 2): -0.75, ("eureka", 5): -0.125}
"""Of methods and seeds; seed 5 of PoRSE is not there."""


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A tiny run of one iteration."""
    folder = tmp_path_factory.mktemp("compare") / "run"
    with checker(parse_params(kills.tiny_params(), "a test")) as check:
        run_at_once(folder, kills.tiny_params(), check)
    return folder


def copied(finished, folder, mts, **params):
    """The finished run in another folder, with other parameters and another MTS."""
    folder.mkdir(parents=True)
    shutil.copytree(finished / "results", folder / "results")
    document = yaml.safe_load((finished / "params.yaml").read_text()) | params
    # Against these, the score by lineage is mts + 2; with the whole budget both are equal, but for Eureka.
    human = {"lineage": -1.0, "budget": -1.0 if params["method"] == "eureka" else -2.0}
    reference = {"human": human, "sparse": {"lineage": -2.0, "budget": -2.0}}
    document["summarise"] |= {"references": {"Quadcopter": reference}}
    (folder / "params.yaml").write_text(yaml.safe_dump(document))
    path = folder / "results" / "iterations.parquet"
    tables.write(path, tables.ITERATIONS, [row | {"mts": mts} for row in tables.read(path, tables.ITERATIONS)])
    return folder


@pytest.fixture
def runs(finished, tmp_path, root, monkeypatch):
    monkeypatch.chdir(root)
    return [
        copied(finished, tmp_path / f"{method}-{seed}", mts, method=method, seed=seed)
        for (method, seed), mts in MTS.items()
    ]


def test_seeds_are_averaged_and_compared_pair_by_pair_with_the_paper_beside(runs):
    shown = comparison(read_sources(runs), "porse")
    assert (shown.tasks, shown.labels) == (["Quadcopter"], ["porse", "eureka"])
    porse, eureka = (shown.cell("mts", "Quadcopter", label) for label in ("porse", "eureka"))
    # -0.75 / 2, and the deviation of two values is their distance over the root of two.
    assert (porse.seeds, porse.mean, porse.deviation) == (2, -0.375, pytest.approx(0.25 / 2**0.5))
    assert (porse.low, porse.high, porse.difference) == (-0.5, -0.25, None)
    # -1.875 / 3. Seeds 1 and 2: -1.0 + 0.25 and -0.75 + 0.5, mean -0.5; seed 5 has no partner.
    assert (eureka.seeds, eureka.mean, eureka.difference) == (3, -0.625, -0.5)
    assert -0.75 <= eureka.difference_low < -0.5 < eureka.difference_high <= -0.25
    assert (porse.paper.mean, porse.paper.std, porse.paper.table) == (-0.014, 0.005, 5)
    # The paper's means: (-0.023 + 1.382) / (-0.067 + 1.382).
    assert shown.cell("hns_lineage", "Quadcopter", "eureka").paper.mean == pytest.approx(1.359 / 1.315)
    assert shown.cell("hns_budget", "Quadcopter", "porse") is None


def test_one_run_has_the_interval_of_its_episodes_and_no_deviation(runs):
    shown = comparison(read_sources(runs[:1]), "")
    found = read_figures(runs[0])
    cell = shown.cell("success", "Quadcopter", "porse")
    assert (cell.mean, cell.low, cell.high) == (found["success"], found["success_low"], found["success_high"])
    cell = shown.cell("mts", "Quadcopter", "porse")
    assert (cell.deviation, cell.low, cell.high) == (None, None, None)


def test_human_and_sparse_runs_among_them_are_what_the_score_is_measured_against(finished, tmp_path, root, monkeypatch):
    monkeypatch.chdir(root)
    folders = [
        copied(finished, tmp_path / method, mts, method=method)
        for method, mts in (("porse", -0.25), ("human", -0.5), ("sparse", -1.5))
    ]
    # (-0.25 + 1.5) / (-0.5 + 1.5), as in a suite's status.
    assert comparison(read_sources(folders), "").cell("hns_lineage", "Quadcopter", "porse").mean == 1.25


def test_two_runs_of_one_seed_are_told_apart_by_their_folders(runs, finished, tmp_path):
    again = copied(finished, tmp_path / "again", -2.0, method="porse", seed=1)
    shown = comparison(read_sources([runs[0], runs[1], again]), "")
    assert shown.labels == ["porse (porse-1)", "porse", "porse (again)"]
    # The paper's value is of PoRSE, not of a variant of it.
    assert shown.cell("mts", "Quadcopter", "porse (again)").paper is None
    (tmp_path / "other").mkdir()
    with pytest.raises(PorseError, match="expected runs that can be told apart, found Quadcopter-porse-again-1 twice"):
        read_sources([again, shutil.copytree(again, tmp_path / "other" / "again")])


def test_bands_and_means_of_a_chart_are_over_the_seeds(runs):
    shown = comparison(read_sources(runs), "")
    (chart,) = shown.by_iteration
    assert [line.name for line in chart.lines] == ["porse", "eureka"]
    ((_, y),), ((_, low, high),) = chart.lines[0].points, chart.lines[0].band
    # -0.25 and -0.5
    assert (low, y, high) == (-0.5, -0.375, -0.25)
    (chart,) = shown.by_epoch
    assert [x for x, _ in chart.lines[0].points] == list(range(1, len(chart.lines[0].points) + 1))


def test_the_mts_so_far_never_falls_although_an_iteration_may(finished, tmp_path, root, monkeypatch):
    """Three iterations of 1, 4 and 2, and two of 3 and 0.5: so far 1, 4, 4 and 3, 3."""
    monkeypatch.chdir(root)
    reached = {
        copied(finished, tmp_path / str(seed), 0.0, method="porse", seed=seed): mts
        for seed, mts in ((1, (1.0, 4.0, 2.0)), (2, (3.0, 0.5)))
    }

    def read(folder, variant):
        run = read_finished(folder, variant)
        rows = [{**run.iterations[0], "iteration": n, "mts": mts} for n, mts in enumerate(reached[folder], 1)]
        return dataclasses.replace(run, iterations=rows)

    monkeypatch.setattr("porse.comparison.compare.read_finished", read)
    (chart,) = comparison(read_sources([*reached]), "").by_iteration
    (line,) = chart.lines
    # (1 + 3) / 2, (4 + 3) / 2, and 4 of the one that has a third.
    assert line.points == [(1, 2.0), (2, 3.5), (3, 4.0)]
    assert line.band == [(1, 1.0, 3.0), (2, 3.0, 4.0), (3, 4.0, 4.0)]


def report(*arguments):
    return CliRunner().invoke(main, ["report", "--compare", *map(str, arguments)])


def test_every_form_says_the_same(runs, tmp_path):
    texts = {}
    for suffix in ("html", "md", "tex", "csv"):
        done = report(*runs, "--baseline", "porse", "--out", tmp_path / f"out.{suffix}")
        assert done.exit_code == 0, done.output
        texts[suffix] = (tmp_path / f"out.{suffix}").read_text()
    assert "-0.625 ± 0.451; [" in texts["md"]
    assert (
        "| task | porse | eureka |\n| --- | --- | --- |\n| Quadcopter | -0.375 ± 0.177; [-0.500, -0.250]; n = 2; paper"
        in texts["md"]
    )
    assert r"-0.625 $\pm$ 0.451; [" in texts["tex"]
    assert texts["tex"].count(r"\toprule") == texts["tex"].count(r"\bottomrule") == texts["md"].count("## ")
    rows = list(csv.DictReader(texts["csv"].splitlines()))
    eureka = next(row for row in rows if (row["label"], row["figure"]) == ("eureka", "mts"))
    assert (float(eureka["mean"]), float(eureka["difference"]), eureka["paper_table"]) == (-0.625, -0.5, "5")
    shown = html.unescape(re.sub(r"<[^>]+>", " ", texts["html"]))
    assert "-0.625 ± 0.451" in shown
    assert "<h1>5 runs on Quadcopter</h1>" in texts["html"]
    assert "<script" not in texts["html"]
    assert "undefined" in shown


def test_what_cannot_be_compared_is_said_in_a_sentence(runs, tmp_path):
    for arguments, said in (
        ([runs[0], "--baseline", "roska"], "expected a baseline among porse, found 'roska'"),
        ([runs[0], "--out", tmp_path / "out.pdf"], "end in .html or .md or .tex or .csv"),
        ([tmp_path], "params.yaml"),
    ):
        done = report(*arguments)
        assert (done.exit_code, said in done.output) == (1, True), done.output
    done = CliRunner().invoke(main, ["report", *map(str, runs)])
    assert (done.exit_code, "use --compare" in " ".join(done.output.split())) == (2, True)


def test_a_suite_is_compared_by_its_file_and_what_is_not_done_is_said(finished, tmp_path, root, monkeypatch):
    """A suite's results are put where they belong: running one is `tests/test_suite.py`'s."""
    monkeypatch.chdir(root)
    file = tmp_path / "pair.yaml"
    name = f"test-compare-{tmp_path.name}"
    file.write_text(
        yaml.safe_dump({"name": name, "tasks": ["Quadcopter"], "methods": ["porse", "eureka"], "seeds": [3]})
    )
    suite = load_suite(file)
    folders = folders_of(name, root)
    done = resolve(suite, root, code_id(root, tracked_files(root)), str(file))[0]
    try:
        result = folders.result(done.entry.name)
        copied(finished, result, -0.25, method="porse", seed=3)
        shutil.copy(finished / "metrics.json", result)
        write_json(result / "done.json", done.ids)
        sources = read_sources([file])
    finally:
        shutil.rmtree(folders.suite)
    assert [run.status.entry.name for run in sources.runs] == ["Quadcopter-porse-3"]
    assert sources.left_out == [f"Of {file} 1 of 2 entries are done and shown; left out: 1 waiting."]


def test_intervals_are_where_their_values_are():
    drawing = intervals("t", [Interval("a", 1.0, 0.0, 2.0, 4.0), Interval("b", 3.0, None, None, None)])
    room = WIDTH - 2 * SIDE
    first, second = drawing.places
    assert (first.low, first.value, first.high, first.other) == (
        SIDE, SIDE + room / 4, SIDE + room / 2, SIDE + room,
    )  # fmt: skip
    assert (second.low, second.value, second.other) == (None, SIDE + 3 * room / 4, None)
    # The axis reaches 0 and 1 where it is told to.
    (place,) = intervals("t", [Interval("a", 0.5, None, None, None)], (0.0, 1.0)).places
    assert place.value == SIDE + room / 2


def test_a_deviation_that_is_rounding_is_none():
    assert mean_text(0.1, 1.7e-17) == "0.100 ± 0.000"
    assert mean_text(0.1, 0.25) == "0.100 ± 0.250"


@pytest.mark.skipif(CHROMIUM is None, reason="no browser: set PORSE_CHROMIUM, or have chromium on the PATH")
def test_the_page_of_a_comparison_fits_a_phone_and_nothing_complains(runs, tmp_path):
    page = tmp_path / "out.html"
    assert report(*runs, "--baseline", "porse", "--out", page).exit_code == 0
    with browser(tmp_path / "profile") as window:
        for width, phone in ((1280, False), (390, True)):
            window.open(page, width, 844, phone=phone)
            assert window.value("document.documentElement.scrollWidth") <= width
            assert window.value("document.querySelectorAll('svg.means circle').length") >= 6
        assert (window.complaints, window.requests) == ([], [page.resolve().as_uri()])


def test_a_table_in_csv_has_full_numbers(runs):
    text = csv_of(comparison(read_sources(runs[:2]), ""))
    assert text.splitlines()[1].startswith(f"Quadcopter,porse,mts,2,-0.375,{0.25 / 2**0.5!r}"[:40])
