"""Table 18 and figure 6 from finished runs: weights of winners by iteration, and fitness along their trainings."""

import csv
import io
import json
import shutil

import pytest
import yaml
from click.testing import CliRunner

import tiny
from meaning_cases import row_of
from porse import tables
from porse.cli import main
from porse.errors import TableError
from porse.report.trends import read_finished, trend, trends, trends_table, winners_fitness
from porse.suite.folders import folders_of, write_json
from porse.suite.plan import load_suite
from porse.suite.resolve import code_id, resolve, tracked_files


def with_presets(folder):
    """Gives a folder what parameters may be left to: commands that read them run in the project's root."""
    if (tiny.ROOT / "presets").is_dir():
        shutil.copytree(tiny.ROOT / "presets", folder / "presets")


def finished(folder, weights, fitness=None, **chosen):
    """Writes a run whose winners have these (beta, alpha), and trainings with this fitness."""
    folder.mkdir(parents=True, exist_ok=True)
    with_presets(folder)
    (folder / "params.yaml").write_text(yaml.safe_dump({**tiny.committed_params(), **chosen}))
    rows = [
        row_of(
            tables.ITERATIONS,
            iteration=n,
            winner_id=f"w{n}",
            beta=beta,
            alpha=alpha,
            # Each curve has the winner and a loser.
            epochs=2 * len(fitness[n - 1]) if fitness else 0,
        )
        for n, (beta, alpha) in enumerate(weights, 1)
    ]
    tables.write(folder / "results" / "iterations.parquet", tables.ITERATIONS, rows)
    curves = [
        row_of(
            tables.CURVES,
            iteration=n,
            rung=str(epoch),
            candidate_id=name,
            series=series,
            epoch=epoch,
            value=value + shift,
        )
        for n, values in enumerate(fitness or [], 1)
        for name, series, shift in ((f"w{n}", "fitness", 0.0), ("loser", "fitness", 50.0), (f"w{n}", "goal", 90.0))
        for epoch, value in enumerate(values, 1)
    ]
    tables.write(folder / "results" / "curves.parquet", tables.CURVES, curves)
    return folder


WEIGHTS = [(1.8, 0.8), (1.1, 0.2), (1.4, 0.7), (1.2, 0.5), (0.7, 0.6)]
OTHERS = [(1.2, 0.1), (1.3, 0.6), (1.0, 0.2), (1.5, 0.9), (0.9, 0.3)]


def test_a_trend_holds_what_each_iteration_varied_in_its_winner(tmp_path):
    run = read_finished(finished(tmp_path, WEIGHTS))
    # odd iterations vary beta, even ones alpha, as table 18 has it with iterations from 0
    assert [(step["iteration"], step["varied"], step["value"]) for step in trend(run)] == [
        (1, "beta", 1.8),
        (2, "alpha", 0.2),
        (3, "beta", 1.4),
        (4, "alpha", 0.5),
        (5, "beta", 0.7),
    ]


def test_what_is_not_varied_has_no_trend(tmp_path):
    fixed = read_finished(finished(tmp_path / "fixed", WEIGHTS, ablation="fixed-beta"))
    assert [(step["iteration"], step["varied"]) for step in trend(fixed)] == [(2, "alpha"), (4, "alpha")]
    assert trend(read_finished(finished(tmp_path / "eureka", WEIGHTS, method="eureka"))) == []


def test_trends_are_means_over_the_runs_of_one_task_method_and_ablation(tmp_path):
    folders = [
        finished(tmp_path / "1", WEIGHTS, seed=1),
        finished(tmp_path / "2", OTHERS, seed=2),
        finished(tmp_path / "3", OTHERS, ablation="fixed-alpha"),
    ]
    rows = trends(read_finished(folder) for folder in folders)
    # (1.8 + 1.2) / 2, and sqrt(2 x 0.3^2) of it
    assert rows[0] == {
        "task": "Quadcopter", "method": "porse", "ablation": "none", "variant": "", "iteration": 1, "varied": "beta", "runs": 2,
        "mean": pytest.approx(1.5), "std": pytest.approx(0.424264, abs=1e-6),
    }  # fmt: skip
    assert trends_table(rows).splitlines() == [
        "| task | method | ablation | runs | 1: beta | 2: alpha | 3: beta | 4: alpha | 5: beta |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        "| Quadcopter | porse | none | 2 | 1.500 +- 0.424 | 0.400 +- 0.283 | 1.200 +- 0.283 | 0.700 +- 0.283 "
        "| 0.800 +- 0.141 |",
        "| Quadcopter | porse | fixed-alpha | 1 | 1.200 |  | 1.000 |  | 0.900 |",
    ]


