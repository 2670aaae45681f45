"""PushBlock: each hand pushes its cube to a goal.

As in the original, an episode in which the left cube arrives first is worth a half for good. `goal_states` is the state of the
right cube's goal, since `object_pos` is the right cube; what it holds in the original is not known.
"""

import mujoco
import torch
from torch import Tensor

from porse.tasks.hands.free_hands import Handle, handle_variables
from porse.tasks.hands.handles import TableTask, hand_lost
from porse.tasks.hands.observations import free_hands, moving_body
from porse.tasks.hands.variables import (
    body_variables,
    free_hand_variables,
    goal_states_variable,
    root_variable,
)
from porse.tasks.push_block import scene

NEAR = 0.1
PADDING = 5
"""Entries of the original's observations that it never writes."""


class PushBlock(TableTask):
    """Push both cubes to their goals."""

    NAME = "PushBlock"
    DESCRIPTION = (
        "two shadow hands each reach for a block on a table and push it to its goal; this is a relatively simple task"
    )
    STARTS = "both cubes stand on the table, each 0.2 m from its goal"
    LOST = 1.2
    ENDS = hand_lost(LOST)
    FITNESS = (
        "the mean credit of the episodes: 1 where both cubes were within 10 cm of their goals at once, but 0.5 "
        "where the left one was there first alone, and 0 where it never was"
    )
    NUM_OBSERVATIONS = 428
    OBJECT_BODIES = ("object", "block", "left_goal", "right_goal", "table")
    ACTORS = OBJECT_BODIES
    BODIES = (("object", "object"), ("goal", "right_goal"))
    HANDLES = (
        Handle("block_right_handle", "object", "the right cube", hand="right"),
        Handle("block_left_handle", "block", "the left cube", hand="left"),
        Handle("left_goal", "left_goal", "the goal of the left cube"),
        Handle("right_goal", "right_goal", "the goal of the right cube"),
    )
    VARIABLES = (
        *body_variables("object", "the right cube"),
        *handle_variables(HANDLES),
        goal_states_variable("the goal of the right cube"),
        *free_hand_variables(NUM_OBSERVATIONS, OBJECT_BODIES, ACTORS),
        root_variable("block_indices", "the left cube"),
    )

    block_right_handle_pos: Tensor
    block_left_handle_pos: Tensor
    left_goal_pos: Tensor
    right_goal_pos: Tensor

    @classmethod
    def add_objects(cls, spec: mujoco.MjSpec) -> None:
        """Adds the table, the cubes on it, and their goals."""
        scene.add_objects(spec)

    def compute_observations(self) -> Tensor:
        """Returns the observations, `(num_envs, 428)`: two hands, the right cube, both cubes, both goals, five zeros."""
        return torch.cat(
            (
                free_hands(self, self.right_hand_pos, self.left_hand_pos),
                moving_body(self.object_pose, self.object_linvel, self.object_angvel),
                self.block_right_handle_pos,
                self.block_left_handle_pos,
                self.left_goal_pos,
                self.right_goal_pos,
                torch.zeros(self.num_envs, PADDING),
            ),
            dim=-1,
        )

    def gaps(self) -> tuple[Tensor, Tensor]:
        """Returns the distances (m) of the left and the right cube from their goals, `(num_envs,)` each."""
        return (
            torch.norm(self.left_goal_pos - self.block_left_handle_pos, dim=-1),
            torch.norm(self.right_goal_pos - self.block_right_handle_pos, dim=-1),
        )

    def succeeded(self) -> Tensor:
        """Returns where both cubes are within 10 cm of their goals."""
        left, right = self.gaps()
        return (left <= NEAR) & (right <= NEAR)

    def credit(self) -> Tensor:
        """Returns 1 where both cubes have arrived, 1/2 where only the left one has, else 0, `(num_envs,)`."""
        left, right = self.gaps()
        return torch.where(left <= NEAR, torch.where(right <= NEAR, 1.0, 0.5), 0.0)

    def _count(self) -> None:
        # As in the original, the first credit of an episode stays, so a half never becomes a whole.
        self.successes = torch.where(self.successes == 0.0, self.credit(), self.successes)

    def sparse_reward(self) -> Tensor:
        """Returns the credit of each step."""
        return self.credit()

    def human_reward(self) -> Tensor:
        """Returns (1.2 - reach) of each hand plus 5 - 5 times both distances from the goals."""
        right, left = self.reaches()
        left_gap, right_gap = self.gaps()
        return (1.2 - right) + (1.2 - left) + 5.0 - 5.0 * left_gap - 5.0 * right_gap
