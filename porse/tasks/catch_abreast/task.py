"""CatchAbreast: two hands side by side pass an egg, as one person does between the own hands."""

from typing import ClassVar

import torch
from torch import Tensor

from porse.tasks.hands import shadow
from porse.tasks.hands.toss import FreeCatchTask, catch_variables
from porse.tasks.hands.two_hands import HAND_BODIES, PALM
from porse.tasks.hands.variables import palm_variables
from porse.variables import Variable

RIGHT_PLACE = torch.tensor([-0.3, -0.55, 0.5])
LEFT_PLACE = torch.tensor([-0.3, -1.15, 0.5])
STRAY = 0.1
"""Distance (m) of a palm from its place at which the episode ends."""


class CatchAbreast(FreeCatchTask):
    """Pass the egg from the right hand to the left one beside it."""

    NAME: ClassVar[str] = "CatchAbreast"
    DESCRIPTION: ClassVar[str] = (
        "two shadow hands are placed side by side and face the same way, like the hands of one person, who passes an "
        "object from the right hand to the left; throwing and catching abreast needs more movement of the hands"
    )
    STARTS: ClassVar[str] = (
        "the object is at one place above the right hand, in a random orientation, and the goal is at one place "
        "above the left hand, in another one"
    )
    ENDS: ClassVar[str] = "as soon as the object is at 0.2 m or lower, or a palm is 10 cm or more from its place"
    EPISODE_LENGTH: ClassVar[int] = 150
    TIME_LIMIT: ClassVar[int] = 150
    VARIABLES: ClassVar[tuple[Variable, ...]] = (*palm_variables(), *catch_variables(52, 422))
    RIGHT: ClassVar[shadow.BasePose] = shadow.BasePose((0.0, -0.55, 0.5), (0.0, 0.3925, -1.57))
    LEFT: ClassVar[shadow.BasePose] = shadow.BasePose((0.0, -1.15, 0.5), (0.0, -0.3925, -1.57))
    FORCE_SCALE: ClassVar[float] = 0.5
    TORQUE_SCALE: ClassVar[float] = 1.0
    EGG_START: ClassVar[tuple[float, float, float]] = (-0.39, -0.55, 0.54)
    EGG_NOISE: ClassVar[float] = 0.0
    GOAL: ClassVar[tuple[float, float, float]] = (-0.39, -1.15, 0.54)
    DROPPED: ClassVar[float] = 0.2
    DISTANCE_SCALE: ClassVar[float] = 50.0

    def failed(self) -> Tensor:
        """Returns where the egg was dropped or a palm is 10 cm from its place."""
        right = self.rigid_body_states[:, PALM, :3] - RIGHT_PLACE
        left = self.rigid_body_states[:, HAND_BODIES + PALM, :3] - LEFT_PLACE
        strayed = (torch.norm(right, dim=-1) >= STRAY) | (torch.norm(left, dim=-1) >= STRAY)
        return super().failed() | strayed
