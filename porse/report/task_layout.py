"""What each entry of an observation is, as data: the page of each task prints it, and a test holds it to the code.

Ranges follow from the widths, in order. A block that is a variable times a number says so; the others (scaled joint
angles, Euler angles, turns between a body and its goal, padding) only say what they are.
"""

from dataclasses import dataclass

from porse.tasks.base import Task
from porse.tasks.hands.free_hands import FreeHandTask
from porse.tasks.hands.two_hands import TwoHandTask


@dataclass(frozen=True)
class Block:
    """Some neighbouring entries of an observation.

    Attributes:
        meaning: what they are.
        width: how many.
        variable: the variable that they are, or an empty text.
        scale: what it is multiplied by.
        columns: first and last-plus-one column of the variable, flattened; None for all.
    """

    meaning: str
    width: int
    variable: str = ""
    scale: float = 1.0
    columns: tuple[int, int] | None = None


def _hand(side: str, free: bool, palm: bool) -> tuple[Block, ...]:
    word = "" if side == "right" else "another_"
    index = 0 if side == "right" else 1
    joints, sensors = (24 * index, 24 * index + 24), (30 * index, 30 * index + 30)
    width = 26 if free else 20
    place = (
        Block(f"{side} palm point", 3, f"{side}_hand_pos")
        if palm
        else Block(f"position of the {side} mount", 3, "root_state_tensor", 1.0, (13 * index, 13 * index + 3))
    )
    return (
        Block(f"{side} joint angles, scaled to [-1, 1]", 24),
        Block(f"{side} joint speeds", 24, f"shadow_hand_{word}dof_vel", 0.2),
        Block(f"{side} joint torques", 24, "dof_force_tensor", 10.0, joints),
        Block(f"{side} fingertips: pose and velocities of five links", 65, f"fingertip_{word}state"),
        Block(f"force and torque at the {side} fingertips", 30, "vec_sensor_tensor", 10.0, sensors),
        *((place, Block(f"Euler angles of the {side} mount, in [0, 2 pi)", 3)) if free else ()),
        Block(f"last actions of the {side} hand", width, "actions", 1.0, (width * index, width * index + width)),
    )


def _body(name: str, meaning: str) -> tuple[Block, ...]:
    return (
        Block(f"pose of {meaning}", 7, f"{name}_pose"),
        Block(f"linear velocity of {meaning}", 3, f"{name}_linvel"),
        Block(f"angular velocity of {meaning}", 3, f"{name}_angvel", 0.2),
    )


def _goal(name: str, meaning: str) -> tuple[Block, ...]:
    return (Block(f"goal pose of {meaning}", 7, f"{name}_pose"), Block(f"turn between {meaning} and its goal", 4))


def _point(name: str, meaning: str) -> Block:
    return Block(meaning, 3, f"{name}_pos")


def _zeros(width: int) -> Block:
    return Block("zeros", width)


_DOOR = (_point("door_left_handle", "left handle"), _point("door_right_handle", "right handle"))
_EGG = (*_body("object", "the egg"), *_goal("goal", "the egg"))
_TWO = (
    *_body("object", "the right object"), *_goal("goal", "the right object"),
    *_body("object_another", "the left object"), *_goal("goal_another", "the left object"),
)  # fmt: skip
_SWITCH = (
    *_body("object", "the right switch"), _point("switch_right_handle", "right rocker"),
    _point("switch_left_handle", "left rocker"),
)  # fmt: skip

