"""Variants of a suite against one of them: paired differences by hand, and their intervals."""

import csv
import json

import pytest
import yaml
from click.testing import CliRunner

from meaning_cases import row_of
from porse import tables
from porse.cli import main
from porse.errors import PorseError
from porse.report.figures import spread
from porse.suite.compare import Figure, mean_interval, paired
from porse.suite.folders import folders_of, read_json, write_json
from tiny import committed_params

SUITE = """
name: sizes
tasks: [Quadcopter]
methods: [porse]
variants: {none: {}, some: {exploration: {lambda: 0.5}}}
seeds: [3, 4, 8]
"""
SCORES = {"none-3": 0.25, "none-4": 0.5, "some-3": 0.75, "some-4": 0.75, "some-8": 0.875}
"""Seed 8 of the baseline is not done."""


WINNER, LOSER = "b2", "c3"


@pytest.fixture
def sizes(tmp_path, root, monkeypatch):
    monkeypatch.setattr("porse.suite.compare.read_figures", lambda folder: read_json(folder / "figures.json"))
    (tmp_path / "sizes.yaml").write_text(SUITE)
    (tmp_path / "presets").symlink_to(root / "presets")
    for name, score in SCORES.items():
        result = folders_of("sizes", tmp_path).result(f"Quadcopter-porse-{name}")
        write_json(result / "figures.json", {"score": score, "success": 2.0 * score, "valid_share": None})
        write_json(result / "done.json", {})
        (result / "params.yaml").write_text(yaml.safe_dump(committed_params()))
        write_tables(result / "results", score)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write_tables(folder, score):
    """Two iterations won by one candidate, as an elite may; in the second beside another one that was trained as long.

    In the second iteration the winner was trained for twelve epochs, of which the last ten count: 3, 4, ..., 12. In the first it
    got further, in more epochs; so did the other one.
    """
    trained = [(1, 0, WINNER, 14, 100.0), (2, 0, WINNER, 12, 1.0), (2, 1, LOSER, 12, -30.0)]
    winners = [{"iteration": n, "winner_id": WINNER} for n in (1, 2)]
    candidates = [
        {"iteration": n, "slot": slot, "candidate_id": name, "epochs": epochs} for n, slot, name, epochs, _ in trained
    ]
    curves = [
        {
            "iteration": n,
            "rung": "1",
            "candidate_id": name,
            "series": series,
            "epoch": epoch,
            "value": factor * epoch * score,
        }
        for n, _, name, epochs, factor in trained
        for series in ("progress/way", *(["progress/other"] if name == LOSER else []))
        for epoch in range(1, epochs + 1)
    ]
    folder.mkdir()
    for table, rows in (
        (tables.ITERATIONS, winners), (tables.CANDIDATES, candidates), (tables.CURVES, curves), (tables.EVALUATION, []),
        (tables.SEEDS, []), (tables.EPISODES, []),
    ):  # fmt: skip
        tables.write(folder / f"{table.name}.parquet", table, [row_of(table, **row) for row in rows])


def compare(*arguments: str):
    return CliRunner().invoke(main, ["suite", "compare", "sizes.yaml", *arguments])


def test_a_variant_is_compared_with_the_baseline_seed_by_seed(sizes):
    done = compare("--baseline", "none", "--csv", "out.csv", "--figure", "score", "--figure", "progress/way")
    assert done.exit_code == 0, done.output
    rows = list(csv.DictReader((sizes / "out.csv").read_text().splitlines()))
    score = next(row for row in rows if (row["variant"], row["figure"]) == ("some", "score"))
    # Seeds 3 and 4: 0.75 - 0.25 and 0.75 - 0.5, mean 0.375. The mean of the variant is over its three seeds: 2.375 / 3.
    assert (score["seeds"], score["mean"], score["difference"]) == ("3", "0.7917", "0.375")
    assert 0.25 <= float(score["low"]) < 0.375 < float(score["high"]) <= 0.5
    way = next(row for row in rows if (row["variant"], row["figure"]) == ("none", "progress/way"))
    # The mean of 3 ... 12 is 7.5: (7.5 x 0.25 + 7.5 x 0.5) / 2; the baseline differs from itself by nothing.
    assert (way["mean"], way["difference"], way["low"], way["high"]) == ("2.812", "0", "0", "0")
    assert "Quadcopter  porse   none      some     score" in done.output


