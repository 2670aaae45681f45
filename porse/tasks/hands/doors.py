"""The base of the four door tasks: a double door in a fixed frame, and two hands that reach for its handles.

The frame is two thin rails along the panels' upper and lower edges, as in the original; beside the panels there is nothing.
The separation of the handles along y says how far the door is open: 0.067 m closed, 0.77 to 0.93 m wide open. The hinges
have a little friction; gravity does not act on the panels, as in the original.
"""

import math
from abc import abstractmethod
from typing import ClassVar

import mujoco
import torch
from torch import Tensor

from porse.tasks import looks
from porse.tasks.hands import objects, shadow
from porse.tasks.hands.free_hands import Handle, handle_variables
from porse.tasks.hands.handles import HandleTask, hand_lost
from porse.tasks.hands.observations import free_hands, moving_body
from porse.tasks.hands.variables import body_variables, free_hand_variables, goal_variables
from porse.variables import Variable

FRICTION = 0.55
PANEL_MASS = 4.25
RAIL = 0.0038
"""Height (m) of a rail of the frame: 0.325 kg of the original's density in two bars of 1.762 m x 0.049 m."""

RAIL_MASS = 0.1625
HALF_OPEN = 0.5
"""Separation (m) of the handles that separates open from closed."""

INWARD = (0.0, math.pi, 0.0)
OUTWARD = (0.0, 0.0, 0.0)
NEAR_HANDS = (
    shadow.BasePose((0.55, 0.2, 0.6), (math.pi, 1.57, 1.57)),
    shadow.BasePose((0.55, -0.2, 0.6), (math.pi, -1.57, 1.57)),
)
WIDE_HANDS = (
    shadow.BasePose((0.9, 0.5, 0.6), (math.pi, 1.57, 1.57)),
    shadow.BasePose((0.9, -0.5, 0.6), (math.pi, -1.57, 1.57)),
)


def _add_panel(frame: mujoco.MjsBody, name: str, origin: objects.Vector, axis: objects.Vector, toward: int) -> None:
    """Adds a panel, 0.42 m wide toward +x or -x of its hinge, with a handle bar on each face."""
    panel = frame.add_body(name=name, pos=origin, gravcomp=1.0)
    objects.add_hinge(panel, f"{name}_hinge", axis, (0.0, math.pi / 2), damping=0.5, friction=0.2)
    near, far = sorted((-0.005 * toward, 0.42 * toward))
    objects.add_box(panel, name, (near, -0.927, -0.02), (far, -0.002, 0.02), PANEL_MASS, FRICTION)
    x = 0.39 * toward
    for face, sign in (("front", 1), ("back", -1)):
        objects.add_rod(
            panel, f"{name}_{face}_bar", (x, -0.6, 0.075 * sign), (x, -0.4, 0.075 * sign), 0.012, 0.02, FRICTION
        )
        for end, y in (("lower", -0.59), ("upper", -0.41)):
            objects.add_rod(
                panel, f"{name}_{face}_{end}", (x, y, 0.02 * sign), (x, y, 0.075 * sign), 0.008, 0.01, FRICTION
            )


def add_door(spec: mujoco.MjSpec, euler: objects.Vector) -> None:
    """Adds the door at 0.7 m: bodies "object" (its base), "link_0" (the frame), "link_1" and "link_2" (the panels)."""
    base = objects.add_base(spec, "object", (0.0, 0.0, 0.7), euler, free=False)
    frame = objects.add_link(base, "link_0")
    low, high = (-0.883, -0.446, -0.0245), (0.879, 0.483, 0.0245)
    objects.add_box(frame, "lower_rail", low, (high[0], low[1] + RAIL, high[2]), RAIL_MASS, FRICTION)
    objects.add_box(frame, "upper_rail", (low[0], high[1] - RAIL, low[2]), high, RAIL_MASS, FRICTION)
    _add_panel(frame, "link_1", (-0.4265, 0.4833, 0.0085), (0.0, -1.0, 0.0), toward=1)
    _add_panel(frame, "link_2", (0.4204, 0.4833, 0.0056), (0.0, 1.0, 0.0), toward=-1)
    looks.paint(spec, "lower_rail", looks.DARK)
    looks.paint(spec, "upper_rail", looks.DARK)
    for panel in ("link_1", "link_2"):
        spec.geom(panel).rgba = looks.WOOD


