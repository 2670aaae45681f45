"""What is said of the default run holds for its tables, which DVC keeps and Git does not: `make proof` runs these when it has made them."""

import pytest

from porse import tables
from porse.report.markdown import results_table
from porse.report.results import Results, read_results
from tiny import ROOT

pytestmark = pytest.mark.skipif(
    not (ROOT / "results").is_dir(), reason="needs the tables of the default run: `porse repro` makes them"
)


@pytest.fixture(scope="module")
def results() -> Results:
    return read_results(ROOT)


def test_the_readmes_table_is_the_runs_own(results):
    assert results_table(results.iterations, results.figures) in (ROOT / "README.md").read_text()


def test_the_bonus_is_at_least_a_twentieth_of_the_total_in_every_first_rung(results):
    iterations = tables.read(ROOT / "results" / "iterations.parquet", tables.ITERATIONS)
    assert [row["iteration"] for row in iterations] == [1, 2, 3, 4, 5]
    assert min(row["bonus_share"] for row in iterations) >= 0.05
