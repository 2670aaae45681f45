"""docs/data.md is the data dictionary, and its examples run on the tables of a real run."""

import contextlib
import io
import re

import pytest

import kills
from at_once import run_at_once
from porse import tables
from porse.config import parse_params
from porse.generation.states import checker
from porse.report.data_page import PAGE, data_page

EXAMPLES = dict(re.findall(r"([^\n]+)\n\n```python\n(.*?)```", data_page(), re.DOTALL))


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A tiny run, which is an entry of a suite at once."""
    folder = tmp_path_factory.mktemp("data") / "run"
    with checker(parse_params(kills.tiny_params(), "a test")) as check:
        run_at_once(folder, kills.tiny_params(), check)
    entry = folder / ".porse" / "suites" / "one" / "results" / "entry"
    entry.mkdir(parents=True)
    (entry / "results").symlink_to(folder / "results")
    return folder


def read(folder, table):
    return tables.read(folder / "results" / f"{table.name}.parquet", table)


def ran(example, folder, monkeypatch):
    """Runs an example where a reader would, and returns the names that it leaves."""
    monkeypatch.chdir(folder)
    names: dict = {}
    with contextlib.redirect_stdout(io.StringIO()) as said:
        exec(compile(example, "docs/data.md", "exec"), names)
    assert said.getvalue().strip()
    return names


def test_the_page_is_current(root):
    assert (root / "docs" / PAGE).read_text() == data_page(), "run: python -m porse.report.data_page docs"


def test_every_column_is_on_the_page():
    for table in tables.TABLES.values():
        section = data_page().split(f"### {table.name}\n")[1].split("\n##")[0]
        assert re.findall(r"^\| `(\w+)` \| (\w+) \|", section, re.MULTILINE) == [
            (column.name, str(column.type)) for column in table.columns
        ]


@pytest.mark.parametrize("what", EXAMPLES)
def test_an_example_runs_and_prints_something(what, finished, monkeypatch):
    ran(EXAMPLES[what], finished, monkeypatch)


def example(begin):
    return next(code for what, code in EXAMPLES.items() if what.startswith(begin))


def test_the_examples_of_duckdb_say_what_the_tables_say(finished, monkeypatch):
    iteration = read(finished, tables.ITERATIONS)[0]
    candidates = {row["candidate_id"]: row for row in read(finished, tables.CANDIDATES)}
    winner = candidates[iteration["winner_id"]]
    names = ran(example("The winners"), finished, monkeypatch)
    assert names["winners"].fetchall() == [
        (1, winner["origin"], winner["beta"], winner["alpha"], iteration["score"], iteration["bonus_share"])
    ]
    ranked = ran(example("The candidates of each rung"), finished, monkeypatch)["rungs"].fetchall()
    assert [row[3] for row in ranked if row[1] == "1"] == [
        row["candidate_id"]
        for row in sorted(read(finished, tables.SCORES), key=lambda row: row["rank"])
        if row["rung"] == "1"
    ]
    reasons = ran(example("Why functions"), finished, monkeypatch)["reasons"].fetchall()
    assert sum(row[3] for row in reasons) == len(read(finished, tables.VERDICTS))
    assert ran(example("Several runs"), finished, monkeypatch)["best"].fetchall()[0][1] == iteration["mts"]


def test_the_examples_of_pandas_say_what_the_tables_say(finished, monkeypatch):
    curves = read(finished, tables.CURVES)
    fitness = ran(example("Fitness by epoch"), finished, monkeypatch)["fitness"]
    for row in curves:
        if row["series"] == "fitness":
            assert fitness.loc[row["epoch"], row["candidate_id"]] == row["value"]
    components = ran(example("Each component"), finished, monkeypatch)["components"]
    winner = read(finished, tables.ITERATIONS)[0]["winner_id"]
    of = {row["series"] for row in curves if row["candidate_id"] == winner and row["series"].startswith("component/")}
    assert {series for _, series in components.index} == of
    episodes = read(finished, tables.EPISODES)
    assert ran(example("The final success"), finished, monkeypatch)["success"]["count"] == len(episodes)