def _handles(offset: float) -> tuple[Handle, ...]:
    """Returns the handles, `offset` (m) before the panels."""
    return (
        Handle("door_left_handle", "link_2", "the handle for the left hand", (-0.39, -0.5, offset), hand="left"),
        Handle("door_right_handle", "link_1", "the handle for the right hand", (0.39, -0.5, offset), hand="right"),
    )


INWARD_HANDLES = _handles(0.04)
OUTWARD_HANDLES = _handles(-0.04)


class DoorTask(HandleTask):
    """A double door to be opened or closed.

    Attributes:
        EULER: orientation of the door.
        CONSTANT: constant of the human reward.
        GOAL_LIFT: height (m) of the goal above the door.
    """

    NUM_OBSERVATIONS: ClassVar[int] = 417
    EPISODE_LENGTH: ClassVar[int] = 250
    TIME_LIMIT: ClassVar[int] = 250
    TORQUE_SCALE: ClassVar[float] = 0.5
    LOST: ClassVar[float] = 1.5
    ENDS: ClassVar[str] = hand_lost(LOST)
    OBJECT_BODIES: ClassVar[tuple[str, ...]] = ("object", "link_0", "link_1", "link_2", "goal")
    ACTORS: ClassVar[tuple[str, ...]] = ("object", "goal")
    VARIABLES: ClassVar[tuple[Variable, ...]] = (
        *body_variables("object", "the door"),
        *goal_variables("goal", "the goal (high above the door's own place)"),
        *handle_variables(INWARD_HANDLES),
        *free_hand_variables(NUM_OBSERVATIONS, OBJECT_BODIES, ACTORS),
    )

    EULER: ClassVar[objects.Vector]
    CONSTANT: ClassVar[float] = 2.0
    GOAL_LIFT: ClassVar[float] = objects.LIFT

    door_left_handle_pos: Tensor
    door_right_handle_pos: Tensor

    @classmethod
    def add_objects(cls, spec: mujoco.MjSpec) -> None:
        """Adds the door and its goal."""
        add_door(spec, cls.EULER)
        objects.add_goal(spec, (0.0, 0.0, 0.7), cls.EULER, lift=cls.GOAL_LIFT)

    def compute_observations(self) -> Tensor:
        """Returns the observations, `(num_envs, 417)`: two hands, the door, its handles."""
        return torch.cat(
            (
                free_hands(self, self.right_hand_pos, self.left_hand_pos),
                moving_body(self.object_pose, self.object_linvel, self.object_angvel),
                self.door_left_handle_pos,
                self.door_right_handle_pos,
            ),
            dim=-1,
        )

    def separation(self) -> Tensor:
        """Returns the distance (m) between the handles along y, `(num_envs,)`."""
        return (self.door_right_handle_pos[:, 1] - self.door_left_handle_pos[:, 1]).abs()

    @abstractmethod
    def moved(self) -> Tensor:
        """Returns what the human reward pays for with both hands near, `(num_envs,)`."""

    def human_reward(self) -> Tensor:
        """Returns the constant (6 for DoorCloseOutward, else 2) minus both reaches; while both are below 0.5 m, it adds twice the handles' separation (opening), or 1 minus twice the separation (closing)."""
        right, left = self.reaches()
        both = (right < 0.5) & (left < 0.5)
        return self.CONSTANT - right - left + torch.where(both, self.moved(), 0.0)


class OpeningTask(DoorTask):
    """A shut door to be opened."""

    STARTS: ClassVar[str] = "both panels are shut, with the handles 0.067 m apart along y"
    FITNESS: ClassVar[str] = "the share of episodes in which the handles once were more than 0.5 m apart along y"
    RIGHT: ClassVar[shadow.BasePose] = NEAR_HANDS[0]
    LEFT: ClassVar[shadow.BasePose] = NEAR_HANDS[1]

    def succeeded(self) -> Tensor:
        """Returns where the handles are more than half a metre apart."""
        return self.separation() > HALF_OPEN

    def moved(self) -> Tensor:
        """Returns twice the separation."""
        return 2.0 * self.separation()


class ClosingTask(DoorTask):
    """An open door to be closed."""

    FITNESS: ClassVar[str] = "the share of episodes in which the handles once were less than 0.5 m apart along y"
    START_JOINTS: ClassVar[dict[str, tuple[float, float]]] = {
        "link_1_hinge": (1.57, 1.57),
        "link_2_hinge": (1.57, 1.57),
    }

    def succeeded(self) -> Tensor:
        """Returns where the handles are less than half a metre apart."""
        return self.separation() < HALF_OPEN

    def moved(self) -> Tensor:
        """Returns 1 minus twice the separation."""
        return 1.0 - 2.0 * self.separation()
