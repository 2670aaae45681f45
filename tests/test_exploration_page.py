"""docs/exploration.md says what its CSV files say, and each of them is a suite's."""

import csv
import re
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
SUITES = sorted((ROOT / "suites" / "exploration").glob("*.yaml"))


def page_rows(suite: str) -> dict[str, list[str]]:
    section = (ROOT / "docs" / "exploration.md").read_text().split(f"### `{suite}`")[1].split("###")[0]
    rows = [line.strip("| ").split(" | ") for line in section.splitlines() if line.startswith("| `")]
    return {row[0].strip("`"): row for row in rows}


@pytest.mark.parametrize("path", SUITES, ids=lambda path: path.stem)
def test_a_table_of_the_page_has_each_finished_variant_with_five_seeds_and_its_numbers(path: Path) -> None:
    with (ROOT / "docs" / "exploration" / f"{path.stem}.csv").open() as file:
        measured = {(row["variant"], row["figure"]): row for row in csv.DictReader(file)}
    shown = page_rows(path.stem)
    finished = {variant for variant, _ in measured}
    assert list(shown) == [name for name in yaml.safe_load(path.read_text())["variants"] if name in finished]
    assert "none" in finished
    for variant, cells in shown.items():
        score = measured[variant, "score"]
        assert int(score["seeds"]) == 5
        numbers = [float(number) for cell in cells[1:3] for number in re.findall(r"[-+]?\d+\.\d+", cell)]
        names = ["mean", "deviation"] if variant == "none" else ["mean", "deviation", "difference", "low", "high"]
        assert numbers == pytest.approx([float(score[name]) for name in names], abs=0.0006)
