"""Switch: each hand presses a rocker switch. It cannot be solved, as shipped.

The tracked point of a rocker rises as the rocker turns, from 0.6917 m to 0.7023 m, and success needs a mean height below
0.675 m. Every method of the paper scores 0. `SwitchReachable` is the same scene with a success that can be reached.
"""

from torch import Tensor

from porse.tasks.hands.switches import SwitchTask

PRESSED = 0.05


class Switch(SwitchTask):
    """Press both switches."""

    NAME = "Switch"
    STARTS = "both rockers are at their lower stop, their tracked points at a height of 0.692 m"
    FITNESS = (
        "the share of episodes in which the heights of the tracked points of both rockers once summed to less "
        "than 1.35 m"
    )

    def succeeded(self) -> Tensor:
        """Returns where both tracked points are low: their heights sum to less than 1.35 m."""
        return self.depth() > PRESSED
