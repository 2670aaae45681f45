"""The speed command measures what it says, on a real task."""

import time

import torch

from porse.bench import task_speed
from porse.bench.task_speed import STEPS, Round, measure
from porse.tasks import make_task


def test_the_speed_is_of_whole_control_steps_and_the_bare_physics_is_a_part_of_them():
    task = make_task("Anymal", 8, seed=0)
    started = time.perf_counter()
    speed = measure(task, 0.0)
    elapsed = time.perf_counter() - started
    # Three rounds were played and one before them, and one in the middle cannot be slower than all of them together.
    assert speed.steps > 8 * STEPS / elapsed
    assert 0.0 < speed.share < 1.0


def test_speed_and_share_are_those_of_the_middle_round(monkeypatch):
    played = [Round(0.2, 0.1), Round(0.5, 0.1), Round(0.1, 0.08)]
    monkeypatch.setattr(task_speed, "rounds", lambda task, clock: iter(played))
    speed = measure(make_task("Anymal", 8, seed=0), 0.0)
    # Ten control steps of eight environments in 0.2 s; shares of 0.5, 0.2 and 0.8.
    assert (round(speed.steps), speed.share) == (400, 0.5)


def test_measuring_leaves_the_task_where_its_own_steps_lead():
    measured, played = (make_task("Anymal", 4, seed=0) for _ in range(2))
    measure(measured, 0.0)
    generator = torch.Generator().manual_seed(0)
    for _ in range(4):
        for _ in range(STEPS):
            played.step(2.0 * torch.rand(4, played.NUM_ACTIONS, generator=generator) - 1.0)
            played.reset(played.terminated() | played.timed_out())
    assert all(torch.equal(value, played.state()[key]) for key, value in measured.state().items())
