"""BottleCap: one hand cradles a bottle, and the other pulls its cap off.

Departures: the bottle carries most of its mass in its foot, since it would otherwise tip out of the palm within a
quarter of a second. Its weight sinks and tilts the free hand under it, so that zero action ends every episode after 100
steps, when the cap's place is 11 cm lower; the left hand has to push up. The observations end with two zeros, because the paper says 422 where the original has 420.
"""

import math

import mujoco
import torch
from torch import Tensor

from porse.tasks.bottle_cap import scene
from porse.tasks.hands import shadow
from porse.tasks.hands.free_hands import FreeHandTask, Handle
from porse.tasks.hands.observations import free_hands, moving_body
from porse.tasks.hands.variables import body_variables, free_hand_variables, goal_variables
from porse.variables import Variable

OPEN = 0.03

DROPPED = 0.5
CAP_LOST = 0.5
BOTTLE_LOST = 0.2
PADDING = 2
"""Zeros that widen the 420 observations of the original's code to the 422 that the paper states."""


class BottleCap(FreeHandTask):
    """Open the bottle."""

    NAME = "BottleCap"
    DESCRIPTION = "one shadow hand holds a bottle, and the other opens its cap without letting the bottle fall"
    STARTS = "the bottle, shut, lies in the left hand, and the right hand is above its cap"
    ENDS = (
        "as soon as the place of the cap on the bottle (bottle_cap_pos) is at 0.5 m or lower or 0.5 m or more "
        "from the right palm, or the bottle is 0.2 m or more from the left palm"
    )
    FITNESS = "the share of episodes in which the cap once was more than 3 cm from the bottle's origin; shut it is 1 cm"
    NUM_OBSERVATIONS = 422
    EPISODE_LENGTH = TIME_LIMIT = 125
    FORCE_SCALE = 0.1
    TORQUE_SCALE = 0.1
    RIGHT = shadow.BasePose((0.0, -1.05, 0.5), (0.5, math.pi, math.pi))
    LEFT = shadow.BasePose((0.0, -0.25, 0.45), (0.0, 0.87, 0.0))
    PER_ENV_STATISTIC = True
    OBJECT_BODIES = ("object", "link_1", "helper", "link_0", "goal", "table")
    ACTORS = ("object", "goal", "table")
    HANDLES = (
        Handle("bottle", "object", "the bottle"),
        Handle("bottle_cap", "object", "the place of the cap", (0.0, 0.0, 0.15)),
        Handle("cap", "link_0", "the cap"),
    )
    VARIABLES = (
        *body_variables("object", "the bottle"),
        *goal_variables("goal", "the goal (1 m above the bottle's own place)"),
        Variable("bottle_pos", "tensor", (3,), "m", "world", "position of the bottle"),
        Variable("bottle_cap_pos", "tensor", (3,), "m", "world", "point of the bottle where the cap sits"),
        Variable("bottle_cap_up", "tensor", (3,), "m", "world", "position of the cap, which rises from the bottle"),
        *free_hand_variables(NUM_OBSERVATIONS, OBJECT_BODIES, ACTORS, fingers=("right",)),
    )

    bottle_pos: Tensor
    bottle_cap_pos: Tensor
    bottle_cap_up: Tensor
    cap_pos: Tensor

    @classmethod
    def add_objects(cls, spec: mujoco.MjSpec) -> None:
        """Adds the table far below, the bottle with its cap, and the goal."""
        scene.add_objects(spec)

    def compute_observations(self) -> Tensor:
        """Returns the observations, `(num_envs, 422)`: two hands, the bottle, its cap, two zeros."""
        return torch.cat(
            (
                free_hands(self, self.right_hand_pos, self.left_hand_pos),
                moving_body(self.object_pose, self.object_linvel, self.object_angvel),
                self.bottle_pos,
                self.bottle_cap_pos,
                self.bottle_cap_up,
                torch.zeros(self.num_envs, PADDING),
            ),
            dim=-1,
        )

    def _default_joints(self) -> Tensor:
        joints = torch.zeros(len(shadow.JOINTS))
        for name, angle in (("THJ4", -1.04), ("THJ3", 1.2), ("THJ0", -1.57)):
            joints[shadow.JOINTS.index(name)] = angle
        return joints

    def _name_measurements(self) -> None:
        super()._name_measurements()
        self.bottle_cap_up = self.cap_pos

    def lift(self) -> Tensor:
        """Returns the distance (m) of the cap from the bottle's origin, `(num_envs,)`: 0.0103 closed."""
        return torch.norm(self.bottle_cap_up - self.bottle_pos, dim=-1)

    def succeeded(self) -> Tensor:
        """Returns where the cap is more than 3 cm up."""
        return self.lift() > OPEN

    def failed(self) -> Tensor:
        """Returns where the bottle fell or a palm is far from it."""
        cap = torch.norm(self.bottle_cap_pos - self.right_hand_pos, dim=-1)
        bottle = torch.norm(self.bottle_pos - self.left_hand_pos, dim=-1)
        return (self.bottle_cap_pos[:, 2] <= DROPPED) | (cap >= CAP_LOST) | (bottle >= BOTTLE_LOST)

    def human_reward(self) -> Tensor:
        """Returns 2 minus the right hand's reach and the left palm's distance, plus 30 lift with the hand near."""
        right = self.reach("right", self.bottle_cap_pos)
        left = torch.norm(self.bottle_pos - self.left_hand_pos, dim=-1)
        return 2.0 - right - left + torch.where(right <= 0.3, 30.0 * self.lift(), 0.0)
