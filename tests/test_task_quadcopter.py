"""Quadcopter: masses, controls, fitness and reward by numbers that a pencil finds."""

import math

import pytest
import torch

from porse.tasks.quadcopter import Quadcopter


def placed(position: tuple[float, float, float], spin: float = 0.0) -> Quadcopter:
    """Returns one quadcopter put at a position, level, with a spin (rad/s) about z."""
    task = Quadcopter(1, 0, 1)
    task._physics.qpos[0, :3] = torch.tensor(position, dtype=torch.float64)
    task._physics.qvel[0, 5] = spin
    task._measure()
    return task


def test_mass_is_the_originals() -> None:
    """0.252 kg in all."""
    assert float(Quadcopter.scene().compile().body_mass.sum()) == pytest.approx(0.252, abs=5e-4)


def test_fitness_is_minus_the_mean_distance() -> None:
    """3 and 4 m off in x and y is 5 m; at the target 0; together -2.5."""
    task = Quadcopter(2, 0, 1)
    task._physics.qpos[:, :3] = torch.tensor([[3.0, 4.0, 1.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    task._measure()
    assert task.fitness() == pytest.approx(-2.5)
    assert task.sparse_reward().tolist() == pytest.approx([-5.0, 0.0])


def test_human_reward_at_the_target_and_beside_it() -> None:
    """At the target, level and still: 1 + 1 (1 + 1) = 3. At 1 m: 1/2 + 1/2 * 2 = 1.5. Spinning at 1: 1 + 1.5."""
    assert float(placed((0, 0, 1)).human_reward()) == pytest.approx(3.0)
    assert float(placed((1, 0, 1)).human_reward()) == pytest.approx(1.5)
    assert float(placed((0, 0, 1), spin=1.0).human_reward()) == pytest.approx(2.5)


def test_human_reward_of_a_tilt() -> None:
    """On its side, up_z = 0, u = 1/2: 1 + 1 (1/2 + 1) = 2.5."""
    task = placed((0, 0, 1))
    half = math.sqrt(0.5)
    task._physics.qpos[0, 3:7] = torch.tensor([half, half, 0, 0], dtype=torch.float64)
    task._measure()
    assert float(task.human_reward()) == pytest.approx(2.5, abs=1e-5)


@pytest.mark.parametrize(
    ("position", "ends"), [((0, 0, 1), False), ((2.9, 0, 1), False), ((3.1, 0, 1), True), ((0, 0, 0.29), True)]
)
def test_an_episode_ends_far_away_or_low(position: tuple[float, float, float], ends: bool) -> None:
    """Farther than 3 m, or below 0.3 m."""
    assert bool(placed(position).terminated()) is ends


def test_actions_move_targets_and_thrusts() -> None:
    """One step of 1: thrust 200 * 0.01 = 2 N, its limit; joint target 8 pi * 0.01 rad; then the target's limit."""
    task = placed((0, 0, 1))
    task._physics.ctrl[:] = 0.0
    task.step(torch.ones(1, 12) * 5)
    assert task._physics.ctrl[0, 8:].tolist() == pytest.approx([2.0] * 4)
    assert task._physics.ctrl[0, :8].tolist() == pytest.approx([8 * math.pi * 0.01] * 8)
    for _ in range(2):
        task.step(torch.ones(1, 12))
    assert task._physics.ctrl[0, :8].tolist() == pytest.approx([math.pi / 6] * 8)
    # Three steps have asked for 6 N, and four of -1 for 8 N less.
    assert task._physics.ctrl[0, 8:].tolist() == [2.0] * 4
    for _ in range(4):
        task.step(-torch.ones(1, 12))
    assert task._physics.ctrl[0, 8:].tolist() == [0.0] * 4


def test_the_chassis_spins_no_faster_than_the_bound_when_a_step_begins() -> None:
    """From 30 rad/s about z to 4 pi; 1 rad/s stays."""
    fast, slow = placed((0, 0, 1), spin=30.0), placed((0, 0, 1), spin=1.0)
    for task, spin in ((fast, 4 * math.pi), (slow, 1.0)):
        task.step(torch.zeros(1, 12))
        assert float(task.root_angvels[0, 2]) == pytest.approx(spin, rel=1e-3)


def test_joints_follow_their_targets() -> None:
    """Within a few steps the tilts are where the controls say."""
    task = placed((0, 0, 1))
    for _ in range(10):
        task.step(torch.cat((torch.ones(1, 8), -torch.ones(1, 4)), dim=-1))
    assert task.dof_positions[0].tolist() == pytest.approx([math.pi / 6] * 8, abs=0.02)


def test_hover_thrust_holds_it_up() -> None:
    """Four times m g / 4 against the weight: after 0.2 s it has not moved 2 cm; without thrust it fell 19 cm."""
    hovering, falling = placed((0, 0, 1)), placed((0, 0, 1))
    for task in (hovering, falling):
        task._physics.qpos[0, 7:] = 0.0
        task._physics.ctrl[:] = 0.0
    hovering._physics.ctrl[0, 8:] = 0.2515 * 9.81 / 4
    for _ in range(20):
        hovering.step(torch.zeros(1, 12))
        falling.step(torch.zeros(1, 12))
    assert float(hovering.root_positions[0, 2]) == pytest.approx(1.0, abs=0.02)
    assert float(falling.root_positions[0, 2]) == pytest.approx(1 - 9.81 * 0.2**2 / 2, abs=0.01)


def test_angular_velocity_is_reported_in_the_world_frame() -> None:
    """On its side (a quarter turn about x), a spin about the body's z axis is one about the world's -y axis."""
    task = placed((0, 0, 1), spin=2.0)
    half = math.sqrt(0.5)
    task._physics.qpos[0, 3:7] = torch.tensor([half, half, 0, 0], dtype=torch.float64)
    task._measure()
    assert task.root_angvels[0].tolist() == pytest.approx([0.0, -2.0, 0.0], abs=1e-6)


def test_observations_are_laid_out_as_in_the_original() -> None:
    """Offset / 3, quaternion, velocity / 2, angular velocity / pi, joints."""
    task = placed((0.3, 0.6, 1.9), spin=math.pi)
    task._physics.qvel[0, 0] = 1.0
    task._physics.qpos[0, 7:] = 0.1
    task._measure()
    expected = [-0.1, -0.2, -0.3, 0, 0, 0, 1, 0.5, 0, 0, 0, 0, 1, *[0.1] * 8]
    assert task.observations()[0].tolist() == pytest.approx(expected, abs=1e-6)


def test_starts_are_spread_as_stated() -> None:
    """x and y in +-1.5 m, z in [0.8, 2.5] m, joints in +-0.2 rad, thrust 0, targets at the joints."""
    task = Quadcopter(500, 0, 1)
    position = task.root_positions
    assert 1.4 < float(position[:, :2].abs().max()) <= 1.5
    assert 0.8 <= float(position[:, 2].min()) < 0.85
    assert 2.45 < float(position[:, 2].max()) <= 2.5
    assert float(task.dof_positions.abs().max()) <= 0.2
    assert torch.equal(task._physics.ctrl[:, :8], task._physics.qpos[:, 7:])
    assert float(task._physics.ctrl[:, 8:].abs().max()) == 0.0


def test_variables_of_the_present_are_copied_once_when_they_are_read_and_not_before() -> None:
    task = Quadcopter(3, 0, 1)
    present, before = task.present(), task.variables()
    assert list(present) == list(before)
    present["root_positions"].fill_(99.0)
    assert torch.equal(task.variables()["root_positions"], before["root_positions"])
    assert float(present["root_positions"][0, 0]) == 99.0
    task.step(torch.ones(3, task.NUM_ACTIONS))
    # Read before the step, and after it.
    assert float(present["root_positions"][0, 0]) == 99.0
    assert torch.equal(present["root_linvels"], task.variables()["root_linvels"])
    assert not torch.equal(present["root_linvels"], before["root_linvels"])
    with pytest.raises(KeyError):
        present["_physics"]
