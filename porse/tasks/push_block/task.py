"""PushBlock: each hand pushes its cube to a goal.

As in the original, an episode in which the left cube arrives first is worth a half for good. `goal_states` is the state of the
right cube's goal, since `object_pos` is the right cube; what it holds in the original is not known.
"""

from typing import ClassVar

import mujoco
import torch
from torch import Tensor

from porse.tasks import objects
from porse.tasks.free_hands import Handle
from porse.tasks.hand_observations import free_hands, moving_body
from porse.tasks.hand_variables import (
    body_variables,
    free_hand_variables,
    goal_states_variable,
    point_variables,
    root_variable,
)
from porse.tasks.handle_task import HandleTask
from porse.variables import Variable

FRICTION = 0.75
NEAR = 0.1
LEFT_GOAL = (-0.2, -0.2, 0.625)
RIGHT_GOAL = (-0.2, 0.2, 0.625)
PADDING = 5
"""Entries of the original's observations that it never writes."""


class PushBlock(HandleTask):
    """Push both cubes to their goals."""

    NAME: ClassVar[str] = "PushBlock"
    DESCRIPTION: ClassVar[str] = (
        "two shadow hands each reach for a block on a table and push it to its goal; this is a relatively simple task"
    )
    STARTS: ClassVar[str] = "both cubes stand on the table, each 0.2 m from its goal"
    ENDS: ClassVar[str] = "as soon as the distances of one hand's five fingertips from its handle sum to 1.2 m or more"
    FITNESS: ClassVar[str] = (
        "the mean credit of the episodes: 1 where both cubes were within 10 cm of their goals at once, but 0.5 "
        "where the left one was there first alone, and 0 where it never was"
    )
    NUM_OBSERVATIONS: ClassVar[int] = 428
    EPISODE_LENGTH: ClassVar[int] = 125
    TIME_LIMIT: ClassVar[int] = 125
    OBJECT_BODIES: ClassVar[tuple[str, ...]] = ("object", "block", "left_goal", "right_goal", "table")
    ACTORS: ClassVar[tuple[str, ...]] = OBJECT_BODIES
    BODIES: ClassVar[tuple[tuple[str, str], ...]] = (("object", "object"), ("goal", "right_goal"))
    HANDLES: ClassVar[tuple[Handle, ...]] = (
        Handle("block_right_handle", "object"),
        Handle("block_left_handle", "block"),
        Handle("left_goal", "left_goal"),
        Handle("right_goal", "right_goal"),
    )
    RIGHT_HANDLE: ClassVar[str] = "block_right_handle"
    LEFT_HANDLE: ClassVar[str] = "block_left_handle"
    LOST: ClassVar[float] = 1.2
    VARIABLES: ClassVar[tuple[Variable, ...]] = (
        *body_variables("object", "the right cube"),
        *point_variables("block_right_handle", "the right cube"),
        *point_variables("block_left_handle", "the left cube"),
        *point_variables("left_goal", "the goal of the left cube"),
        *point_variables("right_goal", "the goal of the right cube"),
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
        objects.add_table(spec, (1.0, 1.0, 0.6), friction=0.5)
        objects.add_block(spec, "object", (0.0, 0.2, 0.625), FRICTION)
        objects.add_block(spec, "block", (0.0, -0.2, 0.625), FRICTION)
        objects.add_goal(spec, LEFT_GOAL, name="left_goal")
        objects.add_goal(spec, RIGHT_GOAL, name="right_goal")
        for name in ("left_goal", "right_goal"):
            site = spec.site(name)
            site.type, site.size, site.material = mujoco.mjtGeom.mjGEOM_BOX, [0.025, 0.025, 0.025], "cube"
            site.rgba = [1.0, 1.0, 1.0, 0.4]

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
