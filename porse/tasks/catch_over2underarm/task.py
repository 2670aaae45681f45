"""CatchOver2Underarm: an upright hand throws an egg overarm to a hand that lies palm up."""

import math
from typing import ClassVar

import torch
from torch import Tensor

from porse.tasks.hands import shadow
from porse.tasks.hands.toss import FreeCatchTask

STRAY = 0.1
"""Distance (m) of a mount from its place at which the episode ends."""


class CatchOver2Underarm(FreeCatchTask):
    """Throw overarm from the right hand, catch underarm with the left one."""

    NAME: ClassVar[str] = "CatchOver2Underarm"
    DESCRIPTION: ClassVar[str] = (
        "two shadow hands each hold an object that must be thrown to the other hand at the same time; here the right "
        "hand stands upright and throws overarm, and the left hand lies palm up and catches"
    )
    STARTS: ClassVar[str] = (
        "the object is at one place above the fingertips of the right hand, in a random orientation, and the goal "
        "is at one place above the left hand, in another one"
    )
    ENDS: ClassVar[str] = (
        "as soon as the object is at 0.3 m or lower, or the root of a hand is 10 cm or more from its place"
    )
    EPISODE_LENGTH: ClassVar[int] = 75
    TIME_LIMIT: ClassVar[int] = 75
    RIGHT: ClassVar[shadow.BasePose] = shadow.BasePose((0.0, 0.0, 0.5), (1.67, 3.14, 0.0))
    LEFT: ClassVar[shadow.BasePose] = shadow.BasePose((0.0, -0.8, 0.5), (0.0, 0.0, math.pi))
    FORCE_SCALE: ClassVar[float] = 0.1
    TORQUE_SCALE: ClassVar[float] = 2.0
    EGG_START: ClassVar[tuple[float, float, float]] = (0.0, 0.05, 1.0)
    EGG_NOISE: ClassVar[float] = 0.0
    GOAL: ClassVar[tuple[float, float, float]] = (0.0, -0.4, 0.55)
    DROPPED: ClassVar[float] = 0.3
    DISTANCE_SCALE: ClassVar[float] = 20.0

    def failed(self) -> Tensor:
        """Returns where the egg was dropped or a hand is 10 cm from its place."""
        right = self.root_state_tensor[:, 0, :3] - torch.tensor(self.RIGHT.position)
        left = self.root_state_tensor[:, 1, :3] - torch.tensor(self.LEFT.position)
        strayed = (torch.norm(right, dim=-1) >= STRAY) | (torch.norm(left, dim=-1) >= STRAY)
        return super().failed() | strayed
