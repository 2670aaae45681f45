"""CatchUnderarm: as Over, but the hands move as wholes and stand farther apart."""

from porse.tasks.hands import shadow
from porse.tasks.hands.toss import SPREAD_STARTS, FreeCatchTask, dropped_at


class CatchUnderarm(FreeCatchTask):
    """Throw underarm from the right hand to the left one."""

    NAME = "CatchUnderarm"
    DESCRIPTION = (
        "two shadow hands with palms facing upwards stand opposite each other; an object starts above the right hand, "
        "which must throw it so that the left hand catches it; unlike in Over, the translation and rotation of each "
        "hand are actuated, which makes the task harder"
    )
    STARTS = SPREAD_STARTS
    DROPPED = 0.1
    ENDS = dropped_at(DROPPED)
    RIGHT, LEFT = shadow.palms_up(1.15)
    FORCE_SCALE = 0.05
    TORQUE_SCALE = 0.5
    JOINT_NOISE = 0.2
    EGG_START = (0.0, -0.39, 0.54)
    EGG_NOISE = 0.01
    GOAL = (0.0, -0.79, 0.54)
