"""The scene of BlockStack."""

import mujoco

from porse.tasks.hands import objects

FRICTION = 0.375


def add_objects(spec: mujoco.MjSpec) -> None:
    """Adds the table, the cubes on it, and the goal."""
    objects.add_table(spec, (0.5, 1.0, 0.6), friction=0.2)
    objects.add_block(spec, "object", (0.0, 0.1, 0.625), FRICTION)
    objects.add_block(spec, "block", (0.0, -0.1, 0.625), FRICTION)
    objects.add_goal(spec, (0.0, 0.1, 0.625))