def test_a_comparison_is_printed_as_json(sizes):
    rows = json.loads(compare("--baseline", "none", "--json").output)
    score = next(row for row in rows if row["variant"] == "some")
    # As above, (0.5 + 0.25) / 2, in full.
    assert (score["figure"], score["seeds"], score["difference"]) == ("score", 3, 0.375)


def test_an_unknown_baseline_or_figure_is_named(sizes):
    expected = "Error: expected a variant of the suite sizes that the others are compared with, found"
    for words, found in ((("--baseline", "non"), "'non'"), ((), "no --baseline")):
        done = compare(*words)
        assert (done.exit_code, done.output) == (1, f"{expected} {found}; its variants are 'none', 'some'\n")
    # The series of another candidate is none of the winner's.
    with pytest.raises(
        PorseError, match=r"expected scores to be .* its figures are score, success, its series progress/way$"
    ):
        Figure("scores").of(folders_of("sizes", sizes).result("Quadcopter-porse-some-8"))


def test_a_suite_without_variants_says_what_to_add(sizes):
    (sizes / "sizes.yaml").write_text(SUITE.replace("variants:", "# variants:"))
    done = compare("--baseline", "porse")
    assert done.exit_code == 1
    assert (
        "expected variants in the suite sizes, found none; add `variants`, a name with its parameters for each"
        in done.output
    )


def test_the_interval_of_paired_differences_covers_their_mean_and_is_the_same_every_time():
    found = paired([0.1, 0.4, 0.2, 0.25, 0.3])
    assert found["difference"] == pytest.approx(0.25)
    assert 0.1 < found["low"] < 0.25 < found["high"] < 0.4
    assert found == paired([0.1, 0.4, 0.2, 0.25, 0.3])


def test_the_interval_corrects_for_bias_and_skew():
    """BCa by hand, of the 27 resamples of 1, 2 and 9.

    The least mean, 1, has 1 of them, 3.7 %, and the next, (1 + 1 + 2) / 3, has 3 more: percentiles of 2.5 and 97.5 % are 1 and 9.
    Below the mean, 4, are 11 and at it 6: bias z = Phi^-1(14 / 27) = 0.046. The means without one value are 1.5 and 1 above it and
    2.5 below it: acceleration a = (2.5^3 - 1.5^3 - 1^3) / (6 (2.5^2 + 1.5^2 + 1^2)^1.5) = 0.064. So the lower level is
    Phi(z + (z - 1.96) / (1 - a (z - 1.96))) = Phi(-1.66) = 4.9 %, which is the next mean; the upper one is 99 %.
    """
    assert mean_interval([1.0, 9.0, 2.0]) == (4.0, pytest.approx(4 / 3), 9.0)


def test_few_pairs_have_no_interval_and_equal_ones_one_point():
    assert paired([]) == {"difference": None, "low": None, "high": None}
    assert paired([0.5]) == {"difference": 0.5, "low": None, "high": None}
    assert paired([0.5, 0.5]) == {"difference": 0.5, "low": 0.5, "high": 0.5}
    # The squares of -0.5, -0.25 and 0.75 about 1.25 are 0.875, of which n - 1 is 2.
    assert spread("score", [0.75, 1.0, 2.0]) == {"score_mean": 1.25, "score_std": pytest.approx(0.4375**0.5)}


def test_a_figure_that_is_undefined_is_none(sizes):
    result = folders_of("sizes", sizes).result("Quadcopter-porse-some-8")
    assert Figure("success").of(result) == 1.75
    with pytest.raises(PorseError, match="expected valid_share to be a figure or a series"):
        Figure("valid_share").of(result)
