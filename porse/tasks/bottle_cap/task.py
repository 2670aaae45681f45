"""BottleCap: one hand cradles a bottle, and the other pulls its cap off.

Departures: the bottle carries most of its mass in its foot, since it would otherwise tip out of the palm within a
quarter of a second. Its weight sinks and tilts the free hand under it, so that zero action ends every episode after 100
steps, when the cap's place is 11 cm lower; the left hand has to push up. The observations end with two zeros, because the paper says 422 where the original has 420.
"""

import math
from typing import ClassVar

import mujoco
import torch
from torch import Tensor

from porse.tasks import dress, objects, shadow
from porse.tasks.free_hands import FreeHandTask, Handle
from porse.tasks.hand_observations import free_hands, moving_body
from porse.tasks.hand_variables import body_variables, free_hand_variables, goal_variables
from porse.variables import Variable

FRICTION = 2.0
"""The original's is 100, which MuJoCo's contacts do not need."""

RADIUS = 0.036
OPEN = 0.03
GOAL_LIFT = 1.0
"""Height (m) of the goal above the bottle's start; it says nothing about the task."""

DROPPED = 0.5
CAP_LOST = 0.5
BOTTLE_LOST = 0.2
PADDING = 2
"""Zeros that widen the 420 observations of the original's code to the 422 that the paper states."""


