"""The scene of Kettle."""

import mujoco

from porse.tasks import looks
from porse.tasks.hands import objects
from porse.tasks.hands.bucket import add_bucket, dress_bucket

_KETTLE = (
    (0.0, -0.074), (0.07, -0.074), (0.084, -0.068), (0.09, -0.05), (0.092, -0.02), (0.088, 0.012), (0.076, 0.04),
    (0.058, 0.056), (0.05, 0.061), (0.0, 0.061),
)  # fmt: skip
_KETTLE_LID = (
    (0.0, 0.06), (0.05, 0.06), (0.053, 0.064), (0.045, 0.072), (0.02, 0.078), (0.008, 0.08), (0.007, 0.087),
    (0.014, 0.092), (0.014, 0.1), (0.008, 0.105), (0.0, 0.105),
)  # fmt: skip
DROPS = 8
DROP_RADIUS = 0.01
"""The water."""


def add_objects(spec: mujoco.MjSpec) -> None:
    """Adds the table, the kettle with lid and water, the bucket, and the goal."""
    objects.add_table(spec, (0.5, 1.0, 0.4))
    base = objects.add_base(spec, "object", (0.0, 0.0, 0.5), (0.0, 0.0, 1.57))
    body = objects.add_link(base, "link_1")
    objects.add_tub(body, "kettle", (-0.09, -0.074, -0.09), (0.09, 0.06, 0.09), 0.012, up=1, mass=2.2)
    objects.add_rod(body, "spout", (0.0, 0.0, 0.09), (0.0, 0.07, 0.2), 0.015, 0.13)
    objects.add_rod(body, "handle_upper", (0.0, 0.05, -0.09), (0.0, 0.05, -0.15), 0.01, 0.04)
    objects.add_rod(body, "handle_bar", (0.0, -0.05, -0.15), (0.0, 0.05, -0.15), 0.012, 0.05)
    objects.add_rod(body, "handle_lower", (0.0, -0.05, -0.09), (0.0, -0.05, -0.15), 0.01, 0.04)
    lid = body.add_body(name="link_0")
    objects.add_slide(lid, "lid", (0.0, 1.0, 0.0), (0.0, 0.032), damping=1.0, friction=1.0)
    objects.add_box(lid, "lid", (-0.074, 0.061, -0.074), (0.074, 0.072, 0.074), 0.16)
    add_bucket(spec, "bucket", "bucket_link_1", (0.0, -0.3, 0.5))
    for i in range(DROPS):
        place = (0.025 * (i % 4 - 1.5), 0.03 * (i // 4 - 0.5), 0.46)
        drop = objects.add_base(spec, f"drop{i}", place)
        drop.add_geom(
            name=f"drop{i}", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[DROP_RADIUS, 0, 0], mass=0.004,
            contype=objects.OBJECT_BIT, conaffinity=objects.HAND_BIT | objects.OBJECT_BIT,
            rgba=[0.2, 0.4, 0.9, 1],
        )  # fmt: skip
    objects.add_goal(spec, (0.0, 0.0, 0.5), (0.0, 0.0, 1.57), lift=objects.LIFT)
    _dress(spec)
    dress_bucket(spec, "bucket_link_1")


def _dress(spec: mujoco.MjSpec) -> None:
    """Dresses "link_1" as a round kettle with spout and handle, "link_0" as its lid."""
    body = spec.body("link_1")
    looks.hide(spec, "kettle", "spout", "handle", "lid")
    looks.add_lathe(spec, "kettle_look", _KETTLE)
    looks.look(body, "kettle_look", "kettle_look", looks.RED)
    spout: list[looks.Point] = [
        (0.0, -0.03, 0.07),
        (0.0, -0.02, 0.1),
        (0.0, 0.02, 0.135),
        (0.0, 0.052, 0.175),
        (0.0, 0.07, 0.2),
    ]
    looks.add_tube(spec, "spout_look", spout, (0.027, 0.024, 0.018, 0.014, 0.013))
    looks.look(body, "spout_look", "spout_look", looks.RED)
    grip: list[looks.Point] = [
        (0.0, 0.03, -0.075), (0.0, 0.053, -0.11), (0.0, 0.045, -0.145), (0.0, 0.0, -0.155), (0.0, -0.045, -0.145),
        (0.0, -0.055, -0.11), (0.0, -0.04, -0.08),
    ]  # fmt: skip
    looks.add_tube(spec, "handle_look", grip, (0.009, 0.01, 0.012, 0.012, 0.012, 0.01, 0.009))
    looks.look(body, "handle_look", "handle_look", looks.DARK)
    looks.add_lathe(spec, "lid_look", _KETTLE_LID)
    looks.look(spec.body("link_0"), "lid_look", "lid_look", looks.DARK)
