"""The scene of PushBlock."""

import mujoco

from porse.tasks.hands import objects

FRICTION = 0.75
LEFT_GOAL = (-0.2, -0.2, 0.625)
RIGHT_GOAL = (-0.2, 0.2, 0.625)


def add_objects(spec: mujoco.MjSpec) -> None:
    """Adds the table, the cubes on it, and their goals."""
    objects.add_table(spec, (1.0, 1.0, 0.6), friction=0.5)
    objects.add_block(spec, "object", (0.0, 0.2, 0.625), FRICTION)
    objects.add_block(spec, "block", (0.0, -0.2, 0.625), FRICTION)
    objects.add_goal(spec, LEFT_GOAL, name="left_goal")
    objects.add_goal(spec, RIGHT_GOAL, name="right_goal")
    for name in ("left_goal", "right_goal"):
        site = spec.site(name)
        site.type, site.size, site.material = mujoco.mjtGeom.mjGEOM_BOX, [0.025, 0.025, 0.025], "cube"
        site.rgba = [1.0, 1.0, 1.0, 0.4]
