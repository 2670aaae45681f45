"""CatchOver2Underarm: an upright hand throws an egg overarm to a hand that lies palm up."""

import math

import torch
from torch import Tensor

from porse.tasks.hands import shadow
from porse.tasks.hands.toss import FreeCatchTask, dropped_at, strayed


class CatchOver2Underarm(FreeCatchTask):
    """Throw overarm from the right hand, catch underarm with the left one."""

    NAME = "CatchOver2Underarm"
    DESCRIPTION = (
        "two shadow hands each hold an object that must be thrown to the other hand at the same time; here the right "
        "hand stands upright and throws overarm, and the left hand lies palm up and catches"
    )
    STARTS = (
        "the object is at one place above the fingertips of the right hand, in a random orientation, and the goal "
        "is at one place above the left hand, in another one"
    )
    DROPPED = 0.3
    ENDS = f"{dropped_at(DROPPED)}, or the root of a hand is 10 cm or more from its place"
    RIGHT = shadow.BasePose((0.0, 0.0, 0.5), (1.67, 3.14, 0.0))
    LEFT = shadow.BasePose((0.0, -0.8, 0.5), (0.0, 0.0, math.pi))
    FORCE_SCALE = 0.1
    TORQUE_SCALE = 2.0
    EGG_START = (0.0, 0.05, 1.0)
    GOAL = (0.0, -0.4, 0.55)
    DISTANCE_SCALE = 20.0

    def failed(self) -> Tensor:
        """Returns where the egg was dropped or a hand is 10 cm from its place."""
        places = torch.tensor(self.RIGHT.position), torch.tensor(self.LEFT.position)
        return super().failed() | strayed(places, self.root_state_tensor[:, 0, :3], self.root_state_tensor[:, 1, :3])
