"""The base of the tasks in which each hand reaches for a handle of its own, on a table or at a door."""

import math
from typing import ClassVar

from torch import Tensor

from porse.tasks import shadow
from porse.tasks.free_hands import FreeHandTask


class HandleTask(FreeHandTask):
    """Two hands and two handles.

    Attributes:
        RIGHT_HANDLE: name of the handle for the right hand.
        LEFT_HANDLE: name of the handle for the left hand.
        LOST: sum of fingertip distances (m) to its handle at which a hand is lost, and the episode with it.
    """

    FORCE_SCALE: ClassVar[float] = 0.5
    TORQUE_SCALE: ClassVar[float] = 0.1
    RIGHT: ClassVar[shadow.BasePose] = shadow.BasePose((0.55, 0.2, 0.8), (math.pi, 0.0, 1.57))
    LEFT: ClassVar[shadow.BasePose] = shadow.BasePose((0.55, -0.2, 0.8), (math.pi, 0.0, 1.57))

    RIGHT_HANDLE: ClassVar[str]
    LEFT_HANDLE: ClassVar[str]
    LOST: ClassVar[float]

    def reaches(self) -> tuple[Tensor, Tensor]:
        """Returns how far (m, sums over the fingers) right and left hand are from their handles, `(num_envs,)` each."""
        right, left = (getattr(self, f"{name}_pos") for name in (self.RIGHT_HANDLE, self.LEFT_HANDLE))
        return self.reach("right", right), self.reach("left", left)

    def failed(self) -> Tensor:
        """Returns where a hand is lost."""
        right, left = self.reaches()
        return (right >= self.LOST) | (left >= self.LOST)