_AFTER_THE_HANDS: dict[str, tuple[Block, ...]] = {
    "Over": _EGG,
    "CatchAbreast": _EGG,
    "CatchOver2Underarm": _EGG,
    "CatchUnderarm": _EGG,
    "TwoCatchUnderarm": _TWO,
    "ReOrientation": _TWO,
    **{
        name: (*_body("object", "the door"), *_DOOR)
        for name in ("DoorCloseInward", "DoorCloseOutward", "DoorOpenInward", "DoorOpenOutward")
    },
    "Scissors": (
        *_body("object", "the scissors"), _point("scissors_right_handle", "right handle"),
        _point("scissors_left_handle", "left handle"),
    ),
    "SwingCup": (
        *_body("object", "the cup"), _point("cup_right_handle", "right handle"),
        _point("cup_left_handle", "left handle"),
    ),
    "Switch": _SWITCH,
    "SwitchReachable": _SWITCH,
    "Kettle": (
        *_body("object", "the kettle"), _point("kettle_handle", "handle of the kettle"),
        _point("bucket_handle", "point of the bucket"),
    ),
    "LiftUnderarm": (
        *_body("object", "the pot"), _point("pot_right_handle", "right handle"),
        _point("pot_left_handle", "left handle"),
    ),
    "Pen": (
        *_body("object", "the pen"), _point("pen_right_handle", "cap"), _point("pen_left_handle", "barrel"),
    ),
    "BottleCap": (
        *_body("object", "the bottle"), _point("bottle", "bottle"), _point("bottle_cap", "place of the cap"),
        Block("cap", 3, "bottle_cap_up"), _zeros(2),
    ),
    "GraspAndPlace": (
        *_body("object", "the bucket"), _point("block_right_handle", "bucket"),
        Block("orientation of the bucket", 4, "block_right_handle_rot"), _point("block_left_handle", "cube"),
        Block("orientation of the cube", 4, "block_left_handle_rot"),
    ),
    "BlockStack": (*_body("object", "the right cube"), *_body("block", "the left cube"), _zeros(4)),
    "PushBlock": (
        *_body("object", "the right cube"), _point("block_right_handle", "right cube"),
        _point("block_left_handle", "left cube"), _point("left_goal", "goal of the left cube"),
        _point("right_goal", "goal of the right cube"), _zeros(5),
    ),
}  # fmt: skip

_ALONE: dict[str, tuple[Block, ...]] = {
    "Quadcopter": (
        Block("offset to the target, over 3", 3), Block("orientation", 4, "root_quats"),
        Block("linear velocity", 3, "root_linvels", 0.5), Block("angular velocity, over pi", 3),
        Block("rotor tilts", 8, "dof_positions"),
    ),
    "FrankaCabinet": (
        Block("joint angles, scaled to [-1, 1]", 9), Block("joint speeds", 9, "franka_dof_vel", 0.1),
        Block("from the gripper to the handle", 3), Block("opening of the drawer", 1, "cabinet_dof_pos", 1.0, (3, 4)),
        Block("its speed", 1, "cabinet_dof_vel", 1.0, (3, 4)),
    ),
    "Anymal": (
        Block("linear velocity in the body's frame, times 2", 3),
        Block("angular velocity in the body's frame, over 4", 3), Block("gravity, turned by the orientation", 3),
        Block("commands, times 2, 2 and 1/4", 3), Block("joint angles less the default ones", 12),
        Block("joint speeds", 12, "dof_vel", 0.05), Block("last actions", 12, "actions"),
    ),
    "Humanoid": (
        Block("height", 1, "root_states", 1.0, (2, 3)), Block("linear velocity in the torso's frame", 3),
        Block("angular velocity in the torso's frame, over 4", 3), Block("yaw, roll, bearing of the target", 3),
        Block("up projection", 1, "up_vec", 1.0, (2, 3)), Block("heading projection", 1),
        Block("joint angles, scaled to [-1, 1]", 21), Block("joint speeds", 21, "dof_vel", 0.1),
        Block("joint torques", 21, "dof_force_tensor", 0.01), Block("foot forces and torques", 12, "vec_sensor_tensor",
        0.01), Block("last actions", 21, "actions"),
    ),
}  # fmt: skip


def layout(task: type[Task]) -> tuple[Block, ...]:
    """Returns the blocks of a task's observations, in order."""
    if task.NAME in _ALONE:
        return _ALONE[task.NAME]
    assert issubclass(task, TwoHandTask)
    palm = issubclass(task, FreeHandTask) and not task.NAME.startswith(("Catch", "TwoCatch"))
    hands = (*_hand("right", task.FREE, palm), *_hand("left", task.FREE, palm))
    return (*hands, *_AFTER_THE_HANDS[task.NAME])
