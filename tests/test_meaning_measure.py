"""What fitness is measured over: staggered episodes, whole ones, and one fixed policy that scores alike in every epoch."""

import dataclasses
import math
import statistics

import pytest
import torch

from meaning_cases import changed
from porse.checkpoint import write_checkpoint
from porse.tasks import TASKS, make_task
from porse.tasks.base import Task
from porse.tasks.success import SuccessTask
from porse.training.actor import policy_actor
from porse.training.candidate import train_candidate
from porse.training.episodes import play_episodes
from porse.training.fitness import EpochFitness
from porse.training.job import Job
from porse.training.start import random_policy

OVER_STEPS = {"Quadcopter", "Anymal", "Humanoid"}
"""Tasks whose fitness is of the present state; all others are solved or not, and count episodes."""


def test_an_epochs_fitness_is_over_steps_or_over_episodes_as_the_task_says():
    assert {name for name, task in TASKS.items() if not task.OVER_EPISODES} == OVER_STEPS
    assert all(issubclass(task, SuccessTask) == task.OVER_EPISODES for task in TASKS.values())
    # a class of one's own that says nothing has a fitness of the present state
    assert not Task.OVER_EPISODES


# Head starts.


def test_head_starts_are_one_in_each_stretch_of_an_episode_and_uniform_together():
    task = make_task("Over", 5, 0)
    assert task.TIME_LIMIT == 75
    seen = []
    for seed in range(400):
        task.stagger(seed)
        # 75 / 5: one in 0..14, one in 15..29, one in 30..44, ...
        assert sorted((task.head_start // 15).tolist()) == [0, 1, 2, 3, 4]
        seen.append(task.head_start.tolist())
    # Stretches and the places in them are drawn: every environment meets every stretch, and both ends are met.
    assert all({row[place] // 15 for row in seen} == {0, 1, 2, 3, 4} for place in range(5))
    assert (min(map(min, seen)), max(map(max, seen))) == (0, 74)
    # uniform on 0..74: mean 37, and 2 000 of deviation 21.65 have a mean within 4 x 21.65 / sqrt(2000) = 1.94 of it
    assert abs(statistics.mean(age for row in seen for age in row) - 37.0) < 1.94


def test_more_environments_than_steps_share_the_phases_evenly():
    task = make_task("Quadcopter", 998, 0)
    task.stagger(3)
    # 998 environments, 499 phases: stretches 2 k and 2 k + 1 are phase k
    assert torch.bincount(task.head_start, minlength=499).tolist() == [2] * 499


def test_head_starts_come_from_their_seed_alone_and_change_nothing_else():
    task, twin = make_task("Quadcopter", 7, 4), make_task("Quadcopter", 7, 4)
    before = task.state()
    task.stagger(5)
    assert {name for name, value in task.state().items() if not torch.equal(value, before[name])} == {"head_start"}
    # what a generated function reads is how long an episode really is
    assert task.variables()["progress_buf"].tolist() == [0] * 7
    twin.stagger(6)
    assert task.head_start.tolist() != twin.head_start.tolist()
    twin.stagger(5)
    assert task.head_start.tolist() == twin.head_start.tolist()


def after_steps(task, steps, fails):
    """Steps a task with three environments, the second of which fails in step `fails`; returns who timed out in each."""
    ended = []
    for step in range(1, steps + 1):
        task.step(torch.zeros(3, task.NUM_ACTIONS))
        task._diverged = torch.tensor([False, step == fails, False])
        ended.append(task.timed_out().tolist())
        task.renew(task.timed_out() | task._diverged)
    return ended


def test_a_head_start_brings_the_time_limit_nearer_and_the_next_episode_is_whole():
    task = make_task("Quadcopter", 3, 0)
    task.head_start = torch.tensor([0, 496, 498])
    # 499 is the limit: after 3 steps of the second, 1 of the third
    assert after_steps(task, 3, fails=0) == [[False, False, True], [False, False, False], [False, True, False]]
    assert task.progress.tolist() == [3, 0, 2]
    assert task.head_start.tolist() == [0, 0, 0]


def test_what_follows_a_failure_has_the_time_that_was_left_where_fitness_is_of_the_present_state():
    task = make_task("Quadcopter", 3, 0)
    task.head_start = torch.tensor([0, 490, 0])
    # the second fails after 4 steps, at 494, and 5 steps are left
    assert after_steps(task, 9, fails=4) == [[False] * 3] * 8 + [[False, True, False]]
    # and whole again after the time limit
    assert (task.progress.tolist(), task.head_start.tolist()) == ([9, 0, 9], [0, 0, 0])


def test_what_follows_a_failure_is_a_whole_episode_where_episodes_count():
    task = make_task("Over", 3, 0)
    task.head_start = torch.tensor([0, 60, 0])
    after_steps(task, 4, fails=4)
    assert (task.progress.tolist(), task.head_start.tolist()) == ([4, 0, 4], [0, 0, 0])


def test_a_failure_at_the_time_limit_is_followed_by_a_whole_episode():
    task = make_task("Quadcopter", 3, 0)
    task.head_start = torch.tensor([0, 495, 0])
    after_steps(task, 4, fails=4)
    assert (task.progress.tolist(), task.head_start.tolist()) == ([4, 0, 4], [0, 0, 0])


def test_outside_a_training_a_reset_begins_a_whole_episode():
    task = make_task("Quadcopter", 3, 0)
    assert task.head_start.tolist() == [0, 0, 0]
    task.head_start = torch.tensor([1, 200, 3])
    task.reset(torch.tensor([False, True, False]))
    assert task.head_start.tolist() == [1, 0, 3]


def test_a_split_training_keeps_the_phases():
    task, other = make_task("Over", 4, 0), make_task("Over", 4, 9)
    task.stagger(1)
    other.load_state(task.state())
    assert other.head_start.tolist() == task.head_start.tolist()
    assert len(set(other.head_start.tolist())) == 4


# Outcomes of episodes.


@pytest.mark.parametrize(("name", "after"), [("CatchUnderarm", [1 / 4, 1 / 4]), ("Over", [1 / 4, 3 / 16])])
def test_an_episode_that_is_cut_short_has_no_outcome_solved_or_not(monkeypatch, name, after):
    """Four environments; the first two have a head start and end: one solved, one not. Then two whole ones end.

    Where an environment counts as its own last outcome: 1 of 4 after the third's success, and as much after the fourth's
    failure. As the mean of all: (1 + 0 + 0 + 0) / 4, then three times 1/4 and a 0: 3/16.
    """
    task = make_task(name, 4, 0)
    task.head_start = torch.tensor([9, 1, 0, 0])
    ends = torch.tensor([True, True, False, False])
    monkeypatch.setattr(task, "succeeded", lambda: torch.zeros(4, dtype=torch.bool))
    monkeypatch.setattr(task, "failed", lambda: ends)
    task.successes = torch.tensor([1.0, 0.0, 1.0, 0.0])
    task._record()
    assert task.fitness() == 0.0
    found = []
    for place in (2, 3):
        ends[:] = torch.arange(4) == place
        task._record()
        found.append(task.fitness())
    assert found == after
    # a reset begins a whole episode, which counts
    task.reset(torch.tensor([True, False, False, False]))
    task.successes[0] = 1.0
    ends[:] = torch.arange(4) == 0
    task._record()
    assert task.fitness() > after[1]


def test_hits_of_a_cut_episode_are_not_averaged(monkeypatch):
    task = make_task("ReOrientation", 3, 0)
    task.head_start = torch.tensor([1, 0, 0])
    monkeypatch.setattr(task, "succeeded", lambda: torch.zeros(3, dtype=torch.bool))
    monkeypatch.setattr(task, "failed", lambda: torch.tensor([True, True, False]))
    task.successes = torch.tensor([9.0, 4.0, 7.0])
    task._record()
    # the second alone: 0.01 x 4
    assert task.fitness() == pytest.approx(0.04)


def test_an_episode_is_worth_its_success_or_its_mean_fitness():
    over, quadcopter = make_task("Over", 3, 0), make_task("Quadcopter", 3, 0)
    over.successes = torch.tensor([0.0, 1.0, 0.5])
    mean = torch.tensor([-0.25, -0.5, -2.0])
    assert over.episode_outcome(mean).tolist() == [0.0, 1.0, 0.5]
    assert quadcopter.episode_outcome(mean).tolist() == [-0.25, -0.5, -2.0]


def test_episodes_of_a_real_task_take_its_time_limit_and_give_the_mean_distance():
    task, twin = make_task("Over", 3, 2), make_task("Quadcopter", 2, 2)
    # Nobody moves: every egg falls, in the same few steps.
    still = play_episodes(task, lambda observations: torch.zeros(3, task.NUM_ACTIONS))
    assert {episode.outcome for episode in still} == {0.0}
    assert all(0 < episode.steps <= 75 for episode in still)
    # Without thrust both fall below 0.3 m or drift off; worked out again from the distances of every step.
    distances: list[list[float]] = [[], []]
    probe = make_task("Quadcopter", 2, 2)
    open_ended = [True, True]
    while any(open_ended):
        probe.step(torch.zeros(2, 12))
        ends = probe.terminated() | probe.timed_out()
        for place in (0, 1):
            if open_ended[place]:
                distances[place].append(float(probe.distance()[place]))
                open_ended[place] = not bool(ends[place])
        probe.reset(ends)
    played = play_episodes(twin, lambda observations: torch.zeros(2, 12))
    assert [episode.steps for episode in played] == [len(each) for each in distances]
    expected = [-math.fsum(each) / len(each) for each in distances]
    assert [episode.outcome for episode in played] == pytest.approx(expected, rel=1e-6)


# One fixed policy.

ENVS, STEPS, MIXING = 128, 32, 16
"""Environments and steps of the default run; 16 x 32 steps are more than one episode of 499."""


@pytest.fixture(scope="module")
def flyer(params, tmp_path_factory):
    """A policy that flies to its point and stays near it, after 60 epochs of the human reward: seconds of training."""
    human = changed(
        dataclasses.replace(params, task="Quadcopter"),
        candidate={"goal": "human", "bonus": "none", "beta": 0.0, "scale": 1.0},
        train={"num_envs": ENVS, "steps_per_epoch": STEPS},
    )
    folder = tmp_path_factory.mktemp("flyer")
    start, finish = folder / "start.safetensors", folder / "finish.safetensors"
    write_checkpoint(start, random_policy(human, 1))
    state, deterministic = torch.get_rng_state(), torch.are_deterministic_algorithms_enabled()
    outcome = train_candidate(Job("flyer", "", "", 0.0, start, finish, 60, 7), human, lambda *_: None)
    torch.set_rng_state(state)
    torch.use_deterministic_algorithms(deterministic)
    assert not outcome.failure
    return finish, human.train


def fitness_of_epochs(flyer, epochs, staggered, failing=0):
    """Returns the fitness of a fixed policy in consecutive epochs, after one episode: as it is, and at the last step alone.

    For so many steps before, nobody flies, and whoever falls begins anew.
    """
    policy, train = flyer
    task = make_task("Quadcopter", ENVS, 11)
    if staggered:
        task.stagger(12)
    actor, meter = policy_actor(task, policy, train), EpochFitness()
    over_steps, snapshots = [], []
    for _ in range(failing):
        task.step(torch.zeros(ENVS, task.NUM_ACTIONS))
        task.renew(task.terminated() | task.timed_out())
    with torch.inference_mode():
        for _ in range(MIXING + epochs):
            for _ in range(STEPS):
                task.step(actor(task.observations()))
                meter.add(task)
                task.renew(task.terminated() | task.timed_out())
            over_steps.append(meter.take())
            snapshots.append(task.fitness())
    return over_steps[MIXING:], snapshots[MIXING:]


def variation(values):
    return statistics.pstdev(values) / abs(statistics.mean(values))


@pytest.mark.timeout(600)
@pytest.mark.parametrize(("epochs", "failing"), [(64, 0), (32, 300)])
def test_one_fixed_policy_has_one_fitness_whatever_the_epoch_and_whatever_was_before(flyer, epochs, failing):
    over_steps, _ = fitness_of_epochs(flyer, epochs, staggered=True, failing=failing)
    assert len(over_steps) == epochs
    # It flies: an untrained policy is at -1.4, where nothing varies, since nothing comes near.
    assert statistics.mean(over_steps) > -0.6
    assert variation(over_steps) <= 0.05


@pytest.mark.timeout(600)
def test_in_phase_the_same_policy_has_every_fitness(flyer):
    """What head starts are for: without them it seems to forget and learn again with every episode."""
    over_steps, snapshots = fitness_of_epochs(flyer, 32, staggered=False)
    assert variation(over_steps) > 0.3
    assert variation(snapshots) > 0.3
