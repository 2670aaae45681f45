"""The base of the tasks in which each hand reaches for a handle of its own, on a table or at a door."""

import math
from typing import ClassVar

from torch import Tensor

from porse.tasks.hands import shadow
from porse.tasks.hands.free_hands import FreeHandTask
from porse.tasks.hands.variables import SIDES


def hand_lost(limit: float) -> str:
    """Returns when a hand is lost, as a clause for prompts."""
    return f"as soon as the distances of one hand's five fingertips from its handle sum to {limit:g} m or more"


class HandleTask(FreeHandTask):
    """Two hands and two handles: of `HANDLES`, one names "right" as its hand and one "left".

    Attributes:
        LOST: sum of fingertip distances (m) to its handle at which a hand is lost, and the episode with it.
    """

    FORCE_SCALE: ClassVar[float] = 0.5
    TORQUE_SCALE: ClassVar[float] = 0.1
    RIGHT: ClassVar[shadow.BasePose] = shadow.BasePose((0.55, 0.2, 0.8), (math.pi, 0.0, 1.57))
    LEFT: ClassVar[shadow.BasePose] = shadow.BasePose((0.55, -0.2, 0.8), (math.pi, 0.0, 1.57))

    LOST: ClassVar[float]

    def reaches(self) -> tuple[Tensor, Tensor]:
        """Returns how far (m, sums over the fingers) right and left hand are from their handles, `(num_envs,)` each."""
        names = {handle.hand: handle.name for handle in self.HANDLES}
        right, left = (self.reach(side, getattr(self, f"{names[side]}_pos")) for side in SIDES)
        return right, left

    def failed(self) -> Tensor:
        """Returns where a hand is lost."""
        right, left = self.reaches()
        return (right >= self.LOST) | (left >= self.LOST)


class TableTask(HandleTask):
    """Two hands before a table on which an object with two handles lies."""

    EPISODE_LENGTH: ClassVar[int] = 125
    TIME_LIMIT: ClassVar[int] = 125
    ACTORS: ClassVar[tuple[str, ...]] = ("object", "goal", "table")
