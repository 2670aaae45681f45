"""Pen: two hands pull the cap off a pen."""

import math
from typing import ClassVar

import mujoco
import torch
from torch import Tensor

from porse.tasks import objects, shadow
from porse.tasks.free_hands import FreeHandTask, Handle, finger_variables, free_hands, palm_variables
from porse.tasks.hands import body_variables, goal_variables, hand_observations, point_variables, two_hand_variables
from porse.variables import Variable

LOST = 1.5
OPEN = 0.3
"""Distance (m) between the handles above which the pen is open; closed it is 0.17 m."""

START_HEIGHT = 0.618
"""The pen lies on the table; the original's starts 1.3 cm inside it."""


class Pen(FreeHandTask):
    """Open the pen."""

    NAME: ClassVar[str] = "Pen"
    DESCRIPTION: ClassVar[str] = (
        "two shadow hands open the cap of a pen: each hand holds one end, and they pull the pen apart"
    )
    NUM_OBSERVATIONS: ClassVar[int] = 417
    NUM_ACTIONS: ClassVar[int] = 52
    EPISODE_LENGTH: ClassVar[int] = 125
    TIME_LIMIT: ClassVar[int] = 125
    FORCE_SCALE: ClassVar[float] = 0.5
    TORQUE_SCALE: ClassVar[float] = 0.1
    RIGHT: ClassVar[shadow.BasePose] = shadow.BasePose((0.55, 0.2, 0.8), (math.pi, 0.0, 1.57))
    LEFT: ClassVar[shadow.BasePose] = shadow.BasePose((0.55, -0.2, 0.8), (math.pi, 0.0, 1.57))
    PER_ENV_STATISTIC: ClassVar[bool] = True
    OBJECT_BODIES: ClassVar[tuple[str, ...]] = ("object", "link_1", "link_0", "goal", "table")
    ACTORS: ClassVar[tuple[str, ...]] = ("object", "goal", "table")
    HANDLES: ClassVar[tuple[Handle, ...]] = (
        Handle("pen_right_handle", "link_0", (0.0, -0.1, 0.0)),
        Handle("pen_left_handle", "link_1", (0.0, 0.07, 0.0)),
    )
    VARIABLES: ClassVar[tuple[Variable, ...]] = (
        *body_variables("object", "the pen"),
        *goal_variables("goal", "the goal (the pen's own place)"),
        *point_variables("pen_right_handle", "the cap, for the right hand"),
        *point_variables("pen_left_handle", "the barrel, for the left hand"),
        *palm_variables(),
        *finger_variables("right", "left"),
        *two_hand_variables(NUM_ACTIONS, NUM_OBSERVATIONS, len(OBJECT_BODIES), len(ACTORS)),
    )
    OBSERVATION_HELPERS = (hand_observations, free_hands)

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
        objects.add_goal(spec, (0.0, 0.0, START_HEIGHT), (1.57, 1.57, 0.0))

    def compute_observations(self) -> Tensor:
        """Returns the observations, `(num_envs, 417)`: two hands, the pen, its ends."""
        return torch.cat(
            (
                free_hands(self, self.right_hand_pos, self.left_hand_pos),
                self.object_pose,
                self.object_linvel,
                0.2 * self.object_angvel,
                self.pen_right_handle_pos,
                self.pen_left_handle_pos,
            ),
            dim=-1,
        )

    def reaches(self) -> tuple[Tensor, Tensor]:
        """Returns how far (m, sums over the fingers) each hand is from its end of the pen, `(num_envs,)` each."""
        return self.reach("right", self.pen_right_handle_pos), self.reach("left", self.pen_left_handle_pos)

    def length(self) -> Tensor:
        """Returns the distance (m) between the handles, `(num_envs,)`."""
        return torch.norm(self.pen_right_handle_pos - self.pen_left_handle_pos, dim=-1)

    def succeeded(self) -> Tensor:
        """Returns where the handles are more than 30 cm apart."""
        return self.length() > OPEN

    def failed(self) -> Tensor:
        """Returns where a hand is lost."""
        right, left = self.reaches()
        return (right >= LOST) | (left >= LOST)

    def human_reward(self) -> Tensor:
        """Returns 5 l - 0.8 with both hands near, plus exp(-10 reach) for each hand."""
        right, left = self.reaches()
        opened = torch.where((right < 0.75) & (left < 0.75), 5.0 * self.length() - 0.8, 0.0)
        return opened + torch.exp(-10.0 * right) + torch.exp(-10.0 * left)