class BottleCap(FreeHandTask):
    """Open the bottle."""

    NAME: ClassVar[str] = "BottleCap"
    DESCRIPTION: ClassVar[str] = (
        "one shadow hand holds a bottle, and the other opens its cap without letting the bottle fall"
    )
    STARTS: ClassVar[str] = "the bottle, shut, lies in the left hand, and the right hand is above its cap"
    ENDS: ClassVar[str] = (
        "as soon as the place of the cap on the bottle (bottle_cap_pos) is at 0.5 m or lower or 0.5 m or more "
        "from the right palm, or the bottle is 0.2 m or more from the left palm"
    )
    FITNESS: ClassVar[str] = (
        "the share of episodes in which the cap once was more than 3 cm from the bottle's origin; shut it is 1 cm"
    )
    NUM_OBSERVATIONS: ClassVar[int] = 422
    EPISODE_LENGTH: ClassVar[int] = 125
    TIME_LIMIT: ClassVar[int] = 125
    FORCE_SCALE: ClassVar[float] = 0.1
    TORQUE_SCALE: ClassVar[float] = 0.1
    RIGHT: ClassVar[shadow.BasePose] = shadow.BasePose((0.0, -1.05, 0.5), (0.5, math.pi, math.pi))
    LEFT: ClassVar[shadow.BasePose] = shadow.BasePose((0.0, -0.25, 0.45), (0.0, 0.87, 0.0))
    PER_ENV_STATISTIC: ClassVar[bool] = True
    OBJECT_BODIES: ClassVar[tuple[str, ...]] = ("object", "link_1", "helper", "link_0", "goal", "table")
    ACTORS: ClassVar[tuple[str, ...]] = ("object", "goal", "table")
    HANDLES: ClassVar[tuple[Handle, ...]] = (
        Handle("bottle", "object"),
        Handle("bottle_cap", "object", (0.0, 0.0, 0.15)),
        Handle("cap", "link_0"),
    )
    VARIABLES: ClassVar[tuple[Variable, ...]] = (
        *body_variables("object", "the bottle"),
        *goal_variables("goal", "the goal (1 m above the bottle's own place)"),
        Variable("bottle_pos", "tensor", (3,), "m", "world", "position of the bottle"),
        Variable("bottle_cap_pos", "tensor", (3,), "m", "world", "point of the bottle where the cap sits"),
        Variable("bottle_cap_up", "tensor", (3,), "m", "world", "position of the cap, which rises from the bottle"),
        *free_hand_variables(NUM_OBSERVATIONS, OBJECT_BODIES, ACTORS, fingers=("right",)),
    )

    bottle_pos: Tensor
    bottle_cap_pos: Tensor
    bottle_cap_up: Tensor
    cap_pos: Tensor

    @classmethod
    def add_objects(cls, spec: mujoco.MjSpec) -> None:
        """Adds the table far below, the bottle with its cap, and the goal."""
        objects.add_table(spec, (0.3, 0.3, 0.1), y=-0.6)
        base = objects.add_base(spec, "object", (0.0, -0.6, 0.5), (0.0, -0.7, 0.0))
        body = objects.add_link(base, "link_1")
        objects.add_rod(body, "foot", (0.0, -0.026, 0.0), (0.0, 0.03, 0.0), RADIUS, 0.25, FRICTION)
        objects.add_rod(body, "bottle", (0.0, 0.03, 0.0), (0.0, 0.11, 0.0), RADIUS, 0.05, FRICTION)
        objects.add_rod(body, "neck", (0.0, 0.11, 0.0), (0.0, 0.138, 0.0), 0.012, 0.02, FRICTION)
        helper = body.add_body(name="helper", pos=[0.007, 0.0, 0.0075])
        helper.mass, helper.inertia, helper.ipos = 1e-3, [1e-6] * 3, [0.0, 0.144, 0.0]
        helper.explicitinertial = True
        objects.add_slide(helper, "pull", (0.0, 1.0, 0.0), (0.0, 0.064), damping=0.5, friction=0.05)
        cap = helper.add_body(name="link_0")
        cap.add_joint(name="screw", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 1, 0], damping=1e-3, armature=1e-4)
        objects.add_rod(cap, "cap", (-0.007, 0.139, -0.0075), (-0.007, 0.15, -0.0075), 0.013, 0.0026, FRICTION)
        objects.add_goal(spec, (0.0, -0.6, 0.5), (0.0, -0.7, 0.0), lift=GOAL_LIFT)
        dress.dress_bottle(spec)

    def compute_observations(self) -> Tensor:
        """Returns the observations, `(num_envs, 422)`: two hands, the bottle, its cap, two zeros."""
        return torch.cat(
            (
                free_hands(self, self.right_hand_pos, self.left_hand_pos),
                moving_body(self.object_pose, self.object_linvel, self.object_angvel),
                self.bottle_pos,
                self.bottle_cap_pos,
                self.bottle_cap_up,
                torch.zeros(self.num_envs, PADDING),
            ),
            dim=-1,
        )

    def _default_joints(self) -> Tensor:
        joints = torch.zeros(len(shadow.JOINTS))
        for name, angle in (("THJ4", -1.04), ("THJ3", 1.2), ("THJ0", -1.57)):
            joints[shadow.JOINTS.index(name)] = angle
        return joints

    def _name_measurements(self) -> None:
        super()._name_measurements()
        self.bottle_cap_up = self.cap_pos

    def lift(self) -> Tensor:
        """Returns the distance (m) of the cap from the bottle's origin, `(num_envs,)`: 0.0103 closed."""
        return torch.norm(self.bottle_cap_up - self.bottle_pos, dim=-1)

    def succeeded(self) -> Tensor:
        """Returns where the cap is more than 3 cm up."""
        return self.lift() > OPEN

    def failed(self) -> Tensor:
        """Returns where the bottle fell or a palm is far from it."""
        cap = torch.norm(self.bottle_cap_pos - self.right_hand_pos, dim=-1)
        bottle = torch.norm(self.bottle_pos - self.left_hand_pos, dim=-1)
        return (self.bottle_cap_pos[:, 2] <= DROPPED) | (cap >= CAP_LOST) | (bottle >= BOTTLE_LOST)

    def human_reward(self) -> Tensor:
        """Returns 2 minus the right hand's reach and the left palm's distance, plus 30 lift with the hand near."""
        right = self.reach("right", self.bottle_cap_pos)
        left = torch.norm(self.bottle_pos - self.left_hand_pos, dim=-1)
        return 2.0 - right - left + torch.where(right <= 0.3, 30.0 * self.lift(), 0.0)
