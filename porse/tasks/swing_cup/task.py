"""SwingCup: two hands hold a cup by its two handles and turn it around.

The originals have two configurations. These are Eureka's numbers, as in the paper's pipeline: 150 steps, a turn that is worth
1, forces of 833 N (transition scale 0.5). Those of Bi-DexHands are 300 steps, 5 and 167 N (0.1).
"""

import math
from typing import ClassVar

import mujoco
import torch
from torch import Tensor

from porse.sim import rotations
from porse.tasks import dress, objects, shadow
from porse.tasks.free_hands import Handle
from porse.tasks.hand_observations import free_hands, moving_body
from porse.tasks.hand_variables import body_variables, free_hand_variables, goal_variables, point_variables
from porse.tasks.handle_task import HandleTask
from porse.variables import Variable

FRICTION = 0.75
ALIGNED = 0.785
"""Angle (rad) from the goal orientation below which the cup counts as turned."""

GOAL_LIFT = 1.0
"""Height (m) of the goal above the cup's start; only its orientation counts."""

DROPPED = 0.3
START_HEIGHT = 0.685
"""The cup stands on the table; the original's starts 8 cm inside it and is pushed out."""


class SwingCup(HandleTask):
    """Turn the cup by half a turn."""

    NAME: ClassVar[str] = "SwingCup"
    DESCRIPTION: ClassVar[str] = (
        "two shadow hands hold a cup by its two handles, one each, and swing it together by half a turn"
    )
    STARTS: ClassVar[str] = "the cup stands on the table, turned by half a turn from its goal"
    ENDS: ClassVar[str] = "as soon as the cup is at 0.3 m or lower"
    FITNESS: ClassVar[str] = (
        "the share of episodes in which the cup once was within 0.785 rad of its goal's orientation"
    )
    NUM_OBSERVATIONS: ClassVar[int] = 417
    EPISODE_LENGTH: ClassVar[int] = 150
    TIME_LIMIT: ClassVar[int] = 150
    RIGHT: ClassVar[shadow.BasePose] = shadow.BasePose((0.35, 0.2, 0.8), (math.pi, 1.57, 1.57))
    LEFT: ClassVar[shadow.BasePose] = shadow.BasePose((0.35, -0.2, 0.8), (math.pi, -1.57, 1.57))
    OBJECT_BODIES: ClassVar[tuple[str, ...]] = ("object", "link_1", "link_0", "link_2", "goal", "table")
    ACTORS: ClassVar[tuple[str, ...]] = ("object", "goal", "table")
    HANDLES: ClassVar[tuple[Handle, ...]] = (
        Handle("cup_right_handle", "object", (0.062, 0.0, 0.0)),
        Handle("cup_left_handle", "link_1", (0.0, 0.0, 0.06)),
    )
    RIGHT_HANDLE: ClassVar[str] = "cup_right_handle"
    LEFT_HANDLE: ClassVar[str] = "cup_left_handle"
    VARIABLES: ClassVar[tuple[Variable, ...]] = (
        *body_variables("object", "the cup"),
        *goal_variables("goal", "the goal: the cup turned by half a turn, 1 m above its start; only the turn counts"),
        *point_variables("cup_right_handle", "the handle for the right hand"),
        *point_variables("cup_left_handle", "the handle for the left hand"),
        *free_hand_variables(NUM_OBSERVATIONS, OBJECT_BODIES, ACTORS),
    )

    cup_right_handle_pos: Tensor
    cup_left_handle_pos: Tensor

    @classmethod
    def add_objects(cls, spec: mujoco.MjSpec) -> None:
        """Adds the table, the cup with its lid and two handles, and the goal."""
        objects.add_table(spec, (0.3, 0.3, 0.6))
        base = objects.add_base(spec, "object", (0.0, 0.0, START_HEIGHT), (0.0, 0.0, 1.57))
        body = objects.add_link(base, "link_1")
        objects.add_rod(body, "cup", (0.0, -0.084, 0.0), (0.0, 0.07, 0.0), 0.045, 0.7, FRICTION)
        objects.add_box(body, "left_handle", (-0.012, -0.05, 0.04), (0.012, 0.05, 0.073), 0.04, FRICTION)
        lid = body.add_body(name="link_0", pos=[-0.0013, 0.0, -0.0062])
        objects.add_slide(lid, "lid", (0.0, 1.0, 0.0), (0.0, 0.108), damping=0.5, friction=0.2)
        objects.add_rod(lid, "lid", (0.0, 0.071, 0.0), (0.0, 0.082, 0.0), 0.045, 0.05, FRICTION)
        handle = objects.add_link(base, "link_2")
        objects.add_box(handle, "right_handle", (-0.012, -0.05, -0.073), (0.012, 0.05, -0.04), 0.04, FRICTION)
        objects.add_goal(spec, (0.0, 0.0, START_HEIGHT), (0.0, 0.0, 1.5 * math.pi), lift=GOAL_LIFT)
        dress.dress_cup(spec)

    def compute_observations(self) -> Tensor:
        """Returns the observations, `(num_envs, 417)`: two hands, the cup, its handles."""
        return torch.cat(
            (
                free_hands(self, self.right_hand_pos, self.left_hand_pos),
                moving_body(self.object_pose, self.object_linvel, self.object_angvel),
                self.cup_right_handle_pos,
                self.cup_left_handle_pos,
            ),
            dim=-1,
        )

    def turn(self) -> Tensor:
        """Returns the angle (rad) between the cup and its goal, `(num_envs,)`."""
        return rotations.rotation_distance(self.object_rot, self.goal_rot)

    def succeeded(self) -> Tensor:
        """Returns where the cup is within 45 degrees of its goal orientation."""
        return self.turn() < ALIGNED

    def failed(self) -> Tensor:
        """Returns where the cup fell from the table."""
        return self.object_pos[:, 2] <= DROPPED

    def human_reward(self) -> Tensor:
        """Returns minus both reaches, plus 1 / (angle + 0.1) - 1 with both hands near."""
        right, left = self.reaches()
        aligned = 1.0 / (self.turn() + 0.1) - 1.0
        return -right - left + torch.where((right < 0.4) & (left < 0.4), aligned, 0.0)
