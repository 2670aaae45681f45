"""GraspAndPlace: a cube is picked up and put into a bucket."""

from typing import ClassVar

import mujoco
import torch
from torch import Tensor

from porse.tasks import dress, objects
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

NEAR = 0.2
"""Distance (m) between cube and bucket below which the task is solved."""


class GraspAndPlace(HandleTask):
    """Put the cube into the bucket."""

    NAME: ClassVar[str] = "GraspAndPlace"
    DESCRIPTION: ClassVar[str] = (
        "two shadow hands pick up an object from a table, while one of them holds a bucket, and put the "
        "object into the bucket"
    )
    STARTS: ClassVar[str] = "the bucket and the cube stand on the table, 0.4 m apart"
    ENDS: ClassVar[str] = "as soon as the distances of one hand's five fingertips from its handle sum to 1.5 m or more"
    FITNESS: ClassVar[str] = "the share of episodes in which the cube once was within 20 cm of the bucket"
    NUM_OBSERVATIONS: ClassVar[int] = 425
    EPISODE_LENGTH: ClassVar[int] = 500
    TIME_LIMIT: ClassVar[int] = 500
    OBJECT_BODIES: ClassVar[tuple[str, ...]] = ("object", "link_1", "block", "goal", "table")
    ACTORS: ClassVar[tuple[str, ...]] = ("object", "block", "goal", "table")
    HANDLES: ClassVar[tuple[Handle, ...]] = (
        Handle("block_right_handle", "link_1"),
        Handle("block_left_handle", "block"),
    )
    RIGHT_HANDLE: ClassVar[str] = "block_right_handle"
    LEFT_HANDLE: ClassVar[str] = "block_left_handle"
    LOST: ClassVar[float] = 1.5
    VARIABLES: ClassVar[tuple[Variable, ...]] = (
        *body_variables("object", "the bucket"),
        *point_variables("goal", "the goal (10 m above the bucket's own place)"),
        goal_states_variable("the goal (10 m above the bucket's own place)"),
        *point_variables("block_right_handle", "the bucket, for the right hand"),
        *point_variables("block_left_handle", "the cube, for the left hand"),
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
        objects.add_table(spec, (1.0, 1.0, 0.6))
        base = objects.add_base(spec, "object", (0.0, 0.2, 0.654))
        tub = objects.add_link(base, "link_1")
        objects.add_tub(tub, "bucket", (-0.057, -0.053, -0.057), (0.057, 0.0445, 0.057), 0.008, up=1, mass=0.2)
        objects.add_block(spec, "block", (0.0, -0.2, 0.625))
        objects.add_goal(spec, (0.0, 0.2, 0.654), lift=objects.LIFT)
        dress.dress_bucket(spec, "link_1")

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
