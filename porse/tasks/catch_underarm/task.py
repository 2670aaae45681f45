"""CatchUnderarm: as Over, but the hands move as wholes and stand farther apart."""

import math
from typing import ClassVar

from porse.tasks.hands import shadow
from porse.tasks.hands.toss import FreeCatchTask


class CatchUnderarm(FreeCatchTask):
    """Throw underarm from the right hand to the left one."""

    NAME: ClassVar[str] = "CatchUnderarm"
    DESCRIPTION: ClassVar[str] = (
        "two shadow hands with palms facing upwards stand opposite each other; an object starts above the right hand, "
        "which must throw it so that the left hand catches it; unlike in Over, the translation and rotation of each "
        "hand are actuated, which makes the task harder"
    )
    STARTS: ClassVar[str] = (
        "the object is above the right hand, within 1 cm of one place on each axis, in a random orientation, and "
        "the goal is at one place above the left hand, in another one; the joints of the hands are drawn at "
        "random, the same for both"
    )
    ENDS: ClassVar[str] = "as soon as the object is at 0.1 m or lower"
    EPISODE_LENGTH: ClassVar[int] = 75
    TIME_LIMIT: ClassVar[int] = 75
    RIGHT: ClassVar[shadow.BasePose] = shadow.BasePose((0.0, 0.0, 0.5), (0.0, 0.0, 0.0))
    LEFT: ClassVar[shadow.BasePose] = shadow.BasePose((0.0, -1.15, 0.5), (0.0, 0.0, math.pi))
    FORCE_SCALE: ClassVar[float] = 0.05
    TORQUE_SCALE: ClassVar[float] = 0.5
    JOINT_NOISE: ClassVar[float] = 0.2
    EGG_START: ClassVar[tuple[float, float, float]] = (0.0, -0.39, 0.54)
    EGG_NOISE: ClassVar[float] = 0.01
    GOAL: ClassVar[tuple[float, float, float]] = (0.0, -0.79, 0.54)
    DROPPED: ClassVar[float] = 0.1
    DISTANCE_SCALE: ClassVar[float] = 50.0
