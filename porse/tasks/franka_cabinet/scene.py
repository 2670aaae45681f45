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
"""Of every joint of the arm (kg m2) and its fingers (kg)."""

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

# Contact bits: 1 arm, 2 cabinet; an arm's part meets the cabinet's parts only.
_XML = """
<mujoco model="FrankaCabinet">
  <compiler angle="radian" autolimits="true"/>
  <option integrator="implicitfast"/>
  <default>
    <default class="arm">
      <geom type="capsule" contype="1" conaffinity="2" group="1" rgba="0.9 0.9 0.9 1" mass="0"/>
      <joint armature="{armature}"/>
      <default class="finger">
        <geom type="box" friction="1 0.05 0.005" condim="4" rgba="0.3 0.3 0.3 1"/>
        <joint type="slide" range="0 0.04" damping="{finger_damping}"/>
      </default>
    </default>
    <default class="cabinet">
      <geom type="box" contype="2" conaffinity="1" density="500" rgba="0.7 0.55 0.4 1"/>
      <joint armature="0.005" damping="10"/>
    </default>
  </default>
  <worldbody>
    <light name="light" pos="1.5 0 3" dir="-0.4 0 -1"/>
    <geom name="floor" type="plane" size="3 3 0.1" contype="0" conaffinity="0" rgba="0.6 0.6 0.6 1"/>
    <body name="panda_link0" pos="1 0 0" quat="0 0 0 1" childclass="arm" gravcomp="1">
      <geom name="link0" fromto="0 0 0.03 0 0 0.25" size="0.06"/>
      <body name="panda_link1" pos="0 0 0.333" gravcomp="1">
        <inertial pos="0 -0.02 -0.06" mass="4.97" diaginertia="0.05 0.05 0.02"/>
        <joint name="panda_joint1" axis="0 0 1" range="-2.8973 2.8973"/>
        <geom name="link1" fromto="0 0 -0.1 0 0 0" size="0.06"/>
        <body name="panda_link2" quat="0.70710678 -0.70710678 0 0" gravcomp="1">
          <inertial pos="0 -0.03 0.02" mass="0.647" diaginertia="0.01 0.01 0.01"/>
          <joint name="panda_joint2" axis="0 0 1" range="-1.7628 1.7628"/>
          <geom name="link2" fromto="0 0 0 0 -0.2 0" size="0.06"/>
          <body name="panda_link3" pos="0 -0.316 0" quat="0.70710678 0.70710678 0 0" gravcomp="1">
            <inertial pos="0.03 0.04 -0.07" mass="3.229" diaginertia="0.03 0.03 0.01"/>
            <joint name="panda_joint3" axis="0 0 1" range="-2.8973 2.8973"/>
            <geom name="link3" fromto="0 0 -0.08 0.08 0.03 0" size="0.05"/>
            <body name="panda_link4" pos="0.0825 0 0" quat="0.70710678 0.70710678 0 0" gravcomp="1">
              <inertial pos="-0.05 0.1 0.03" mass="3.588" diaginertia="0.03 0.02 0.03"/>
              <joint name="panda_joint4" axis="0 0 1" range="-3.0718 -0.0698"/>
              <geom name="link4" fromto="-0.08 0.06 0 -0.08 0.2 0" size="0.05"/>
              <body name="panda_link5" pos="-0.0825 0.384 0" quat="0.70710678 -0.70710678 0 0" gravcomp="1">
                <inertial pos="0 0.04 -0.1" mass="1.226" diaginertia="0.03 0.03 0.01"/>
                <joint name="panda_joint5" axis="0 0 1" range="-2.8973 2.8973"/>
                <geom name="link5" fromto="0 0.06 -0.2 0 0.06 -0.05" size="0.04"/>
                <body name="panda_link6" quat="0.70710678 0.70710678 0 0" gravcomp="1">
                  <inertial pos="0.06 -0.01 -0.01" mass="1.667" diaginertia="0.005 0.005 0.005"/>
                  <joint name="panda_joint6" axis="0 0 1" range="-0.0175 3.7525"/>
                  <geom name="link6" fromto="0 0 0 0.08 0 0" size="0.05"/>
                  <body name="panda_link7" pos="0.088 0 0" quat="0.70710678 0.70710678 0 0" gravcomp="1">
                    <inertial pos="0 0 0.06" mass="0.736" diaginertia="0.005 0.005 0.003"/>
                    <joint name="panda_joint7" axis="0 0 1" range="-2.8973 2.8973"/>
                    <geom name="link7" fromto="0 0 0.02 0 0 0.08" size="0.045"/>
                    <body name="panda_hand" pos="0 0 0.107" quat="0.92387953 0 0 -0.38268343" gravcomp="1">
                      <inertial pos="0 0 0.03" mass="0.73" diaginertia="0.001 0.003 0.002"/>
                      <geom name="hand" type="box" size="0.02 0.1 0.03" pos="0 0 0.03"/>
                      <body name="panda_leftfinger" pos="0 0 0.0584" gravcomp="1" childclass="finger">
                        <inertial pos="0 0.01 0.03" mass="0.015" diaginertia="1e-5 1e-5 1e-5"/>
                        <joint name="panda_finger_joint1" axis="0 1 0"/>
                        <geom name="leftfinger" size="0.01 0.007 0.027" pos="0 0.007 0.027"/>
                      </body>
                      <body name="panda_rightfinger" pos="0 0 0.0584" gravcomp="1" childclass="finger">
                        <inertial pos="0 -0.01 0.03" mass="0.015" diaginertia="1e-5 1e-5 1e-5"/>
                        <joint name="panda_finger_joint2" axis="0 -1 0"/>
                        <geom name="rightfinger" size="0.01 0.007 0.027" pos="0 -0.007 0.027"/>
                      </body>
                    </body>
                  </body>
                </body>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
    <body name="cabinet" pos="0 0 0.4" childclass="cabinet">
      <geom name="back" pos="-0.3 0 0.01" size="0.01 0.39 0.4"/>
      <geom name="side_left" pos="0.015 0.38 0.01" size="0.305 0.01 0.4"/>
      <geom name="side_right" pos="0.015 -0.38 0.01" size="0.305 0.01 0.4"/>
      <geom name="top" pos="0.015 0 0.4" size="0.325 0.39 0.01"/>
      <geom name="bottom" pos="0.015 0 -0.38" size="0.325 0.39 0.01"/>
      <body name="door_left" pos="0.3162 0.3757 -0.1297">
        <joint name="door_left_joint" axis="0 0 1" range="0 1.57"/>
        <geom name="door_left" pos="0.005 -0.187 0" size="0.01 0.185 0.24"/>
        <geom name="door_left_handle" pos="0.035 -0.34 0.1" size="0.01 0.01 0.06"/>
      </body>
      <body name="door_right" pos="0.3162 -0.3757 -0.1297">
        <joint name="door_right_joint" axis="0 0 1" range="-1.57 0"/>
        <geom name="door_right" pos="0.005 0.187 0" size="0.01 0.185 0.24"/>
        <geom name="door_right_handle" pos="0.035 0.34 0.1" size="0.01 0.01 0.06"/>
      </body>
      <body name="drawer_bottom" pos="0.0515 0 0.188">
        <joint name="drawer_bottom_joint" type="slide" axis="1 0 0" range="0 0.4"/>
        <geom name="drawer_bottom_tray" pos="-0.01 0 -0.05" size="0.25 0.35 0.01"/>
        <geom name="drawer_bottom_front" pos="0.2615 0 0" size="0.0115 0.37 0.06"/>
        <geom name="drawer_bottom_handle" pos="0.3045 0 0.009" size="0.0075 0.084 0.012"/>
        <geom name="drawer_bottom_post_left" pos="0.285 0.07 0.009" size="0.012 0.008 0.012"/>
        <geom name="drawer_bottom_post_right" pos="0.285 -0.07 0.009" size="0.012 0.008 0.012"/>
      </body>
      <body name="drawer_top" pos="0.0515 0 0.3172">
        <joint name="drawer_top_joint" type="slide" axis="1 0 0" range="0 0.4"/>
        <geom name="drawer_top_tray" pos="-0.01 0 -0.05" size="0.25 0.35 0.01"/>
        <geom name="drawer_top_front" pos="0.2615 0 0" size="0.0115 0.37 0.06"/>
        <geom name="drawer_top_handle" pos="0.3045 0 0.009" size="0.0075 0.084 0.012"/>
        <geom name="drawer_top_post_left" pos="0.285 0.07 0.009" size="0.012 0.008 0.012"/>
        <geom name="drawer_top_post_right" pos="0.285 -0.07 0.009" size="0.012 0.008 0.012"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def franka_scene(dt: float) -> mujoco.MjSpec:
    """Returns the scene, with the cubes in the top drawer and drives for a physics step of `dt` (s)."""
    spec = mujoco.MjSpec.from_string(_XML.format(armature=ARMATURE, finger_damping=FINGER.damping))
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
