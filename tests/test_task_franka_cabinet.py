"""FrankaCabinet: kinematics, reward and success by numbers that a pencil finds."""

import mujoco
import pytest
import torch

from porse.sim.physics import CpuPhysics
from porse.tasks.franka_cabinet.task import LOWER, START, UPPER, FrankaCabinet


def opened(*openings: float) -> FrankaCabinet:
    """Returns one environment for each opening (m) of the top drawer."""
    task = FrankaCabinet(len(openings), 0, 1)
    index = int(task._physics.model.joint("drawer_top_joint").qposadr[0])
    task._physics.qpos[:, index] = torch.tensor(openings, dtype=torch.float64)
    everyone = torch.arange(len(openings))
    task._physics.refresh(everyone)
    task._measure_started(everyone)
    return task


def hold(task: FrankaCabinet, left_x: float = 0.0) -> None:
    """Writes measurements of a gripper on the handle: axes aligned, fingers 2 cm above and below."""
    handle = task.drawer_grasp_pos
    task.franka_grasp_pos = handle.clone()
    task.drawer_grasp_rot = torch.tensor([[0.0, 0.0, 0.0, 1.0]])
    # x -> y, y -> z, z -> x, then half a turn about z: the gripper looks along -x, and its y axis is up.
    task.franka_grasp_rot = torch.tensor([[-0.5, 0.5, 0.5, -0.5]])
    task.franka_lfinger_pos = handle + torch.tensor([left_x, 0.0, 0.02])
    task.franka_rfinger_pos = handle + torch.tensor([0.0, 0.0, -0.02])
    task.actions = torch.zeros(1, 9)


def test_an_open_drawer_is_a_success_and_a_nearly_open_one_is_not() -> None:
    """39.5 cm counts, 38.5 cm does not; success ends the episode."""
    task = opened(0.395, 0.385)
    assert task.sparse_reward().tolist() == [1.0, 0.0]
    assert task.terminated().tolist() == [True, False]


def test_success_is_counted_when_the_episode_ends() -> None:
    """One of two episodes ends open: the mean is 1/2."""
    task = opened(0.395, 0.1)
    task.step(torch.zeros(2, 9))
    assert task.fitness() == pytest.approx(0.5)


def test_the_grasp_point_of_the_drawer_moves_with_it() -> None:
    """0.0515 + 0.3 m ahead of the cabinet, 1 cm beside, at 0.4 + 0.3172 m; plus the opening."""
    task = opened(0.0, 0.2)
    assert task.drawer_grasp_pos[0].tolist() == pytest.approx([0.3515, 0.01, 0.7172], abs=1e-6)
    assert task.drawer_grasp_pos[1].tolist() == pytest.approx([0.5515, 0.01, 0.7172], abs=1e-6)


def test_the_arm_stands_behind_and_reaches_toward_the_cabinet() -> None:
    """At joint zero, link 7 is 0.088 m before the base (which looks along -x) at 0.333 + 0.316 + 0.384 m."""
    task = FrankaCabinet(1, 0, 1)
    task._physics.qpos[0, :9] = 0.0
    task._physics.refresh(torch.arange(1))
    task._measure_started(torch.arange(1))
    hand = task.rigid_body_states[0, task.hand_handle, :3]
    assert hand.tolist() == pytest.approx([1 - 0.088, 0.0, 1.033], abs=1e-5)
    assert task.franka_lfinger_pos[0, 2] == pytest.approx(1.033 - 0.1654, abs=1e-5)


def test_human_reward_on_the_handle() -> None:
    """2 * (2 * 1) + 0.5 * 1 + 0.25 * 0.5 + 5 * (0.08 - 0.04) = 4.825 while the drawer is shut."""
    task = opened(0.0)
    hold(task)
    assert float(task.human_reward()) == pytest.approx(4.825, abs=1e-5)


def test_human_reward_of_an_opening_drawer_and_of_actions() -> None:
    """At 0.3 m: 4.825 + 7.5 * (0.3 * 0.5 + 0.3) + 0.5 + 0.5 = 9.2; nine actions of 1 cost 0.09."""
    task = opened(0.3)
    hold(task)
    assert float(task.human_reward()) == pytest.approx(9.2, abs=1e-5)
    task.actions = torch.ones(1, 9)
    assert float(task.human_reward()) == pytest.approx(9.11, abs=1e-5)


