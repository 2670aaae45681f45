"""Over: the right hand throws an egg, and the left hand catches it. Both hands are fixed, palms up, face to face."""

import math
from typing import ClassVar

import torch
from torch import Tensor

from porse.tasks.hands import shadow
from porse.tasks.hands.observations import fixed_hands, goal_and_turn, hand_observations, moving_body
from porse.tasks.hands.toss import CatchTask, catch_variables
from porse.variables import Variable


class Over(CatchTask):
    """Throw from the right hand to the left one, with fixed bases."""

    NAME: ClassVar[str] = "Over"
    DESCRIPTION: ClassVar[str] = (
        "two shadow hands with palms facing upwards stand opposite each other, with fixed bases; an object starts above "
        "the right hand, which must throw it, since it can neither be rolled nor handed over, so that the left hand "
        "catches it and holds it at the goal"
    )
    STARTS: ClassVar[str] = (
        "the object is above the right hand, within 1 cm of one place on each axis, in a random orientation, and "
        "the goal is at one place above the left hand, in another one; the joints of the hands are drawn at "
        "random, the same for both"
    )
    ENDS: ClassVar[str] = "as soon as the object is at 0.2 m or lower"
    NUM_OBSERVATIONS: ClassVar[int] = 398
    NUM_ACTIONS: ClassVar[int] = 40
    EPISODE_LENGTH: ClassVar[int] = 75
    TIME_LIMIT: ClassVar[int] = 75
    VARIABLES: ClassVar[tuple[Variable, ...]] = catch_variables(NUM_ACTIONS, NUM_OBSERVATIONS)
    OBSERVATION_HELPERS = (hand_observations, fixed_hands, moving_body, goal_and_turn)
    RIGHT: ClassVar[shadow.BasePose] = shadow.BasePose((0.0, 0.0, 0.5), (0.0, 0.0, 0.0))
    LEFT: ClassVar[shadow.BasePose] = shadow.BasePose((0.0, -1.0, 0.5), (0.0, 0.0, math.pi))
    FREE: ClassVar[bool] = False
    JOINT_NOISE: ClassVar[float] = 0.2
    EGG_START: ClassVar[tuple[float, float, float]] = (0.0, -0.39, 0.54)
    EGG_NOISE: ClassVar[float] = 0.01
    GOAL: ClassVar[tuple[float, float, float]] = (0.0, -0.64, 0.54)
    DROPPED: ClassVar[float] = 0.2
    DISTANCE_SCALE: ClassVar[float] = 50.0

    def compute_observations(self) -> Tensor:
        """Returns the observations, `(num_envs, 398)`: two hands of 187, then the egg and its goal."""
        return torch.cat(
            (
                fixed_hands(self),
                moving_body(self.object_pose, self.object_linvel, self.object_angvel),
                goal_and_turn(self.object_pose, self.goal_pose),
            ),
            dim=-1,
        )  # fmt: skip
