"""What the table of learning says, with numbers worked out by hand; and the committed one is of the suite's runs."""

import csv
import re
from collections import Counter
from pathlib import Path

import pytest
import torch
import yaml
from click.testing import CliRunner

from meaning_cases import row_of
from porse import tables
from porse.report.calibration import random_actions, zero_actions
from porse.report.learning import (
    COLUMNS,
    CURVE_COLUMNS,
    Learned,
    Trivial,
    learned,
    learning_curve,
    learning_row,
    main,
    published_return,
    trivial,
)
from porse.task_names import TASK_CLASSES, TASK_TAGS
from tiny import committed_params

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "docs" / "learning.csv"


def written(folder: Path, task: str, seed: int, fitness: list[float], steps: int, final: float) -> Path:
    """A finished run whose goal reward is 0.5 a step and whose episodes last 30 steps, but for the first of them."""
    folder.mkdir(parents=True)
    document = {**committed_params(), "task": task, "seed": seed}
    (folder / "params.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
    # The highest fitness of an epoch is that of the iteration; of two episodes one is worth twice what both are in the mean.
    iteration = row_of(tables.ITERATIONS, iteration=1, winner_id="x", mts=max(fitness), environment_steps=steps)
    tables.write(folder / "results" / "iterations.parquet", tables.ITERATIONS, [iteration])
    episodes = [row_of(tables.EPISODES, episode=n, candidate_id="x", outcome=2 * n * final) for n in (0, 1)]
    tables.write(folder / "results" / "episodes.parquet", tables.EPISODES, episodes)
    series = {"fitness": fitness, "goal": [9.0, *[0.5] * 11], "episode_length": [7.0, *[30.0] * 11]}
    rows = [
        {"iteration": 1, "rung": "1", "candidate_id": "x", "series": name, "epoch": epoch, "value": value}
        for name, values in series.items()
        for epoch, value in enumerate(values, 1)
    ]
    tables.write(folder / "results" / "curves.parquet", tables.CURVES, rows)
    (folder / "done.json").write_text("{}")
    return folder


def test_a_run_is_its_first_and_last_ten_epochs_and_the_return_of_the_last(tmp_path: Path) -> None:
    # 1 to 12: the first ten have mean 5.5, the last ten 7.5; 0.5 a step for 30 steps is 15.
    run = learned(written(tmp_path / "a", "Over", 1, [float(n) for n in range(1, 13)], 480, 0.75))
    assert run == Learned("Over", 480, 5.5, 7.5, 12.0, 0.75, 15.0)


def test_a_curve_has_the_mean_of_each_stretch_at_the_steps_of_its_end(tmp_path: Path) -> None:
    # 75 epochs in 30 stretches: two epochs and three by turns, and the first has 1 and 2.
    fitness = [float(n) for n in range(1, 76)]
    result = written(tmp_path / "a", "Over", 3, fitness, 7500, 0.0)
    curves = tables.read(result / "results" / "curves.parquet", tables.CURVES)
    # In the third epoch no episode ends, and in the last stretch none does.
    lengths = {1: 7.0, 2: 3.0, **dict.fromkeys(range(4, 73), 30.0)}
    rows = [row for row in curves if row["series"] == "fitness"] + [
        {"iteration": 1, "rung": "1", "candidate_id": "x", "series": name, "epoch": epoch, "value": value}
        for name, values in (
            ("goal", {**dict.fromkeys(range(1, 76), 0.5), 1: 9.0, 2: 1.0}),
            ("episode_length", lengths),
        )
        for epoch, value in values.items()
    ]
    tables.write(result / "results" / "curves.parquet", tables.CURVES, rows)
    points = learning_curve(result, 7500)
    assert len(points) == 30
    # Five a step for five steps.
    assert points[0] == {"task": "Over", "seed": 3, "steps": 200, "fitness": "1.5", "return": "25"}
    assert points[1] == {"task": "Over", "seed": 3, "steps": 500, "fitness": "4", "return": "15"}
    assert points[-1] == {"task": "Over", "seed": 3, "steps": 7500, "fitness": "74", "return": ""}


def nothing(fitness: float, returned: float = 0.0, deviation: float = 0.0) -> Trivial:
    return Trivial(fitness, returned, deviation)


def run_of(task: str, end: float, returned: float = 0.0, steps: int = 480) -> Learned:
    return Learned(task, steps, 0.01, end, end + 0.02, end + 0.03, returned)


@pytest.mark.parametrize(
    ("task", "end", "zero", "random", "holds"),
    [
        # A tenth of the way from 0.2 to 1 is 0.28.
        ("Over", 0.29, 0.2, 0.1, "yes"),
        ("Over", 0.27, 0.2, 0.1, "no"),
        ("Over", 0.27, 0.1, 0.2, "no"),
        # From -2 to 0: -1.8.
        ("Anymal", -1.79, -2.5, -2.0, "yes"),
        ("Anymal", -1.81, -2.5, -2.0, "no"),
        # From 0.235 to 7.235: 0.935.
        ("Humanoid", 0.94, 0.0, 0.235, "yes"),
        ("Humanoid", 0.93, 0.235, 0.0, "no"),
    ],
)
def test_a_task_learns_that_ends_a_tenth_of_the_way_above_the_better_policy_that_knows_nothing(
    task: str, end: float, zero: float, random: float, holds: str
) -> None:
    assert learning_row([run_of(task, end)], nothing(zero), nothing(random))["holds"] == holds


@pytest.mark.parametrize(
    ("returned", "zero", "random", "improves"),
    [
        # Zero action is the better one: 3 + 2 * 0.5 = 4. The wide spread of random actions is not asked.
        (4.01, (3.0, 0.5), (2.0, 9.0), "yes"),
        (3.99, (3.0, 0.5), (2.0, 9.0), "no"),
        # Costs: -20 + 2 * 7 = -6.
        (-5.9, (-30.0, 1.0), (-20.0, 7.0), "yes"),
        (-6.1, (-30.0, 1.0), (-20.0, 7.0), "no"),
    ],
)
def test_a_return_improves_that_is_two_deviations_above_the_better_policy_that_knows_nothing(
    returned: float, zero: tuple[float, float], random: tuple[float, float], improves: str
) -> None:
    row = learning_row([run_of("Switch", 0.0, returned)], Trivial(0.0, *zero), Trivial(0.0, *random))
    assert row["improves"] == improves
    assert (float(row["zero_return"]), float(row["random_return"])) == (zero[0], random[0])


def test_a_row_is_the_mean_over_the_seeds_with_the_lowest_end() -> None:
    row = learning_row(
        [run_of("Scissors", 0.5, 4.0), run_of("Scissors", 0.2, 7.0)], nothing(0.125, 3.0, 0.5), nothing(0.25, -2.0, 4.0)
    )
    assert row == {
        "task": "Scissors", "seeds": 2, "steps": 480, "start": "0.01", "zero_action": "0.125", "random": "0.25",
        "end": "0.35", "paper": "0.996", "holds": "yes", "lowest": "0.2", "mts": "0.37", "final": "0.38",
        "return": "5.5", "published_return": "", "published_std": "", "return_holds": "",
        "zero_return": "3", "random_return": "-2", "improves": "yes",
    }  # fmt: skip


def test_a_return_is_compared_on_a_straight_line_between_two_published_points() -> None:
    # Over: 1.115 after 117 965 steps, 6.27 after 4 476 110; a quarter of the way is 2.40375.
    quarter = 117_965 + (4_476_110 - 117_965) // 4
    found = published_return("Over", quarter)
    assert found is not None
    assert found[0] == pytest.approx(1.115 + (6.27 - 1.115) / 4, abs=1e-5)
    assert learning_row([run_of("Over", 0.5, 2.41, quarter)], nothing(0.0), nothing(0.0))["return_holds"] == "yes"
    assert learning_row([run_of("Over", 0.5, 2.40, quarter)], nothing(0.0), nothing(0.0))["return_holds"] == "no"
    assert published_return("Over", 1_000) is None
    assert published_return("Scissors", quarter) is None


def test_what_a_policy_that_knows_nothing_is_worth_is_the_mean_over_whole_episodes() -> None:
    torch.set_num_threads(1)
    # Without thrust the quadcopter falls: far from its target, and random thrust is no better by much.
    still, random = trivial("Quadcopter", zero_actions), trivial("Quadcopter", random_actions)
    assert still.fitness < -0.9
    assert still.fitness != random.fitness
    # Its reward is positive, and at most 1 / (1 + distance^2), thrice, in each of 500 steps.
    assert 0.0 < still.returned < 500.0
    assert still.deviation != random.deviation


def test_the_command_writes_a_row_for_each_task_with_finished_runs(tmp_path: Path) -> None:
    results = tmp_path / "results"
    for seed, end in ((1, -0.5), (2, -0.3)):
        written(results / f"q{seed}", "Quadcopter", seed, [-1.5] * 2 + [end] * 10, 4096, end)
    (written(results / "unfinished", "Anymal", 1, [0.0] * 12, 1, 0.0) / "done.json").unlink()
    done = CliRunner().invoke(main, [str(results), str(tmp_path)], catch_exceptions=False)
    assert done.exit_code == 0
    rows = list(csv.DictReader((tmp_path / "learning.csv").read_text().splitlines()))
    assert [tuple(row) for row in rows] == [COLUMNS]
    assert [rows[0][name] for name in ("task", "seeds", "steps", "end", "lowest", "final", "paper", "holds")] == [
        "Quadcopter", "2", "4096", "-0.4", "-0.5", "-0.4", "-0.067", "yes",
    ]  # fmt: skip
    points = list(csv.DictReader((tmp_path / "learning-curves.csv").read_text().splitlines()))
    assert len(points) == 2 * 12
    assert tuple(points[0]) == CURVE_COLUMNS
    assert [(point["task"], point["seed"]) for point in points[11:13]] == [("Quadcopter", "1"), ("Quadcopter", "2")]


def test_tasks_without_a_run_keep_their_rows_in_the_order_of_tasks(tmp_path: Path) -> None:
    for folder, task, ends in (("a", "Over", (0.5,)), ("b", "Quadcopter", (-0.5, -0.3)), ("c", "Over", (0.25,))):
        for seed, end in enumerate(ends, 1):
            written(tmp_path / folder / f"{task}-{seed}", task, seed, [0.0] * 2 + [end] * 10, 4096, end)
        done = CliRunner().invoke(main, [str(tmp_path / folder), str(tmp_path)], catch_exceptions=False)
        assert done.exit_code == 0
    rows = list(csv.DictReader((tmp_path / "learning.csv").read_text().splitlines()))
    assert [(row["task"], row["seeds"], row["end"]) for row in rows] == [
        ("Quadcopter", "2", "-0.4"),
        ("Over", "1", "0.25"),
    ]
    points = list(csv.DictReader((tmp_path / "learning-curves.csv").read_text().splitlines()))
    assert [point["task"] for point in points] == ["Quadcopter"] * 24 + ["Over"] * 12
    assert points[-1]["fitness"] == "0.25"


def test_the_suite_has_every_task_and_the_table_no_other_runs() -> None:
    suite = yaml.safe_load((ROOT / "suites" / "learning.yaml").read_text())
    seeds = Counter({task: len(suite["seeds"]) for task in suite["tasks"]})
    seeds.update(entry["task"] for entry in suite["entries"])
    assert {*seeds} == {*TASK_CLASSES}
    assert sorted(seeds.values()) == [*[1] * 19, *[3] * 6]
    with TABLE.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert all(0 < int(row["seeds"]) <= seeds[row["task"]] for row in rows)


def test_the_page_counts_what_the_table_says() -> None:
    with TABLE.open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["task"] != "SwitchReachable"]
    page = (ROOT / "docs" / "learning.md").read_text(encoding="utf-8")
    assert f"{sum(row['holds'] == 'yes' for row in rows)} of the {len(rows)} tasks learn " in page
    named = re.search(r"(\d+) of them have its MTS or a higher one: ([\w,\s]+)\.", page)
    assert named
    learned_as_well = [
        row["task"] for row in rows if row["holds"] == "yes" and float(row["mts"]) >= float(row["paper"])
    ]
    assert sorted(re.split(r",\s+", named[2])) == sorted(learned_as_well)
    assert int(named[1]) == len(learned_as_well)
    assert f"in {sum(row['improves'] == 'yes' for row in rows)} of the {len(rows)} tasks the return improves" in page
    published = [row for row in rows if row["published_return"]]
    assert [row["return_holds"] for row in published] == ["yes"] * 9
    factors = [float(row["return"]) / float(row["published_return"]) for row in published]
    assert f"by a factor of {min(factors):.1f} to\n{max(factors):.0f}." in page
    # Each that does not learn has its reason.
    reasons = re.findall(r"^- \*\*(\w+)\*\*", page.partition("## What does not learn")[2], re.MULTILINE)
    assert sorted(reasons) == sorted(row["task"] for row in rows if row["holds"] == "no")


def test_easy_is_what_learns_and_hard_what_does_not() -> None:
    with TABLE.open(encoding="utf-8", newline="") as file:
        rows = {row["task"]: row["holds"] for row in csv.DictReader(file)}
    for task, holds in rows.items():
        assert ("easy" in TASK_TAGS[task]) == (holds == "yes"), task
        assert ("hard" in TASK_TAGS[task]) == (holds == "no"), task
