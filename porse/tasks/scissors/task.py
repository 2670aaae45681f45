"""Scissors: two hands open a pair of scissors that lies on a table."""

from typing import ClassVar

import mujoco
import torch
from torch import Tensor

from porse.sim.physics import Capacity
from porse.tasks.hands.free_hands import Handle, handle_variables
from porse.tasks.hands.handles import TableTask, hand_lost
from porse.tasks.hands.observations import free_hands, moving_body
from porse.tasks.hands.variables import body_variables, free_hand_variables, goal_variables
from porse.tasks.scissors import scene
from porse.variables import Variable

OPEN = -0.3
"""Angle (rad) of the scissors above which they count as open; closed is -0.597."""


class Scissors(TableTask):
    """Open the scissors."""

    NAME = "Scissors"
    DESCRIPTION = "two shadow hands open a pair of scissors: the hands reach for the two handles and spread them"
    STARTS = "the scissors lie shut on the table, at -0.59 rad"
    LOST = 1.75
    ENDS = hand_lost(LOST)
    FITNESS = "the share of episodes in which the scissors once were open beyond -0.3 rad"
    NUM_OBSERVATIONS = 417
    EPISODE_LENGTH = TIME_LIMIT = 150
    CAPACITY = Capacity(contacts=128, rows=512)
    OBJECT_BODIES = ("object", "link_1", "link_0", "goal", "table")
    HANDLES = (
        Handle("scissors_right_handle", "link_0", "the handle for the right hand", (0.2, 0.0, -0.1), hand="right"),
        Handle("scissors_left_handle", "link_1", "the handle for the left hand", (0.15, 0.0, 0.1), hand="left"),
    )
    START_JOINTS: ClassVar[dict[str, tuple[float, float]]] = {"scissors": (scene.CLOSED, 0.0)}
    VARIABLES = (
        *body_variables("object", "the scissors"),
        *goal_variables("goal", "the goal (10 m above the scissors' own place)"),
        *handle_variables(HANDLES),
        Variable("object_dof_pos", "tensor", (1,), "rad", "joint", "angle of the scissors: -0.597 closed, 0.4 wide"),
        *free_hand_variables(NUM_OBSERVATIONS, OBJECT_BODIES, TableTask.ACTORS),
    )

    scissors_right_handle_pos: Tensor
    scissors_left_handle_pos: Tensor
    object_dof_pos: Tensor

    @classmethod
    def add_objects(cls, spec: mujoco.MjSpec) -> None:
        """Adds the table, the scissors, and the goal."""
        scene.add_objects(spec)

    def compute_observations(self) -> Tensor:
        """Returns the observations, `(num_envs, 417)`: two hands, the scissors, their handles."""
        return torch.cat(
            (
                free_hands(self, self.right_hand_pos, self.left_hand_pos),
                moving_body(self.object_pose, self.object_linvel, self.object_angvel),
                self.scissors_right_handle_pos,
                self.scissors_left_handle_pos,
            ),
            dim=-1,
        )

    def _name_measurements(self) -> None:
        super()._name_measurements()
        self.object_dof_pos = self.joint_position("scissors").unsqueeze(-1)

    def opening(self) -> Tensor:
        """Returns five times the angle (rad) opened since the start, where both hands are near, else 0."""
        right, left = self.reaches()
        near = (right < 0.7) & (left < 0.7)
        return torch.where(near, 5.0 * (0.59 + self.object_dof_pos[:, 0]), 0.0)

    def succeeded(self) -> Tensor:
        """Returns where the scissors are open."""
        return self.object_dof_pos[:, 0] > OPEN

    def failed(self) -> Tensor:
        """Returns where the scissors were closed further or a hand is lost."""
        return (self.opening() < -0.5) | super().failed()

    def human_reward(self) -> Tensor:
        """Returns 2 + 5 * opening (with both hands near) minus both reaches."""
        right, left = self.reaches()
        return 2.0 + self.opening() - right - left
