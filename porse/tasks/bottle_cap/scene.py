"""The scene of BottleCap."""

import mujoco

from porse.tasks import looks
from porse.tasks.hands import objects

_BOTTLE = (
    (0.0, -0.026), (0.032, -0.026), (0.036, -0.021), (0.036, 0.085), (0.033, 0.1), (0.022, 0.116), (0.0125, 0.124),
    (0.012, 0.138), (0.0, 0.138),
)  # fmt: skip
_BOTTLE_CAP = ((0.0, 0.139), (0.0135, 0.139), (0.0135, 0.1485), (0.012, 0.15), (0.0, 0.15))
FRICTION = 2.0
"""The original's is 100, which MuJoCo's contacts do not need."""
RADIUS = 0.036
GOAL_LIFT = 1.0
"""Height (m) of the goal above the bottle's start; it says nothing about the task."""


def add_objects(spec: mujoco.MjSpec) -> None:
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
    _dress(spec)


def _dress(spec: mujoco.MjSpec) -> None:
    """Dresses "link_1" as a bottle, "link_0" as its cap."""
    looks.hide(spec, "foot", "bottle", "neck", "cap")
    looks.add_lathe(spec, "bottle_look", _BOTTLE)
    looks.look(spec.body("link_1"), "bottle_look", "bottle_look", looks.GREEN)
    looks.add_lathe(spec, "cap_look", _BOTTLE_CAP)
    looks.look(spec.body("link_0"), "cap_look", "cap_look", looks.RED, (-0.007, 0.0, -0.0075))
