"""The scene of SwingCup."""

import math

import mujoco

from porse.tasks import looks
from porse.tasks.hands import objects

_CUP = (
    (0.0, -0.084), (0.03, -0.084), (0.034, -0.08), (0.036, -0.07), (0.043, -0.045), (0.045, 0.0), (0.045, 0.07),
    (0.0, 0.07),
)  # fmt: skip
_CUP_LID = ((0.0, 0.07), (0.047, 0.07), (0.047, 0.076), (0.03, 0.082), (0.009, 0.084), (0.009, 0.092), (0.0, 0.094))
FRICTION = 0.75
GOAL_LIFT = 1.0
"""Height (m) of the goal above the cup's start; only its orientation counts."""
START_HEIGHT = 0.685
"""The cup stands on the table; the original's starts 8 cm inside it and is pushed out."""


def add_objects(spec: mujoco.MjSpec) -> None:
    """Adds the table, the cup with its lid and two handles, and the goal."""
    objects.add_table(spec, (0.3, 0.3, 0.6))
    base = objects.add_base(spec, "object", (0.0, 0.0, START_HEIGHT), (0.0, 0.0, 1.57))
    body = objects.add_link(base, "link_1")
    objects.add_rod(body, "cup", (0.0, -0.084, 0.0), (0.0, 0.07, 0.0), 0.045, 0.7, FRICTION)
    objects.add_box(body, "left_handle", (-0.012, -0.05, 0.04), (0.012, 0.05, 0.073), 0.04, FRICTION)
    lid = body.add_body(name="link_0", pos=[-0.0013, 0.0, -0.0062])
    objects.add_slide(lid, "lid", (0.0, 1.0, 0.0), (0.0, 0.108), damping=0.5, friction=0.2)
    objects.add_rod(lid, "lid", (0.0, 0.071, 0.0), (0.0, 0.082, 0.0), 0.045, 0.05, FRICTION)
    handle = objects.add_link(base, "link_2")
    objects.add_box(handle, "right_handle", (-0.012, -0.05, -0.073), (0.012, 0.05, -0.04), 0.04, FRICTION)
    objects.add_goal(spec, (0.0, 0.0, START_HEIGHT), (0.0, 0.0, 1.5 * math.pi), lift=GOAL_LIFT)
    _dress(spec)


def _dress(spec: mujoco.MjSpec) -> None:
    """Dresses the cup: "link_1" with the left handle, "link_2" with the right one, "link_0" as its lid."""
    looks.hide(spec, "cup", "lid", "left_handle", "right_handle")
    looks.add_lathe(spec, "cup_look", _CUP)
    looks.look(spec.body("link_1"), "cup_look", "cup_look", looks.WHITE)
    looks.add_lathe(spec, "lid_look", _CUP_LID)
    looks.look(spec.body("link_0"), "lid_look", "lid_look", looks.BLUE)
    for name, body, side in (("left", "link_1", 1), ("right", "link_2", -1)):
        ear: list[looks.Point] = [
            (0.0, 0.045, 0.04 * side), (0.0, 0.05, 0.062 * side), (0.0, 0.025, 0.076 * side),
            (0.0, -0.02, 0.072 * side), (0.0, -0.05, 0.052 * side), (0.0, -0.055, 0.038 * side),
        ]  # fmt: skip
        looks.add_tube(spec, f"{name}_handle_look", ear, (0.0095,))
        looks.look(
            spec.body(body), f"{name}_handle_look", f"{name}_handle_look", looks.ORANGE if side > 0 else looks.BLUE
        )