def test_the_winners_fitness_goes_on_from_iteration_to_iteration(tmp_path):
    run = read_finished(finished(tmp_path, WEIGHTS[:2], fitness=[[1.0, 3.0], [2.0, 5.0, 4.0]]))
    assert winners_fitness(run) == [(1, 1.0), (2, 3.0), (3, 2.0), (4, 5.0), (5, 4.0)]


def test_the_command_prints_the_trends_of_the_folders_that_it_is_given(tmp_path, monkeypatch):
    one, other = finished(tmp_path / "1", WEIGHTS), finished(tmp_path / "2", OTHERS)
    said = CliRunner().invoke(main, ["trends", str(one), str(other)], catch_exceptions=False).output
    assert "| Quadcopter | porse | none | 2 | 1.500 +- 0.424 |" in said
    monkeypatch.chdir(one)
    alone = json.loads(CliRunner().invoke(main, ["trends", "--json"], catch_exceptions=False).output)
    assert [(row["iteration"], row["mean"], row["std"]) for row in alone[:2]] == [(1, 1.8, None), (2, 0.2, None)]


def test_a_folder_without_results_is_named(tmp_path):
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(tiny.committed_params()))
    with pytest.raises(TableError, match=r"expected the table iterations at .*; run `porse repro` to make it"):
        read_finished(tmp_path)


@pytest.fixture
def sweep(tmp_path, monkeypatch):
    """A project whose suite has two variants, of which one entry is finished."""
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(tiny.committed_params()))
    (tmp_path / "dvc.yaml").write_text("stages: {a: {cmd: x, deps: [code]}}")
    with_presets(tmp_path)
    (tmp_path / "sweep.yaml").write_text(
        "{name: sweep, tasks: [Quadcopter], methods: [porse], seeds: [4], "
        "variants: {low: {candidate: {beta: 0.5}}, high: {candidate: {beta: 1.5}}}}"
    )
    tiny.run(tmp_path, "git", "init", "-q")
    tiny.run(tmp_path, "git", "add", "-A")
    monkeypatch.chdir(tmp_path)
    folders = folders_of("sweep", tmp_path)
    code = code_id(tmp_path, tracked_files(tmp_path))
    _, high = resolve(load_suite(tmp_path / "sweep.yaml"), tmp_path, code, "sweep.yaml")
    folder = finished(
        folders.result(high.entry.name), WEIGHTS[:1], fitness=[[0.25, 0.5]], iterations=[{"n": 1, "next": "result"}]
    )
    write_json(folder / "metrics.json", {})
    # Weights are read from iterations and curves alone.
    monkeypatch.setattr("porse.suite.status.read_figures", lambda _: {})
    write_json(folder / "done.json", high.ids)
    return tmp_path


def test_a_suites_curves_are_those_of_its_finished_entries(sweep):
    said = CliRunner().invoke(main, ["suite", "curves", "sweep.yaml"], catch_exceptions=False).output
    assert list(csv.reader(io.StringIO(said))) == [
        ["task", "method", "ablation", "variant", "seed", "epoch", "fitness"],
        ["Quadcopter", "porse", "none", "high", "4", "1", "0.25"],
        ["Quadcopter", "porse", "none", "high", "4", "2", "0.5"],
    ]


def test_a_suites_curves_are_printed_as_json(sweep):
    said = CliRunner().invoke(main, ["suite", "curves", "sweep.yaml", "--json"], catch_exceptions=False).output
    entry = {"task": "Quadcopter", "method": "porse", "ablation": "none", "variant": "high", "seed": 4}
    assert json.loads(said) == [{**entry, "epoch": 1, "fitness": 0.25}, {**entry, "epoch": 2, "fitness": 0.5}]


def test_suite_commands_work_below_the_project(sweep, monkeypatch):
    (sweep / "notes").mkdir()
    monkeypatch.chdir(sweep / "notes")
    said = CliRunner().invoke(main, ["suite", "trends", "../sweep.yaml"], catch_exceptions=False).output
    assert said.splitlines()[2:] == ["| Quadcopter | porse | none | high | 1 | 1.800 |"]


def test_a_suites_trends_are_those_of_its_finished_entries(sweep):
    said = CliRunner().invoke(main, ["suite", "trends", "sweep.yaml"], catch_exceptions=False).output
    assert said.splitlines()[2:] == ["| Quadcopter | porse | none | high | 1 | 1.800 |"]


def test_a_run_elsewhere_is_read_with_its_own_presets(tmp_path, monkeypatch):
    finished(tmp_path / "run", [(0.7, 0.4)])
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert read_finished(tmp_path / "run").params.train.num_envs > 0
