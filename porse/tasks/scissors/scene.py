"""The scene of Scissors."""

import math
from collections.abc import Sequence

import mujoco

from porse.tasks import looks
from porse.tasks.hands import objects

THICKNESS = 0.012
CLOSED = -0.59


def _add_half(body: mujoco.MjsBody, name: str, side: int) -> None:
    """Adds a blade toward -x and a handle toward +x and side * z, in one plane."""
    low, high = -THICKNESS / 2, THICKNESS / 2
    objects.add_box(body, f"{name}_blade", (-0.2, low, -0.012), (0.02, high, 0.012), 0.03)
    near, far = sorted((0.0, 0.06 * side))
    objects.add_box(body, f"{name}_neck", (0.0, low, near), (0.14, high, far), 0.03)
    near, far = sorted((0.06 * side, 0.12 * side))
    objects.add_box(body, f"{name}_grip", (0.12, low, near), (0.24, high, far), 0.04)


def add_objects(spec: mujoco.MjSpec) -> None:
    """Adds the table, the scissors, and the goal."""
    objects.add_table(spec, (0.5, 1.0, 0.6))
    base = objects.add_base(spec, "object", (0.0, 0.0, 0.607), (0.0, 0.0, 1.57))
    fixed = objects.add_link(base, "link_1")
    _add_half(fixed, "link_1", side=1)
    moving = fixed.add_body(name="link_0", pos=[-0.0698, 0.0, 0.0034])
    _add_half(moving, "link_0", side=-1)
    objects.add_hinge(moving, "scissors", (0.0, 1.0, 0.0), (-0.5969, 0.4), damping=0.02, friction=0.01)
    objects.add_goal(spec, (0.0, 0.0, 0.607), (0.0, 0.0, 1.57), lift=objects.LIFT)
    _dress(spec)


def _dress(spec: mujoco.MjSpec) -> None:
    """Dresses "link_1" and "link_0" as the halves of a pair of scissors: a blade, and a ring to hold it by."""
    looks.hide(spec, "link_")
    for body, side in (("link_1", 1), ("link_0", -1)):
        blade: list[looks.Point] = [
            (0.03, 0.0, 0.006 * side),
            (-0.03, 0.0, 0.002 * side),
            (-0.12, 0.0, -0.002 * side),
            (-0.2, 0.0, 0.0),
        ]
        looks.add_tube(spec, f"{body}_blade_look", blade, (0.012, 0.012, 0.008, 0.001))
        looks.look(spec.body(body), f"{body}_blade_look", f"{body}_blade_look", looks.STEEL)
        arm: list[looks.Point] = [
            (0.02, 0.0, 0.004 * side),
            (0.06, 0.0, 0.022 * side),
            (0.1, 0.0, 0.05 * side),
            (0.13, 0.0, 0.07 * side),
        ]
        looks.add_tube(spec, f"{body}_arm_look", arm, (0.011, 0.009, 0.009, 0.009))
        looks.look(spec.body(body), f"{body}_arm_look", f"{body}_arm_look", looks.RED)
        ring = _oval((0.18, 0.09 * side), 0.056, 0.026)
        looks.add_tube(spec, f"{body}_ring_look", ring, (0.008,), closed=True)
        looks.look(spec.body(body), f"{body}_ring_look", f"{body}_ring_look", looks.RED)
    looks.look_sphere(spec.body("link_1"), "screw_look", (-0.0698, 0.008, 0.0034), 0.009, looks.DARK)


def _oval(centre: tuple[float, float], length: float, width: float) -> list[looks.Point]:
    """Returns twelve points of an oval in the x-z plane."""
    turns: Sequence[float] = [2.0 * math.pi * i / 12 for i in range(12)]
    return [(centre[0] + length * math.cos(t), 0.0, centre[1] + width * math.sin(t)) for t in turns]
