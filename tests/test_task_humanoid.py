"""Humanoid: layout, reward and fitness by numbers that a pencil finds."""

import pytest
import torch

from porse.tasks.humanoid import Humanoid
from porse.tasks.humanoid.task import GEARS, JOINTS


def standing(num_envs: int = 1) -> Humanoid:
    """Returns figures that stand upright and still with all joints at zero."""
    task = Humanoid(num_envs, 0, 1)
    task._physics.restart(torch.arange(num_envs))
    task._measure_started(torch.arange(num_envs))
    return task


def test_fitness_is_the_speed_toward_the_target() -> None:
    """A figure that moves at 2 m/s along x comes nearer at 2 m/s; one that moves back, at -1 m/s."""
    task = standing(2)
    task._physics.qvel[:, 0] = torch.tensor([2.0, -1.0])
    task.step(torch.zeros(2, 21))
    assert task.sparse_reward().tolist() == pytest.approx([2.0, -1.0], abs=0.15)
    assert task.fitness() == pytest.approx(0.5, abs=0.1)


def test_a_reset_forgets_the_progress() -> None:
    """The first progress of an episode does not include the way back to the start."""
    task = standing()
    task._physics.qpos[0, 0] = 50.0
    task.step(torch.zeros(1, 21))
    task.reset(torch.ones(1, dtype=torch.bool))
    assert float(task.sparse_reward()) == 0.0
    task.step(torch.zeros(1, 21))
    assert abs(float(task.sparse_reward())) < 0.5


def test_human_reward_of_standing() -> None:
    """No progress, alive 2, upright 0.1, heading 0.5: 2.6; 21 full actions at rest cost 0.21."""
    task = standing()
    assert float(task.human_reward()) == pytest.approx(2.6, abs=1e-4)
    task.actions = torch.ones(1, 21)
    assert float(task.human_reward()) == pytest.approx(2.39, abs=1e-4)


def test_human_reward_of_speed_and_of_limits() -> None:
    """The right knee (gear 90, ratio 2/3) at 10 rad/s with action 1 costs 0.01 + 0.05 * 2/3; at its limit 0.25 * 2/3."""
    task = standing()
    knee = JOINTS.index("right_knee")
    task.dof_vel = torch.zeros(1, 21).index_fill(1, torch.tensor([knee]), 10.0)
    task.actions = torch.zeros(1, 21).index_fill(1, torch.tensor([knee]), 1.0)
    assert float(task.human_reward()) == pytest.approx(2.6 - 0.01 - 0.05 * 2 / 3, abs=1e-4)
    task.actions = torch.zeros(1, 21)
    task.dof_pos = task.dof_pos.clone()
    task.dof_pos[0, knee] = task.dof_limits_upper[0, knee]
    assert float(task.human_reward()) == pytest.approx(2.6 - 0.25 * 2 / 3, abs=1e-4)


def test_a_fallen_figure_ends_and_costs() -> None:
    """At 0.79 m: the episode ends with -1; at 0.81 m it goes on."""
    task = standing(2)
    task._physics.qpos[:, 2] = torch.tensor([0.79, 0.81], dtype=torch.float64)
    task._measure_started(torch.arange(2))
    assert task.terminated().tolist() == [True, False]
    assert float(task.human_reward()[0]) == -1.0


def test_actions_are_torques() -> None:
    """The gear times the action, for each joint; gears as in the original."""
    assert len(GEARS) == len(JOINTS) == 21
    task = standing()
    model = task._physics.model
    for index, (joint, gear) in enumerate(zip(JOINTS, GEARS, strict=True)):
        assert model.actuator(index).trnid[0] == model.joint(joint).id
        assert model.actuator(index).gear[0] == gear
    task.step(torch.full((1, 21), -2.0))
    assert task._physics.ctrl[0].tolist() == [-1.0] * 21


def test_observations_are_laid_out_as_in_the_original() -> None:
    """Height, velocity in the torso's frame, turn, yaw, roll, bearing, up, heading, and actions last."""
    task = standing()
    task._physics.qvel[0, 0:3] = torch.tensor([1.0, 2.0, 3.0])
    task._physics.qvel[0, 3:6] = torch.tensor([0.4, 0.8, 1.2])
    task._measure_started(torch.arange(1))
    task.actions = torch.full((1, 21), 0.5)
    seen = task.observations()[0]
    expected = [1.34, 1.0, 2.0, 3.0, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0, 1.0]
    assert seen[:12].tolist() == pytest.approx(expected, abs=1e-5)
    assert seen[87:].tolist() == [0.5] * 21


def test_it_stands_on_its_feet() -> None:
    """Settled for a moment without torques, the feet carry the figure: their sensors feel most of its weight."""
    task = standing()
    weight = float(task._physics.model.body("torso").subtreemass[0]) * 9.81
    strongest = 0.0
    for _ in range(12):
        task.step(torch.zeros(1, 21))
        forces = task.vec_sensor_tensor[0].view(4, 3)
        strongest = max(strongest, float(torch.norm(forces[0]) + torch.norm(forces[2])))
    assert strongest > 0.5 * weight
    assert float(task.root_states[0, 2]) > 1.0
