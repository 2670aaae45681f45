"""Pen: two hands pull the cap off a pen."""

import mujoco
import torch
from torch import Tensor

from porse.tasks.hands.free_hands import Handle, handle_variables
from porse.tasks.hands.handles import TableTask, hand_lost
from porse.tasks.hands.observations import free_hands, moving_body
from porse.tasks.hands.variables import body_variables, free_hand_variables, goal_variables
from porse.tasks.pen import scene

OPEN = 0.3
"""Distance (m) between the handles above which the pen is open; closed it is 0.17 m."""


class Pen(TableTask):
    """Open the pen."""

    NAME = "Pen"
    DESCRIPTION = "two shadow hands open the cap of a pen: each hand holds one end, and they pull the pen apart"
    STARTS = "the pen lies shut on the table, its handles 0.17 m apart"
    LOST = 1.5
    ENDS = hand_lost(LOST)
    FITNESS = "the share of episodes in which the handles of the pen once were more than 0.3 m apart"
    NUM_OBSERVATIONS = 417
    PER_ENV_STATISTIC = True
    OBJECT_BODIES = ("object", "link_1", "link_0", "goal", "table")
    HANDLES = (
        Handle("pen_right_handle", "link_0", "the cap, for the right hand", (0.0, -0.1, 0.0), hand="right"),
        Handle("pen_left_handle", "link_1", "the barrel, for the left hand", (0.0, 0.07, 0.0), hand="left"),
    )
    VARIABLES = (
        *body_variables("object", "the pen"),
        *goal_variables("goal", "the goal (10 m above the pen's own place)"),
        *handle_variables(HANDLES),
        *free_hand_variables(NUM_OBSERVATIONS, OBJECT_BODIES, TableTask.ACTORS),
    )

    pen_right_handle_pos: Tensor
    pen_left_handle_pos: Tensor

    @classmethod
    def add_objects(cls, spec: mujoco.MjSpec) -> None:
        """Adds the table, the pen with its cap, and the goal."""
        scene.add_objects(spec)

    def compute_observations(self) -> Tensor:
        """Returns the observations, `(num_envs, 417)`: two hands, the pen, its ends."""
        return torch.cat(
            (
                free_hands(self, self.right_hand_pos, self.left_hand_pos),
                moving_body(self.object_pose, self.object_linvel, self.object_angvel),
                self.pen_right_handle_pos,
                self.pen_left_handle_pos,
            ),
            dim=-1,
        )

    def length(self) -> Tensor:
        """Returns the distance (m) between the handles, `(num_envs,)`."""
        return torch.norm(self.pen_right_handle_pos - self.pen_left_handle_pos, dim=-1)

    def succeeded(self) -> Tensor:
        """Returns where the handles are more than 30 cm apart."""
        return self.length() > OPEN

    def human_reward(self) -> Tensor:
        """Returns 5 l - 0.8 with both hands near, plus exp(-10 reach) for each hand."""
        right, left = self.reaches()
        opened = torch.where((right < 0.75) & (left < 0.75), 5.0 * self.length() - 0.8, 0.0)
        return opened + torch.exp(-10.0 * right) + torch.exp(-10.0 * left)
