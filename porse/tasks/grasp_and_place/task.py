"""GraspAndPlace: a cube is picked up and put into a bucket."""

import mujoco
import torch
from torch import Tensor

from porse.tasks.grasp_and_place import scene
from porse.tasks.hands.free_hands import Handle, handle_variables
from porse.tasks.hands.handles import TableTask, hand_lost
from porse.tasks.hands.observations import free_hands, moving_body
from porse.tasks.hands.variables import (
    body_variables,
    free_hand_variables,
    goal_states_variable,
    point_variables,
    root_variable,
)

NEAR = 0.2
"""Distance (m) between cube and bucket below which the task is solved."""


class GraspAndPlace(TableTask):
    """Put the cube into the bucket."""

    NAME = "GraspAndPlace"
    DESCRIPTION = (
        "two shadow hands pick up an object from a table, while one of them holds a bucket, and put the "
        "object into the bucket"
    )
    STARTS = "the bucket and the cube stand on the table, 0.4 m apart"
    LOST = 1.5
    ENDS = hand_lost(LOST)
    FITNESS = "the share of episodes in which the cube once was within 20 cm of the bucket"
    NUM_OBSERVATIONS = 425
    EPISODE_LENGTH = TIME_LIMIT = 500
    OBJECT_BODIES = ("object", "link_1", "block", "goal", "table")
    ACTORS = ("object", "block", "goal", "table")
    HANDLES = (
        Handle("block_right_handle", "link_1", "the bucket, for the right hand", hand="right"),
        Handle("block_left_handle", "block", "the cube, for the left hand", hand="left"),
    )
    VARIABLES = (
        *body_variables("object", "the bucket"),
        *point_variables("goal", "the goal (10 m above the bucket's own place)"),
        goal_states_variable("the goal (10 m above the bucket's own place)"),
        *handle_variables(HANDLES),
        *free_hand_variables(NUM_OBSERVATIONS, OBJECT_BODIES, ACTORS),
        root_variable("block_indices", "the cube"),
    )

    block_right_handle_pos: Tensor
    block_right_handle_rot: Tensor
    block_left_handle_pos: Tensor
    block_left_handle_rot: Tensor

    @classmethod
    def add_objects(cls, spec: mujoco.MjSpec) -> None:
        """Adds the table, the bucket, the cube, and the goal; both start on the table, the original's inside it."""
        scene.add_objects(spec)

    def compute_observations(self) -> Tensor:
        """Returns the observations, `(num_envs, 425)`: two hands, the bucket, then bucket and cube as handles."""
        return torch.cat(
            (
                free_hands(self, self.right_hand_pos, self.left_hand_pos),
                moving_body(self.object_pose, self.object_linvel, self.object_angvel),
                self.block_right_handle_pos,
                self.block_right_handle_rot,
                self.block_left_handle_pos,
                self.block_left_handle_rot,
            ),
            dim=-1,
        )

    def gap(self) -> Tensor:
        """Returns the distance (m) between cube and bucket, `(num_envs,)`."""
        return torch.norm(self.block_right_handle_pos - self.block_left_handle_pos, dim=-1)

    def succeeded(self) -> Tensor:
        """Returns where the cube is within 20 cm of the bucket."""
        return self.gap() < NEAR

    def human_reward(self) -> Tensor:
        """Returns exp(-10 reach) for each hand plus 2 exp(-10 gap)."""
        right, left = self.reaches()
        return torch.exp(-10.0 * right) + torch.exp(-10.0 * left) + 2.0 * torch.exp(-10.0 * self.gap())
