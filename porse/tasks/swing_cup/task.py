"""SwingCup: two hands hold a cup by its two handles and turn it around.

The originals have two configurations. These are Eureka's numbers, as in the paper's pipeline: 150 steps, a turn that is worth
1, forces of 833 N (transition scale 0.5). Those of Bi-DexHands are 300 steps, 5 and 167 N (0.1).
"""

import math

import mujoco
import torch
from torch import Tensor

from porse.sim import rotations
from porse.tasks.hands import shadow
from porse.tasks.hands.free_hands import Handle, handle_variables
from porse.tasks.hands.handles import TableTask
from porse.tasks.hands.observations import free_hands, moving_body
from porse.tasks.hands.variables import body_variables, free_hand_variables, goal_variables
from porse.tasks.swing_cup import scene

ALIGNED = 0.785
"""Angle (rad) from the goal orientation below which the cup counts as turned."""


DROPPED = 0.3


class SwingCup(TableTask):
    """Turn the cup by half a turn."""

    NAME = "SwingCup"
    DESCRIPTION = "two shadow hands hold a cup by its two handles, one each, and swing it together by half a turn"
    STARTS = "the cup stands on the table, turned by half a turn from its goal"
    ENDS = "as soon as the cup is at 0.3 m or lower"
    FITNESS = "the share of episodes in which the cup once was within 0.785 rad of its goal's orientation"
    NUM_OBSERVATIONS = 417
    EPISODE_LENGTH = TIME_LIMIT = 150
    RIGHT = shadow.BasePose((0.35, 0.2, 0.8), (math.pi, 1.57, 1.57))
    LEFT = shadow.BasePose((0.35, -0.2, 0.8), (math.pi, -1.57, 1.57))
    OBJECT_BODIES = ("object", "link_1", "link_0", "link_2", "goal", "table")
    HANDLES = (
        Handle("cup_right_handle", "object", "the handle for the right hand", (0.062, 0.0, 0.0), hand="right"),
        Handle("cup_left_handle", "link_1", "the handle for the left hand", (0.0, 0.0, 0.06), hand="left"),
    )
    VARIABLES = (
        *body_variables("object", "the cup"),
        *goal_variables("goal", "the goal: the cup turned by half a turn, 1 m above its start; only the turn counts"),
        *handle_variables(HANDLES),
        *free_hand_variables(NUM_OBSERVATIONS, OBJECT_BODIES, TableTask.ACTORS),
    )

    cup_right_handle_pos: Tensor
    cup_left_handle_pos: Tensor

    @classmethod
    def add_objects(cls, spec: mujoco.MjSpec) -> None:
        """Adds the table, the cup with its lid and two handles, and the goal."""
        scene.add_objects(spec)

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
