"""A bucket, which Kettle and GraspAndPlace have."""

import mujoco

from porse.tasks import looks
from porse.tasks.hands import objects

_OUTLINE = (
    (0.0, -0.053), (0.046, -0.053), (0.048, -0.05), (0.057, 0.036), (0.061, 0.038), (0.061, 0.0445), (0.055, 0.0445),
    (0.044, -0.045), (0.0, -0.045),
)  # fmt: skip


def add_bucket(spec: mujoco.MjSpec, name: str, link: str, position: objects.Vector) -> None:
    """Adds a free bucket: its base `name` at a position (m), and its one link."""
    tub = objects.add_link(objects.add_base(spec, name, position), link)
    objects.add_tub(tub, "bucket", (-0.057, -0.053, -0.057), (0.057, 0.0445, 0.057), 0.008, up=1, mass=0.2)


def dress_bucket(spec: mujoco.MjSpec, link: str) -> None:
    """Gives the bucket its look."""
    looks.hide(spec, "bucket_")
    looks.add_lathe(spec, "bucket_look", _OUTLINE)
    looks.look(spec.body(link), "bucket_look", "bucket_look", looks.BLUE)
