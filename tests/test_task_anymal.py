"""Anymal: stance, contacts, reward and fitness by numbers that a pencil finds."""

import math

import pytest
import torch

from porse.tasks.anymal.task import DEFAULT, Anymal


def moving(command: tuple[float, float, float], velocity: tuple[float, float, float], turn: float) -> Anymal:
    """Returns one level robot with a command, a world velocity (m/s) and a turning velocity (rad/s)."""
    task = Anymal(1, 0, 1)
    task.commands = torch.tensor([command])
    task._physics.qvel[0, 0:3] = torch.tensor(velocity, dtype=torch.float64)
    task._physics.qvel[0, 5] = turn
    task._measure_started(torch.arange(1))
    return task


def test_the_robot_has_the_published_mass() -> None:
    """52.1 kg."""
    assert float(Anymal.scene().compile().body_mass.sum()) == pytest.approx(52.1, abs=0.1)


def test_fitness_is_minus_the_squared_errors() -> None:
    """Commanded (1, 0.5, 0.2), moving (0, 0, 0.5): 1 + 0.25 + 0.09 = 1.34; following exactly: 0."""
    assert moving((1.0, 0.5, 0.2), (0.0, 0.0, 0.0), 0.5).fitness() == pytest.approx(-1.34, abs=1e-5)
    assert moving((1.0, 0.5, 0.2), (1.0, 0.5, 0.0), 0.2).fitness() == pytest.approx(0.0, abs=1e-6)


def test_velocities_count_in_the_robots_frame() -> None:
    """Turned left by a quarter, a world velocity along y is forward."""
    task = moving((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), 0.0)
    half = math.sqrt(0.5)
    task._physics.qpos[0, 3:7] = torch.tensor([half, 0.0, 0.0, half], dtype=torch.float64)
    task._measure_started(torch.arange(1))
    assert task.fitness() == pytest.approx(0.0, abs=1e-6)


def test_human_reward() -> None:
    """Following exactly: 0.02 * 1.5; half a metre a second off: 0.02 (exp(-1) + 0.5); torques cost; never below 0."""
    assert float(moving((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0).human_reward()) == pytest.approx(0.03, abs=1e-6)
    task = moving((0.5, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
    assert float(task.human_reward()) == pytest.approx(0.02 * (math.exp(-1) + 0.5), abs=1e-6)
    task.torques = torch.full((1, 12), 10.0)
    assert float(task.human_reward()) == pytest.approx(0.02 * (math.exp(-1) + 0.5 - 2.5e-5 * 1200), abs=1e-6)
    task.torques = torch.full((1, 12), 80.0)
    assert float(task.human_reward()) == 0.0


def test_it_stands_in_the_default_stance() -> None:
    """With zero actions it stands after a second, near 0.55 m, and no base or thigh touches the floor."""
    task = Anymal(8, 0, 1)
    for _ in range(75):
        task.step(torch.zeros(8, 12))
        assert not task.terminated().any()
    assert bool((task.root_states[:, 2] > 0.48).all())
    assert bool((task.root_states[:, 2] < 0.62).all())


def test_a_fall_on_the_base_ends_the_episode() -> None:
    """Dropped on its back, the base touches the floor."""
    task = Anymal(1, 0, 1)
    task._physics.qpos[0, 2:7] = torch.tensor([0.4, 0.0, 1.0, 0.0, 0.0], dtype=torch.float64)
    ended = False
    for _ in range(50):
        task.step(torch.zeros(1, 12))
        ended = ended or bool(task.terminated())
    assert ended


def test_actions_are_targets_around_the_default() -> None:
    """Half a radian for an action of 1."""
    task = Anymal(1, 0, 1)
    task.step(torch.full((1, 12), 3.0))
    assert torch.allclose(task._physics.ctrl[0].float(), DEFAULT + 0.5)


def test_joints_begin_a_step_at_twenty_radians_a_second_at_most() -> None:
    """Of the joints all, of the body none."""
    task = Anymal(1, 0, 1)
    assert task._physics.fastest is not None
    assert task._physics.fastest.tolist() == [float("inf")] * 6 + [20.0] * 12


def test_observations_are_laid_out_as_in_the_original() -> None:
    """Velocity * 2, turn / 4, gravity, command * (2, 2, 1/4), joints, speeds / 20, actions."""
    task = moving((1.0, 0.5, 0.4), (0.1, 0.2, 0.3), 0.4)
    joints = int(task._physics.model.joint("LH_HAA").qposadr[0])
    task._physics.qpos[0, 7:] = DEFAULT.double()
    task._physics.qpos[0, joints] += 0.25
    task._physics.qvel[0, 6:] = 2.0
    task._measure_started(torch.arange(1))
    task.actions = torch.full((1, 12), 0.5)
    seen = task.observations()[0].tolist()
    assert seen[:12] == pytest.approx([0.2, 0.4, 0.6, 0, 0, 0.1, 0, 0, -1, 2.0, 1.0, 0.1], abs=1e-5)
    assert seen[12:24] == pytest.approx([0, 0, 0, 0.25, *[0] * 8], abs=1e-5)
    assert seen[24:36] == pytest.approx([0.1] * 12)
    assert seen[36:] == [0.5] * 12


def test_starts_are_spread_as_stated() -> None:
    """Joints at 0.5 to 1.5 times the default; commands within (2, 1, 1)."""
    task = Anymal(300, 2, 1)
    share = task.dof_pos / DEFAULT
    assert 0.5 <= float(share.min()) < 0.52
    assert 1.48 < float(share.max()) <= 1.5001
    assert 1.9 < float(task.commands[:, 0].abs().max()) <= 2.0
    assert 0.95 < float(task.commands[:, 1:].abs().max()) <= 1.0
