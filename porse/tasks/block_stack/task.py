"""BlockStack: two hands stack two cubes."""

import math

import mujoco
import torch
from torch import Tensor

from porse.tasks.block_stack import scene
from porse.tasks.hands import shadow
from porse.tasks.hands.free_hands import Handle, handle_variables
from porse.tasks.hands.handles import TableTask, hand_lost
from porse.tasks.hands.observations import free_hands, moving_body
from porse.tasks.hands.variables import (
    body_variables,
    free_hand_variables,
    goal_variables,
    root_variable,
)

NEAR = 0.07
LOWER = (0.0, 0.0, 0.625)
UPPER = (0.0, 0.0, 0.675)
PADDING = 4
"""Entries of the original's observations that it never writes."""


class BlockStack(TableTask):
    """Stack the cubes."""

    NAME = "BlockStack"
    DESCRIPTION = "two shadow hands stack two blocks into a tower"
    STARTS = "the cubes stand on the table, 0.2 m apart"
    LOST = 0.75
    ENDS = hand_lost(LOST)
    FITNESS = (
        "the share of episodes in which the right cube once was within 7 cm of (0, 0, 0.625), and the left one "
        "within 7 cm of (0, 0, 0.675) and within 3 cm of its height"
    )
    NUM_OBSERVATIONS = 428
    EPISODE_LENGTH = TIME_LIMIT = 250
    FORCE_SCALE = 0.2
    TORQUE_SCALE = 0.02
    RIGHT = shadow.BasePose((0.0, 0.6, 0.7), (math.pi, 0.0, 3.14))
    LEFT = shadow.BasePose((0.0, -0.6, 0.7), (math.pi, 0.0, 0.0))
    PER_ENV_STATISTIC = True
    OBJECT_BODIES = ("object", "block", "goal", "table")
    ACTORS = OBJECT_BODIES
    BODIES = (("object", "object"), ("block", "block"), ("goal", "goal"))
    HANDLES = (
        Handle("block_right_handle", "object", "the right cube", hand="right"),
        Handle("block_left_handle", "block", "the left cube", hand="left"),
    )
    VARIABLES = (
        *body_variables("object", "the right cube"),
        *goal_variables("goal", "the goal: 10 cm beside it, toward -y, the tower stands"),
        *body_variables("block", "the left cube"),
        *handle_variables(HANDLES),
        *free_hand_variables(NUM_OBSERVATIONS, OBJECT_BODIES, ACTORS),
        root_variable("block_indices", "the left cube"),
    )

    block_pose: Tensor
    block_linvel: Tensor
    block_angvel: Tensor
    block_right_handle_pos: Tensor
    block_left_handle_pos: Tensor

    @classmethod
    def add_objects(cls, spec: mujoco.MjSpec) -> None:
        """Adds the table, the cubes on it, and the goal."""
        scene.add_objects(spec)

    def compute_observations(self) -> Tensor:
        """Returns the observations, `(num_envs, 428)`: two hands, both cubes, four zeros."""
        return torch.cat(
            (
                free_hands(self, self.right_hand_pos, self.left_hand_pos),
                moving_body(self.object_pose, self.object_linvel, self.object_angvel),
                moving_body(self.block_pose, self.block_linvel, self.block_angvel),
                torch.zeros(self.num_envs, PADDING),
            ),
            dim=-1,
        )

    def gaps(self) -> tuple[Tensor, Tensor]:
        """Returns the distances (m) of the left cube from the upper place and of the right cube from the lower one."""
        return (
            torch.norm(torch.tensor(UPPER) - self.block_left_handle_pos, dim=-1),
            torch.norm(torch.tensor(LOWER) - self.block_right_handle_pos, dim=-1),
        )

    def stacked(self) -> Tensor:
        """Returns 50 (0.05 - height error of the left cube) where both cubes are near their places, else 0."""
        upper, lower = self.gaps()
        error = (UPPER[2] - self.block_left_handle_pos[:, 2]).abs()
        return torch.where((upper < NEAR) & (lower < NEAR), 50.0 * (0.05 - error), 0.0)

    def succeeded(self) -> Tensor:
        """Returns where the cubes are stacked, with a height error below 3 cm."""
        return self.stacked() > 1.0

    def human_reward(self) -> Tensor:
        """Returns 1.5 minus both reaches, plus 2 (0.24 - both gaps) with both hands near, plus the stack term."""
        right, left = self.reaches()
        upper, lower = self.gaps()
        carried = torch.where((right < 0.5) & (left < 0.5), 2.0 * (0.24 - upper - lower), 0.0)
        return 1.5 - right - left + carried + self.stacked()
