"""The scene of Pen."""

import mujoco

from porse.tasks import looks
from porse.tasks.hands import objects

_PEN = (
    (0.0, -0.159), (0.0095, -0.15), (0.0105, -0.14), (0.0105, 0.135), (0.0085, 0.15), (0.003, 0.19), (0.001, 0.2),
    (0.0, 0.2),
)  # fmt: skip
_PEN_CAP = ((0.0, -0.172), (0.009, -0.172), (0.0115, -0.166), (0.013, -0.041), (0.0, -0.041))
START_HEIGHT = 0.618
"""The pen lies on the table; the original's starts 1.3 cm inside it."""


def add_objects(spec: mujoco.MjSpec) -> None:
    """Adds the table, the pen with its cap, and the goal."""
    objects.add_table(spec, (0.5, 1.0, 0.6))
    base = objects.add_base(spec, "object", (0.0, 0.0, START_HEIGHT), (1.57, 1.57, 0.0))
    barrel = objects.add_link(base, "link_1")
    objects.add_box(barrel, "barrel", (-0.0105, -0.159, -0.0105), (0.0105, 0.2, 0.0105), 0.05)
    cap = barrel.add_body(name="link_0")
    objects.add_slide(cap, "cap", (0.0, -1.0, 0.0), (0.0, 0.492), damping=0.5, friction=0.1)
    objects.add_box(cap, "cap", (-0.0115, -0.172, -0.018), (0.0115, -0.041, 0.018), 0.03)
    objects.add_goal(spec, (0.0, 0.0, START_HEIGHT), (1.57, 1.57, 0.0), lift=objects.LIFT)
    _dress(spec)


def _dress(spec: mujoco.MjSpec) -> None:
    """Dresses "link_1" as the barrel of a pen, "link_0" as its cap with a clip."""
    looks.hide(spec, "barrel", "cap")
    looks.add_lathe(spec, "barrel_look", _PEN)
    looks.look(spec.body("link_1"), "barrel_look", "barrel_look", looks.WHITE)
    cap = spec.body("link_0")
    looks.add_lathe(spec, "cap_look", _PEN_CAP)
    looks.look(cap, "cap_look", "cap_look", looks.BLUE)
    clip: list[looks.Point] = [(0.0, -0.168, 0.008), (0.0, -0.162, 0.0155), (0.0, -0.12, 0.0165), (0.0, -0.075, 0.015)]
    looks.add_tube(spec, "clip_look", clip, (0.002,))
    looks.look(cap, "clip_look", "clip_look", looks.STEEL)
