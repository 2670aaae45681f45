"""Random play moves as the originals' did, seen from outside; and the committed table is what its command writes."""

import csv
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch

from porse.gymnasium_front import register_tasks
from porse.report.calibration import (
    PUBLISHED,
    Episodes,
    Published,
    _row,
    calibration_rows,
    first_episodes,
    random_actions,
    zero_actions,
)
from porse.tasks import TASKS, make_task

TABLE = Path(__file__).parent.parent / "docs" / "calibration.csv"
STILL_OPEN = {"DoorCloseInward random_return", "GraspAndPlace random_return"}
"""Quantities of the table that do not hold, "task quantity"; `docs/decisions.md` says what is known of them."""


def table():
    with TABLE.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def first_end(name, steps):
    """Returns the step of the first termination among 64 environments of clipped N(0, 0.8) actions, or None."""
    register_tasks()
    env = gymnasium.make_vec(f"porse/{name}-v0", num_envs=64)
    try:
        env.reset(seed=0)
        generator = np.random.default_rng(5)
        for step in range(1, steps + 1):
            actions = (0.8 * generator.standard_normal(env.action_space.shape)).clip(-1, 1).astype(np.float32)
            if env.step(actions)[2].any():
                return step
        return None
    finally:
        env.close()


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("CatchOver2Underarm", 10, 60),
        ("CatchAbreast", 10, 52),
        ("DoorCloseOutward", 8, 46),
    ],
)
def test_random_play_ends_about_when_the_originals_did(name, low, high):
    found = first_end(name, high)
    assert found is not None
    assert found >= low


@pytest.mark.parametrize(
    ("name", "steps"),
    [
        ("DoorOpenInward", 100),
        ("DoorOpenOutward", 100),
        ("DoorCloseInward", 100),
        ("CatchUnderarm", 14),
        ("Over", 9),
        ("TwoCatchUnderarm", 13),
    ],
)
def test_random_play_ends_no_episode_sooner_than_the_originals_could(name, steps):
    """A hundred steps at the doors; elsewhere half of the shortest episode that is published."""
    assert first_end(name, steps) is None


def test_the_table_names_every_task_and_what_is_published():
    rows = table()
    quantities = ["random_return", "random_shortest", "zero_return", "zero_shortest"]
    found = [(row["task"], row["quantity"].partition("_within")[0]) for row in rows]
    assert found == [(name, quantity) for name in TASKS for quantity in quantities]
    calibrated = {row["task"] for row in rows if row["published"]}
    assert calibrated == set(PUBLISHED)


def test_what_is_published_holds_but_for_what_is_named_here():
    wrong = {f"{row['task']} {row['quantity']}" for row in table() if row["holds"] == "no"}
    assert wrong == STILL_OPEN


@pytest.mark.parametrize("name", ["CatchOver2Underarm", "CatchAbreast"])
def test_the_table_is_current(name):
    written = [{key: str(value) for key, value in row.items()} for row in calibration_rows(name)]
    assert [row for row in table() if row["task"] == name] == [{key: row[key] for key in row} for row in written]


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(TASKS))
def test_the_whole_table_is_current(name):
    written = [{key: str(value) for key, value in row.items()} for row in calibration_rows(name)]
    assert [row for row in table() if row["task"] == name] == written


def test_random_actions_are_normal_and_clipped():
    """Standard deviation 0.8 before the clip: a share of 0.106 on either bound, a spread of 0.66 after it."""
    task = make_task("Over", 500, seed=0)
    actions = next(random_actions(task))
    assert float((actions == 1.0).float().mean()) == pytest.approx(0.106, abs=0.01)
    assert float((actions == -1.0).float().mean()) == pytest.approx(0.106, abs=0.01)
    assert float(actions.std()) == pytest.approx(0.66, abs=0.02)
    assert not next(zero_actions(task)).any()


def test_first_episodes_are_played_once_and_to_their_ends():
    """Quadcopters that never push fall: each falls once, and a return is the sum of its own rewards."""
    task, again = make_task("Quadcopter", 5, seed=3), make_task("Quadcopter", 5, seed=3)
    found = first_episodes(task, zero_actions(task))
    expected = torch.zeros(5)
    for step in range(1, 500):
        again.step(torch.zeros(5, 12))
        expected += torch.where(found.lengths >= step, again.human_reward(), 0.0)
        ended = again.terminated() | again.timed_out()
        assert torch.equal(ended & (found.lengths >= step), found.lengths == step)
    assert torch.allclose(found.returns, expected)


def test_a_return_can_be_of_the_short_episodes_alone():
    found = Episodes(torch.tensor([1.0, 4.0, 10.0]), torch.tensor([20, 30, 50]))
    assert found.mean_return() == 5.0
    assert found.mean_return(within=30) == 2.5
    assert found.shortest() == 20


def test_a_row_holds_within_its_factor_and_an_unpublished_one_is_left_open():
    assert Published() == Published(None, None, None)
    inside = _row("Over", "random_return", (1.2, 2.5), 3.7, 1.5)
    outside = _row("Over", "random_return", (1.2, 2.5), 3.76, 1.5)
    assert (inside["low"], inside["high"], inside["holds"], outside["holds"]) == ("0.8", "3.75", "yes", "no")
    assert inside["published"] == "1.2-2.5"
    assert _row("Over", "zero_return", None, 3.0, 1.5)["holds"] == ""
