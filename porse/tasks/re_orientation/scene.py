"""The scene of ReOrientation: a cube above each palm, and the pose that it shall have."""

import mujoco

from porse.tasks.hands import objects

PLACES = ((0.0, -0.39, 0.6), (0.0, -0.76, 0.6))
GOAL_DROP = 0.04


def add_objects(spec: mujoco.MjSpec) -> None:
    """Adds the cubes and their goals."""
    for word, start in zip(("", "_another"), PLACES, strict=True):
        objects.add_block(spec, f"object{word}", start)
        goal = objects.add_goal(spec, (start[0], start[1], start[2] - GOAL_DROP), name=f"goal{word}")
        goal.add_geom(
            name=f"goal{word}", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.025] * 3, contype=0, conaffinity=0,
            material="cube", rgba=[1.0, 1.0, 1.0, 0.45],
        )  # fmt: skip
