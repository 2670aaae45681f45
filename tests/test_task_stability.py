"""Random play never blows up, and bodies stay out of each other.

By default a short stretch of every task; `slow` plays a thousand episodes of each.
"""

import mujoco
import numpy as np
import pytest
import torch

from porse.sim.physics import CpuPhysics
from porse.tasks import TASKS, make_task
from porse.tasks.base import Task

NAMES = sorted(TASKS)

FASTEST = 120.0
"""Highest joint speed (rad/s or m/s) of random play. Measured: 103 at a finger, 98 at a flailing arm of the humanoid."""

DEEPEST = 0.04
"""Deepest penetration (m): a hand under full force moves 1.4 cm in a physics step, and the contact gives as much again.

Measured over a thousand episodes of each task: 0.033 in SwingCup, 0.032 and 0.029 in the switch tasks, at most 0.028
elsewhere. Looked at after every step, not every twentieth, the scissors reach 0.040 when a hand slams them down.
"""


LIVELIEST = {"Humanoid": 800.0, "Anymal": 400.0}
"""Highest kinetic energy (J) of one environment, where more than LIVELY. Measured over a thousand episodes: 530, 210."""
LIVELY = 100.0
"""The same of every other task. Measured: at most 52, a kettle's and a door's hands in full swing."""


def hard_actions(task: Task, step: int, generator: torch.Generator) -> torch.Tensor:
    """Returns random actions, in half of the steps pushed to their limits."""
    actions = torch.rand(task.num_envs, task.NUM_ACTIONS, generator=generator) * 2 - 1
    return torch.sign(actions) if step % 40 < 20 else actions


def extremes(task: Task, data: mujoco.MjData) -> tuple[float, float]:
    """Returns the deepest penetration (m) and the highest kinetic energy (J) over the environments."""
    physics = task._physics
    assert isinstance(physics, CpuPhysics)
    depth = energy = 0.0
    for env in range(task.num_envs):
        physics._batch.get_data(env, data)
        mujoco.mj_fwdPosition(physics.model, data)
        mujoco.mj_energyVel(physics.model, data)
        energy = max(energy, float(data.energy[1]))
        if data.ncon:
            depth = max(depth, -float(np.min(data.contact.dist)))
    return depth, energy


def play(task: Task, episodes: int, steps: int) -> None:
    """Plays at least so many episodes, or so many steps, and checks speeds, depths, energies and numbers on the way."""
    generator = torch.Generator().manual_seed(11)
    data = mujoco.MjData(task._physics.model)
    ended, step = 0, 0
    actions = hard_actions(task, 0, generator)
    while ended < episodes and step < steps:
        if step % 3 == 0:
            actions = hard_actions(task, step, generator)
        task.step(actions)
        assert float(task._physics.qvel.abs().max()) < FASTEST, step
        if step % 20 == 0:
            depth, energy = extremes(task, data)
            assert depth < DEEPEST, step
            assert 0.0 < energy < LIVELIEST.get(task.NAME, LIVELY), step
            assert bool(task.observations().isfinite().all())
        done = task.terminated() | task.timed_out()
        ended += int(done.sum())
        task.reset(done)
        step += 1
    assert task.blown_up == 0


@pytest.mark.parametrize("name", NAMES)
def test_random_play_is_stable(name: str) -> None:
    """Sixty hard steps in four environments."""
    play(make_task(name, 4, seed=2), episodes=10_000, steps=60)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_thousand_episodes_are_stable(name: str) -> None:
    """A thousand episodes, 64 at a time."""
    play(make_task(name, 64, seed=3, threads=2), episodes=1000, steps=20_000)


@pytest.mark.parametrize(
    "name", ["GraspAndPlace", "Kettle", "PushBlock", "Scissors", "SwingCup", "LiftUnderarm", "Pen"]
)
def test_an_object_that_is_left_alone_rests_on_its_table(name: str) -> None:
    """A second without a push at the hands: it settled, moved less than 3 cm, and is still."""
    task = make_task(name, 1, seed=0)
    start = task.variables()["object_pos"]
    assert isinstance(start, torch.Tensor)
    for _ in range(60):
        task.step(torch.zeros(1, task.NUM_ACTIONS))
    values = task.variables()
    position, speed = values["object_pos"], values["object_linvel"]
    assert isinstance(position, torch.Tensor)
    assert isinstance(speed, torch.Tensor)
    assert float(torch.norm(position - start)) < 0.03
    assert float(torch.norm(speed)) < 0.01
