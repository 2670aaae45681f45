"""The scene of GraspAndPlace."""

import mujoco

from porse.tasks.hands import objects
from porse.tasks.hands.bucket import add_bucket, dress_bucket


def add_objects(spec: mujoco.MjSpec) -> None:
    """Adds the table, the bucket, the cube, and the goal; both start on the table, the original's inside it."""
    objects.add_table(spec, (1.0, 1.0, 0.6))
    add_bucket(spec, "object", "link_1", (0.0, 0.2, 0.654))
    objects.add_block(spec, "block", (0.0, -0.2, 0.625))
    objects.add_goal(spec, (0.0, 0.2, 0.654), lift=objects.LIFT)
    dress_bucket(spec, "link_1")
