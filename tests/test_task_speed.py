"""The speed command measures what it says, on a real task."""

import time

import torch

from porse.bench.task_speed import STEPS, measure
from porse.tasks import make_task


def test_the_speed_is_of_whole_control_steps_and_the_bare_physics_is_a_part_of_them():
    task = make_task("Anymal", 8, seed=0)
    started = time.perf_counter()
    speed = measure(task, 0.0)
    elapsed = time.perf_counter() - started
    # Four rounds were played, and the best of them cannot be slower than all of them together.
    assert speed.steps > 8 * STEPS / elapsed
    assert 0.0 < speed.share < 1.0


def test_measuring_leaves_the_task_where_its_own_steps_lead():
    measured, played = (make_task("Anymal", 4, seed=0) for _ in range(2))
    measure(measured, 0.0)
    generator = torch.Generator().manual_seed(0)
    for _ in range(4):
        for _ in range(STEPS):
            played.step(2.0 * torch.rand(4, played.NUM_ACTIONS, generator=generator) - 1.0)
            played.reset(played.terminated() | played.timed_out())
    assert all(torch.equal(value, played.state()[key]) for key, value in measured.state().items())
