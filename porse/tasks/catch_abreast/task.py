"""CatchAbreast: two hands side by side pass an egg, as one person does between the own hands."""

import torch
from torch import Tensor

from porse.tasks.hands import shadow
from porse.tasks.hands.toss import FreeCatchTask, catch_variables, dropped_at, strayed
from porse.tasks.hands.two_hands import HAND_BODIES, PALM
from porse.tasks.hands.variables import palm_variables

PLACES = (torch.tensor([-0.3, -0.55, 0.5]), torch.tensor([-0.3, -1.15, 0.5]))
"""Where the palms belong (m)."""


class CatchAbreast(FreeCatchTask):
    """Pass the egg from the right hand to the left one beside it."""

    NAME = "CatchAbreast"
    DESCRIPTION = (
        "two shadow hands are placed side by side and face the same way, like the hands of one person, who passes an "
        "object from the right hand to the left; throwing and catching abreast needs more movement of the hands"
    )
    STARTS = (
        "the object is at one place above the right hand, in a random orientation, and the goal is at one place "
        "above the left hand, in another one"
    )
    DROPPED = 0.2
    ENDS = f"{dropped_at(DROPPED)}, or a palm is 10 cm or more from its place"
    EPISODE_LENGTH = TIME_LIMIT = 150
    VARIABLES = (*palm_variables(), *catch_variables(52, 422))
    RIGHT = shadow.BasePose((0.0, -0.55, 0.5), (0.0, 0.3925, -1.57))
    LEFT = shadow.BasePose((0.0, -1.15, 0.5), (0.0, -0.3925, -1.57))
    FORCE_SCALE = 0.5
    TORQUE_SCALE = 1.0
    EGG_START = (-0.39, -0.55, 0.54)
    GOAL = (-0.39, -1.15, 0.54)

    def failed(self) -> Tensor:
        """Returns where the egg was dropped or a palm is 10 cm from its place."""
        right, left = (self.rigid_body_states[:, palm, :3] for palm in (PALM, HAND_BODIES + PALM))
        return super().failed() | strayed(PLACES, right, left)
