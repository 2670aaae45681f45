"""The parts that observations of two-hand tasks are put together from. Prompts show these functions as they are."""

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from porse.sim import rotations
from porse.tasks.hands import shadow

if TYPE_CHECKING:
    from porse.tasks.hands.two_hands import TwoHandTask

JOINT_RANGES = torch.tensor(shadow.RANGES)
"""Lower and upper limits (rad) of a hand's joints, `(24, 2)`."""


def hand_observations(
    dof_pos: Tensor, dof_vel: Tensor, dof_force: Tensor, tips: Tensor, sensors: Tensor, root: Tensor, actions: Tensor
) -> Tensor:
    """Returns one hand's part of the observations.

    Joint angles scaled to [-1, 1] (24), 0.2 * joint speeds (24), 10 * joint torques (24), states of the five
    fingertips (65), 10 * force and torque at each (30), position and Euler angles of a free hand (6) or nothing,
    and the hand's last actions.
    """
    lower, upper = JOINT_RANGES[:, 0], JOINT_RANGES[:, 1]
    return torch.cat(
        (
            (2.0 * dof_pos - upper - lower) / (upper - lower),
            0.2 * dof_vel,
            10.0 * dof_force,
            tips.flatten(1),
            10.0 * sensors,
            root,
            actions,
        ),
        dim=-1,
    )


def fixed_hands(env: "TwoHandTask") -> Tensor:
    """Returns the observations of both hands, 187 each: `hand_observations` without a place."""
    fixed = env.actions[:, :0]
    return torch.cat(
        (
            hand_observations(
                env.shadow_hand_dof_pos, env.shadow_hand_dof_vel, env.dof_force_tensor[:, :24],
                env.fingertip_state, env.vec_sensor_tensor[:, :30], fixed, env.actions[:, :20],
            ),
            hand_observations(
                env.shadow_hand_another_dof_pos, env.shadow_hand_another_dof_vel, env.dof_force_tensor[:, 24:],
                env.fingertip_another_state, env.vec_sensor_tensor[:, 30:], fixed, env.actions[:, 20:],
            ),
        ),
        dim=-1,
    )  # fmt: skip


def free_hands(env: "TwoHandTask", right_position: Tensor, left_position: Tensor) -> Tensor:
    """Returns the observations of both hands, 199 each: `hand_observations` with a position and Euler angles."""
    right = torch.cat((right_position, rotations.euler_xyz(env.root_state_tensor[:, 0, 3:7])), dim=-1)
    left = torch.cat((left_position, rotations.euler_xyz(env.root_state_tensor[:, 1, 3:7])), dim=-1)
    return torch.cat(
        (
            hand_observations(
                env.shadow_hand_dof_pos, env.shadow_hand_dof_vel, env.dof_force_tensor[:, :24],
                env.fingertip_state, env.vec_sensor_tensor[:, :30], right, env.actions[:, :26],
            ),
            hand_observations(
                env.shadow_hand_another_dof_pos, env.shadow_hand_another_dof_vel, env.dof_force_tensor[:, 24:],
                env.fingertip_another_state, env.vec_sensor_tensor[:, 30:], left, env.actions[:, 26:],
            ),
        ),
        dim=-1,
    )  # fmt: skip


def moving_body(pose: Tensor, linvel: Tensor, angvel: Tensor) -> Tensor:
    """Returns a body's part of the observations: pose (7), linear velocity (3), 0.2 * angular velocity (3)."""
    return torch.cat((pose, linvel, 0.2 * angvel), dim=-1)


def goal_and_turn(pose: Tensor, goal_pose: Tensor) -> Tensor:
    """Returns a goal's part of the observations: its pose (7) and the turn from it to the body's pose (4)."""
    return torch.cat((goal_pose, rotations.multiply(pose[:, 3:7], rotations.conjugate(goal_pose[:, 3:7]))), dim=-1)
