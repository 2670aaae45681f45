"""LiftUnderarm: two hands lift a pot by its handles.

Departure: the pot's friction is 2, the mean of the original's 3 and a hand's 1.
"""

import math

import mujoco
import torch
from torch import Tensor

from porse.tasks.hands import shadow
from porse.tasks.hands.free_hands import FreeHandTask, Handle
from porse.tasks.hands.observations import free_hands, moving_body
from porse.tasks.hands.variables import body_variables, free_hand_variables, goal_variables
from porse.tasks.lift_underarm import scene
from porse.variables import Variable

NEAR = 0.05
DROPPED = 0.3
LOST = 0.2


class LiftUnderarm(FreeHandTask):
    """Lift the pot."""

    NAME = "LiftUnderarm"
    DESCRIPTION = (
        "two shadow hands grasp the two handles of a pot and lift it together to the designated place above the table"
    )
    STARTS = "the pot stands on the table, with a hand, palm up, beside each handle; its goal is 0.384 m above it"
    ENDS = "as soon as the pot is at 0.3 m or lower, or a palm is 20 cm or more from its handle"
    FITNESS = "the share of episodes in which the pot once was within 5 cm of its goal"
    NUM_OBSERVATIONS = 417
    EPISODE_LENGTH = TIME_LIMIT = 500
    FORCE_SCALE = 0.25
    TORQUE_SCALE = 1.0
    RIGHT = shadow.BasePose((0.0, 0.05, 0.45), (0.0, 0.0, 0.0))
    LEFT = shadow.BasePose((0.0, -1.25, 0.45), (0.0, 0.0, math.pi))
    OBJECT_BODIES = ("object", "link_1", "link_0", "goal", "table")
    ACTORS = ("object", "goal", "table")
    HANDLES = (
        Handle("pot_right_handle", "object", "the handle for the right hand", (0.0, 0.15, 0.06)),
        Handle("pot_left_handle", "object", "the handle for the left hand", (0.0, -0.15, 0.06)),
    )
    VARIABLES = (
        *body_variables("object", "the pot"),
        *goal_variables("goal", "the goal of the pot"),
        Variable("pot_right_handle_pos", "tensor", (3,), "m", "world", "position of the handle for the right hand"),
        Variable("pot_left_handle_pos", "tensor", (3,), "m", "world", "position of the handle for the left hand"),
        *free_hand_variables(NUM_OBSERVATIONS, OBJECT_BODIES, ACTORS, fingers=()),
    )

    pot_right_handle_pos: Tensor
    pot_left_handle_pos: Tensor

    @classmethod
    def add_objects(cls, spec: mujoco.MjSpec) -> None:
        """Adds the table, the pot with its lid, and the goal."""
        scene.add_objects(spec)

    def compute_observations(self) -> Tensor:
        """Returns the observations, `(num_envs, 417)`: two hands, the pot, its handles."""
        return torch.cat(
            (
                free_hands(self, self.right_hand_pos, self.left_hand_pos),
                moving_body(self.object_pose, self.object_linvel, self.object_angvel),
                self.pot_right_handle_pos,
                self.pot_left_handle_pos,
            ),
            dim=-1,
        )

    def distance(self) -> Tensor:
        """Returns the distance (m) of the pot from its goal, `(num_envs,)`."""
        return torch.norm(self.goal_pos - self.object_pos, dim=-1)

    def palm_distances(self) -> tuple[Tensor, Tensor]:
        """Returns the distances (m) of the palms from their handles, `(num_envs,)` each."""
        return (
            torch.norm(self.pot_right_handle_pos - self.right_hand_pos, dim=-1),
            torch.norm(self.pot_left_handle_pos - self.left_hand_pos, dim=-1),
        )

    def succeeded(self) -> Tensor:
        """Returns where the pot is within 5 cm of its goal."""
        return self.distance() < NEAR

    def failed(self) -> Tensor:
        """Returns where the pot fell or a palm is 20 cm from its handle."""
        right, left = self.palm_distances()
        return (self.object_pos[:, 2] <= DROPPED) | (right >= LOST) | (left >= LOST)

    def human_reward(self) -> Tensor:
        """Returns 0.2 minus both palm distances, plus 3 (0.385 - distance) with both palms near."""
        right, left = self.palm_distances()
        lifted = 3.0 * (0.385 - self.distance())
        return 0.2 - right - left + torch.where((right < 0.08) & (left < 0.08), lifted, 0.0)