def test_a_finger_behind_the_handle_costs_everything() -> None:
    """More than 4 cm behind it: -1."""
    task = opened(0.3)
    hold(task, left_x=-0.041)
    assert float(task.human_reward()) == -1.0


def test_actions_move_the_targets() -> None:
    """One step of 1: 7.5 / 60 rad for the arm, a tenth of it for the fingers, within the limits."""
    task = FrankaCabinet(1, 0, 1)
    task._targets[0] = START.double()
    task.step(torch.ones(1, 9))
    expected = torch.minimum(START + torch.tensor([0.125] * 7 + [0.0125] * 2), UPPER)
    assert torch.allclose(task._targets[0].float(), expected)


def test_targets_stay_within_the_limits_of_the_joints() -> None:
    """A hundredth of a radian from them, a step of 1 asks for an eighth (a finger: for 1.25 cm) and comes to the limit."""
    task = FrankaCabinet(1, 0, 1)
    for sign, limit in ((1.0, UPPER), (-1.0, LOWER)):
        task._targets[0] = limit.double() - 0.01 * sign
        task.step(torch.full((1, 9), sign))
        assert torch.equal(task._targets[0], limit.double())


def test_a_drive_pushes_with_its_limit_whatever_its_damping_says() -> None:
    """A wrist joint that is 0.4 rad from its target gets 12 N m, though it turns toward it at 0.4 rad/s.

    A damping of 80 beside the drive would leave 12 - 32 N m.
    """
    task = opened(0.0)
    task._targets[0, 4] = task._physics.qpos[0, 4] + 0.4
    task._physics.qvel[0, 4] = 0.4
    task._act()
    physics = task._physics
    assert isinstance(physics, CpuPhysics)
    data = mujoco.MjData(physics.model)
    physics._batch.get_data(0, data)
    mujoco.mj_forward(physics.model, data)
    assert data.qfrc_actuator[4] == pytest.approx(12.0)
    assert data.qfrc_damper[4] == 0.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_arm_reaches_the_speeds_of_the_robot_and_no_more(sign: float) -> None:
    """Targets that run ahead at 7.5 rad/s: after a third of a second joint 1 turns at 2.175, joint 7 at 2.61 rad/s."""
    task = FrankaCabinet(1, 0, 1)
    actions = torch.zeros(1, 9)
    for joint in (0, 6):
        fresh = actions.clone()
        fresh[0, joint] = sign
        task.reset(torch.ones(1, dtype=torch.bool))
        for _ in range(20):
            task.step(fresh)
        limit = 2.175 if joint < 4 else 2.61
        assert float(task.franka_dof_vel[0, joint]) == pytest.approx(sign * limit, rel=0.05)


def test_the_drawer_opens_when_it_is_pulled() -> None:
    """30 N against a damping of 10 N s/m and 8 kg for two seconds: up to the stop at 0.4 m, the arm turned away."""
    task = opened(0.0)
    task._physics.qpos[0, 0] = task._targets[0, 0] = -1.5
    body = task._physics.model.body("drawer_top").id
    task._physics.force[0, body, 0] = 30.0
    for _ in range(120):
        task.step(torch.zeros(1, 9))
    assert task.cabinet_dof_pos[0, 3] == pytest.approx(0.4, abs=0.005)
    assert task.fitness() == 1.0


def test_starts_are_spread_as_stated() -> None:
    """Joints within 0.125 of the start and within the limits; targets at the joints; cabinet shut."""
    task = FrankaCabinet(200, 1, 1)
    assert float((task.franka_dof_pos - START).abs().max()) <= 0.1251
    assert bool(((task.franka_dof_pos >= LOWER) & (task.franka_dof_pos <= UPPER)).all())
    assert torch.equal(task._physics.ctrl, task._physics.qpos[:, :9])
    assert float(task.cabinet_dof_pos.abs().max()) == 0.0
