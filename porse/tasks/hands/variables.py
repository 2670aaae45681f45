"""What the two-hand tasks offer to generated functions, besides what is a task's own."""

from porse.tasks.hands import shadow
from porse.tasks.plain import plain_variables
from porse.variables import Variable

SIDES = ("right", "left")
FREE_ACTIONS = 52
"""Actions of a task whose hands move as wholes."""


def body_variables(name: str, meaning: str) -> tuple[Variable, ...]:
    """Returns pose, position, orientation and velocities of one body as variables."""
    return (
        Variable(f"{name}_pose", "tensor", (7,), "m, 1", "world", f"position and orientation of {meaning}"),
        Variable(f"{name}_pos", "tensor", (3,), "m", "world", f"position of {meaning}"),
        Variable(f"{name}_rot", "tensor", (4,), "1", "world", f"orientation of {meaning}"),
        Variable(f"{name}_linvel", "tensor", (3,), "m/s", "world", f"linear velocity of {meaning}"),
        Variable(f"{name}_angvel", "tensor", (3,), "rad/s", "world", f"angular velocity of {meaning}"),
    )


def goal_variables(name: str, meaning: str) -> tuple[Variable, ...]:
    """Returns pose, position, orientation and whole state of a goal as variables."""
    return (*body_variables(name, meaning)[:3], goal_states_variable(meaning, f"{name}_states"))


def goal_states_variable(meaning: str, name: str = "goal_states") -> Variable:
    """Returns the whole state of a goal as a variable."""
    return Variable(
        name, "tensor", (13,), "m, 1, m/s, rad/s", "world", f"pose and velocities, which are 0, of {meaning}"
    )


def root_variable(name: str, meaning: str) -> Variable:
    """Returns the column of an actor in `root_state_tensor` as a variable.

    The original's roots are one flat array, which it indexes with such a name first, `root_state_tensor[object_indices,
    0:3]`. Functions that are written so are read as they are meant: see `porse.functions.contract.ROOT_INDICES`.
    """
    return Variable(name, "int", (), "1", "-", f"column of {meaning} in root_state_tensor")


def point_variables(name: str, meaning: str) -> tuple[Variable, ...]:
    """Returns position and orientation of a point as variables."""
    return body_variables(name, meaning)[1:3]


def hand_variables() -> tuple[Variable, ...]:
    """Returns what every two-hand task offers about its hands."""
    found: list[Variable] = []
    for side, word in (("right", ""), ("left", "another_")):
        tips = f"fingertips of the {side} hand (ff, mf, rf, lf, th)"
        found += [
            Variable(f"fingertip_{word}state", "tensor", (5, 13), "m, 1, m/s, rad/s", "world",
                     f"position, orientation and velocities of the last links of the {tips}"),
            Variable(f"fingertip_{word}pos", "tensor", (5, 3), "m", "world", f"positions of the last links, {tips}"),
            Variable(f"fingertip_{word}handles", "tuple", (5,), "1", "-", f"rows of rigid_body_states of the {tips}"),
            Variable(f"shadow_hand_{word}dof_pos", "tensor", (24,), "rad", "joint", f"joint angles of the {side} hand"),
            Variable(f"shadow_hand_{word}dof_vel", "tensor", (24,), "rad/s", "joint", f"joint speeds, {side} hand"),
        ]  # fmt: skip
    return (
        *found,
        Variable("dof_force_tensor", "tensor", (48,), "N m", "joint", "joint torques, right hand, then left"),
        Variable("vec_sensor_tensor", "tensor", (60,), "N, N m", "body",
                 "force and torque at each fingertip, right hand, then left"),
    )  # fmt: skip


def palm_variables() -> tuple[Variable, ...]:
    """Returns the palm points of both hands as variables."""
    return tuple(v for side in SIDES for v in point_variables(f"{side}_hand", f"the palm of the {side} hand"))


def finger_variables(*sides: str) -> tuple[Variable, ...]:
    """Returns the fingertip points of the named hands as variables."""
    return tuple(
        v
        for side in sides
        for finger in shadow.FINGERS
        for v in point_variables(f"{side}_hand_{finger}", f"the {finger} fingertip of the {side} hand")
    )


def two_hand_variables(actions: int, observations: int, objects: int, actors: int) -> tuple[Variable, ...]:
    """Returns what every two-hand task offers besides its objects."""
    listed = "right hand 0-25, left hand 26-51, objects from 52"
    return (
        *hand_variables(),
        Variable("rigid_body_states", "tensor", (2 * len(shadow.BODIES) + objects, 13), "m, 1, m/s, rad/s", "world", f"all bodies: {listed}"),
        Variable("root_state_tensor", "tensor", (2 + actors, 13), "m, 1, m/s, rad/s", "world",
                 "roots of the actors: right hand, left hand, objects"),
        root_variable("object_indices", "the object"),
        *plain_variables(observations, actions),
    )  # fmt: skip


def free_hand_variables(
    observations: int, bodies: tuple[str, ...], actors: tuple[str, ...], fingers: tuple[str, ...] = SIDES
) -> tuple[Variable, ...]:
    """Returns what a task whose hands move as wholes offers besides its objects.

    Args:
        observations: width of an observation.
        bodies: the task's `OBJECT_BODIES`.
        actors: the task's `ACTORS`.
        fingers: the hands whose fingertip points it offers.
    """
    return (
        *palm_variables(),
        *finger_variables(*fingers),
        *two_hand_variables(FREE_ACTIONS, observations, len(bodies), len(actors)),
    )
