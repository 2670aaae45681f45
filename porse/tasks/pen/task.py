"""Pen: two hands pull the cap off a pen."""

from typing import ClassVar

import mujoco
import torch
from torch import Tensor

from porse.tasks import dress, objects
from porse.tasks.free_hands import Handle
from porse.tasks.hand_observations import free_hands, moving_body
from porse.tasks.hand_variables import body_variables, free_hand_variables, goal_variables, point_variables
from porse.tasks.handle_task import HandleTask
from porse.variables import Variable

OPEN = 0.3
"""Distance (m) between the handles above which the pen is open; closed it is 0.17 m."""

START_HEIGHT = 0.618
"""The pen lies on the table; the original's starts 1.3 cm inside it."""


class Pen(HandleTask):
    """Open the pen."""

    NAME: ClassVar[str] = "Pen"
    DESCRIPTION: ClassVar[str] = (
        "two shadow hands open the cap of a pen: each hand holds one end, and they pull the pen apart"
    )
    STARTS: ClassVar[str] = "the pen lies shut on the table, its handles 0.17 m apart"
    ENDS: ClassVar[str] = "as soon as the distances of one hand's five fingertips from its handle sum to 1.5 m or more"
    FITNESS: ClassVar[str] = "the share of episodes in which the handles of the pen once were more than 0.3 m apart"
    NUM_OBSERVATIONS: ClassVar[int] = 417
    EPISODE_LENGTH: ClassVar[int] = 125
    TIME_LIMIT: ClassVar[int] = 125
    PER_ENV_STATISTIC: ClassVar[bool] = True
    OBJECT_BODIES: ClassVar[tuple[str, ...]] = ("object", "link_1", "link_0", "goal", "table")
    ACTORS: ClassVar[tuple[str, ...]] = ("object", "goal", "table")
    HANDLES: ClassVar[tuple[Handle, ...]] = (
        Handle("pen_right_handle", "link_0", (0.0, -0.1, 0.0)),
        Handle("pen_left_handle", "link_1", (0.0, 0.07, 0.0)),
    )
    RIGHT_HANDLE: ClassVar[str] = "pen_right_handle"
    LEFT_HANDLE: ClassVar[str] = "pen_left_handle"
    LOST: ClassVar[float] = 1.5
    VARIABLES: ClassVar[tuple[Variable, ...]] = (
        *body_variables("object", "the pen"),
        *goal_variables("goal", "the goal (10 m above the pen's own place)"),
        *point_variables("pen_right_handle", "the cap, for the right hand"),
        *point_variables("pen_left_handle", "the barrel, for the left hand"),
        *free_hand_variables(NUM_OBSERVATIONS, OBJECT_BODIES, ACTORS),
    )

    pen_right_handle_pos: Tensor
    pen_left_handle_pos: Tensor

    @classmethod
    def add_objects(cls, spec: mujoco.MjSpec) -> None:
        """Adds the table, the pen with its cap, and the goal."""
        objects.add_table(spec, (0.5, 1.0, 0.6))
        base = objects.add_base(spec, "object", (0.0, 0.0, START_HEIGHT), (1.57, 1.57, 0.0))
        barrel = objects.add_link(base, "link_1")
        objects.add_box(barrel, "barrel", (-0.0105, -0.159, -0.0105), (0.0105, 0.2, 0.0105), 0.05)
        cap = barrel.add_body(name="link_0")
        objects.add_slide(cap, "cap", (0.0, -1.0, 0.0), (0.0, 0.492), damping=0.5, friction=0.1)
        objects.add_box(cap, "cap", (-0.0115, -0.172, -0.018), (0.0115, -0.041, 0.018), 0.03)
        objects.add_goal(spec, (0.0, 0.0, START_HEIGHT), (1.57, 1.57, 0.0), lift=objects.LIFT)
        dress.dress_pen(spec)

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
