"""The scene of FrankaCabinet: a Panda arm before a cabinet with two doors and two drawers.

The arm's frames, joint limits, efforts and link masses are the published ones; its links collide as capsules. The
cabinet is a box of panels with the original's outer dimensions. The sixteen cubes that lie in the top drawer of the
original (0.205 kg each) are part of the drawer here: loose, they would be most of the physics and change nothing else.

The drives' whole force stays within their limits (see `porse.sim.drives`). The wrist has explicit gains: with the
original's, clamped at 12 N m, it would jerk by 0.9 rad/s in every step.
"""

import mujoco

from porse.sim.drives import Drive
from porse.tasks import looks

ARMATURE = 0.1
"""Of every joint of the arm (kg m2) and its fingers (kg), as `scene.xml` has it."""

ARM = Drive(stiffness=400.0, damping=80.0, limit=87.0, fastest=2.175)
WRIST = Drive(stiffness=400.0, damping=80.0, limit=12.0, fastest=2.61)
FINGER = Drive(stiffness=3e4, damping=300.0, limit=60.0, fastest=0.2)
"""The original's drive has 1e6, 100 and 200 N; with 200 N a finger would sink 2 cm into a contact. The damping acts at
the joint, outside the limit: the highest lead times the stiffness is the limit, so the drive never needs to be clamped,
and a finger that a blow moves stays within an implicit step."""


def drives(dt: float) -> dict[str, Drive]:
    """Returns the drive of each joint, in the order of the actions, for a physics step of `dt` (s).

    Highest speeds are those of the robot's description.
    """
    wrist = WRIST.explicit(ARMATURE, dt)
    return {
        **{f"panda_joint{i}": ARM for i in range(1, 5)},
        **{f"panda_joint{i}": wrist for i in range(5, 8)},
        **{f"panda_finger_joint{i}": FINGER for i in (1, 2)},
    }


STANCE = (1.157, -1.066, -0.155, -2.239, -1.841, 1.003, 0.469, 0.035, 0.035)
"""Joint angles (rad) and finger travels (m) in the middle of the starts."""

PROP_MASS = 0.205
PROP_SPACING = 0.09
PROP_SIZE = 0.04


def franka_scene(dt: float) -> mujoco.MjSpec:
    """Returns the scene, with the cubes in the top drawer and drives for a physics step of `dt` (s)."""
    spec = looks.read_scene(__file__)
    drawer = spec.body("drawer_top")
    for i in range(4):
        for j in range(4):
            drawer.add_geom(
                name=f"prop{i}{j}", type=mujoco.mjtGeom.mjGEOM_BOX, size=[PROP_SIZE] * 3, mass=PROP_MASS,
                pos=[PROP_SPACING * (i - 1.5), PROP_SPACING * (j - 1.5), 0.0], rgba=[0.3, 0.5, 0.8, 1],
                contype=0, conaffinity=0,
            )  # fmt: skip
    for joint, drive in drives(dt).items():
        actuator = spec.add_actuator(
            name=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=joint, forcelimited=True,
            forcerange=[-drive.limit, drive.limit],
        )  # fmt: skip
        actuator.set_to_position(drive.stiffness, kv=0.0 if drive is FINGER else drive.damping)
    looks.surround(spec, centre=(0.4, 0.0, 0.5))
    return spec
