"""The scene of LiftUnderarm."""

import mujoco

from porse.tasks import looks
from porse.tasks.hands import objects

_POT = (
    (0.0, -0.065), (0.1, -0.065), (0.114, -0.058), (0.12, -0.04), (0.12, 0.06), (0.124, 0.062), (0.124, 0.069),
    (0.0, 0.069),
)  # fmt: skip
_POT_LID = (
    (0.0, 0.07), (0.119, 0.07), (0.119, 0.075), (0.09, 0.085), (0.04, 0.092), (0.012, 0.094), (0.01, 0.104),
    (0.02, 0.11), (0.02, 0.118), (0.01, 0.123), (0.0, 0.123),
)  # fmt: skip
FRICTION = 2.0
START_HEIGHT = 0.466
"""The pot stands on the table; the original's starts 1.5 cm inside it."""
GOAL_HEIGHT = 0.85


def add_objects(spec: mujoco.MjSpec) -> None:
    """Adds the table, the pot with its lid, and the goal."""
    objects.add_table(spec, (0.3, 0.3, 0.4), y=-0.6, friction=FRICTION)
    base = objects.add_base(spec, "object", (0.0, -0.6, START_HEIGHT))
    body = objects.add_link(base, "link_1")
    objects.add_rod(body, "pot", (0.0, -0.065, 0.0), (0.0, 0.069, 0.0), 0.12, 2.8, FRICTION)
    objects.add_box(body, "right_handle", (-0.181, 0.045, -0.04), (-0.11, 0.065, 0.04), 0.1, FRICTION)
    objects.add_box(body, "left_handle", (0.11, 0.045, -0.04), (0.181, 0.065, 0.04), 0.1, FRICTION)
    lid = body.add_body(name="link_0")
    objects.add_slide(lid, "lid", (0.0, 1.0, 0.0), (0.0, 0.06), damping=1.0, friction=1.0)
    objects.add_rod(lid, "lid", (0.0, 0.07, 0.0), (0.0, 0.09, 0.0), 0.117, 1.0, FRICTION)
    objects.add_goal(spec, (0.0, -0.6, GOAL_HEIGHT))
    _dress(spec)


def _dress(spec: mujoco.MjSpec) -> None:
    """Dresses "link_1" as a pot with two handles, "link_0" as its lid."""
    looks.hide(spec, "pot", "lid", "left_handle", "right_handle")
    looks.add_lathe(spec, "pot_look", _POT)
    looks.look(spec.body("link_1"), "pot_look", "pot_look", looks.STEEL)
    looks.add_lathe(spec, "lid_look", _POT_LID)
    looks.look(spec.body("link_0"), "lid_look", "lid_look", (0.5, 0.53, 0.57, 1.0))
    for name, side in (("left", 1), ("right", -1)):
        grip: list[looks.Point] = [
            (0.112 * side, 0.055, -0.04), (0.15 * side, 0.055, -0.041), (0.174 * side, 0.055, -0.025),
            (0.174 * side, 0.055, 0.025), (0.15 * side, 0.055, 0.041), (0.112 * side, 0.055, 0.04),
        ]  # fmt: skip
        looks.add_tube(spec, f"{name}_handle_look", grip, (0.009,))
        looks.look(spec.body("link_1"), f"{name}_handle_look", f"{name}_handle_look", looks.DARK)
