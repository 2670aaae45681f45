"""In whatever units a reward comes, and whatever the weights sum to, a training is the same but for rounding."""

import dataclasses

import numpy as np
import pytest

from meaning_cases import changed
from porse.checkpoint import read_checkpoint, write_checkpoint
from porse.training.candidate import train_candidate
from porse.training.job import Job
from porse.training.start import random_policy
from samples import MAPPING, REWARD, program

SUM = "return closeness + 0.2 * upright - 0.01 * tilt,"
EPOCHS = 6


@pytest.fixture(scope="module")
def trained(small, tmp_path_factory):
    """Returns the actor and critic of a short training, and its series."""
    folder = tmp_path_factory.mktemp("scale")
    small = changed(small, train={"num_envs": 16, "steps_per_epoch": 16})
    write_checkpoint(folder / "start", random_policy(small, 1))

    def train(times=1.0, weights=1.0, **sections):
        assert SUM in REWARD
        reward = REWARD.replace(SUM, f"return {times} * ({SUM[7:-1]}),")
        params = changed(small, **sections)
        candidate = dataclasses.replace(params.candidate, scale=weights * params.candidate.scale)
        params = dataclasses.replace(params, candidate=candidate)
        beta = weights * 0.75
        job = Job("one", program(reward), program(MAPPING), beta, folder / "start", folder / "end", EPOCHS, 7)
        outcome = train_candidate(job, params, lambda *_: None)
        assert not outcome.failure
        return read_checkpoint(folder / "end").policy(), outcome.rows

    return train


def furthest(one, other):
    """The largest difference of two policies' weights."""
    return max(float(np.abs(one[name] - other[name]).max()) for name in one if ".mlp." in name)


@pytest.mark.parametrize("form", ["relative", "literal", "calibrated"])
def test_a_reward_times_1000_gives_the_same_training_but_for_rounding(trained, form):
    plain, rows = trained(exploration={"form": form})
    times, other_rows = trained(1000.0, exploration={"form": form})
    assert furthest(plain, times) < 1e-4
    for (_, series, value), (_, _, other) in zip(rows, other_rows, strict=True):
        assert other == pytest.approx(1000.0 * value if series == "goal" else value, rel=1e-3, abs=1e-4)


def test_a_reward_times_a_power_of_two_and_weights_times_two_give_the_same_bits(trained):
    plain, _ = trained()
    for other, _ in (trained(1024.0), trained(weights=2.0)):
        assert all(np.array_equal(plain[name], other[name]) for name in plain)


def test_units_and_weights_matter_where_nothing_is_scaled(trained):
    plain, _ = trained(train={"scaling": "none"})
    for other, _ in (trained(1000.0, train={"scaling": "none"}), trained(weights=2.0, train={"scaling": "none"})):
        assert furthest(plain, other) > 0.01


def test_the_share_of_the_bonus_follows_beta_and_lambda(trained):
    def share(**sections):
        return next(value for epoch, series, value in trained(**sections)[1] if (epoch, series) == (1, "bonus_share"))

    usual = share(exploration={"lambda_": 1.0})
    assert 0.02 < usual < 1.0
    assert share(exploration={"lambda_": 0.0}) == 0.0
    assert share(exploration={"lambda_": 0.1}) < 0.3 * usual
