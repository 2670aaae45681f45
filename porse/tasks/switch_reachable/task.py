"""SwitchReachable: Switch with a success that can be reached. Not one of the paper's tasks.

Both rockers start at their upper stop, so that pressing a tracked point lowers it, and success is that both points are
nearly at their lowest.
"""

from typing import ClassVar

from torch import Tensor

from porse.tasks.hands.switches import LIMIT, SwitchTask

LOW = 0.693
"""Height (m) of a tracked point, at or below which its switch counts as pressed: 0.7023 at the start, 0.6917 lowest."""


class SwitchReachable(SwitchTask):
    """Press both switches, from their upper stops."""

    NAME = "SwitchReachable"
    STARTS = "both rockers are at their upper stop, their tracked points at a height of 0.702 m"
    FITNESS = (
        "the share of episodes in which the tracked points of both rockers once were at 0.693 m or lower at the "
        "same time"
    )
    START_JOINTS: ClassVar[dict[str, tuple[float, float]]] = {
        "object_rocker": (LIMIT, 0.0),
        "other_rocker": (LIMIT, 0.0),
    }

    def succeeded(self) -> Tensor:
        """Returns where both tracked points are at most 0.693 m high."""
        return (self.switch_right_handle_pos[:, 2] <= LOW) & (self.switch_left_handle_pos[:, 2] <= LOW)
