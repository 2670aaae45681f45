"""The scene of Humanoid: the well-known 21-joint capsule figure on a plane.

Lengths and radii are those of the published MuJoCo humanoid; joint ranges, damping, stiffness, armature and motor gears
are those of the Isaac Gym task. Limits are stiffer than MuJoCo's, which knees overshoot by 0.7 rad: now by 0.13. The
original's link damping, 0.01 1/s of a link's spin, is left out: beside joint dampings of 0.1 to 5 N m s/rad it is nothing.
"""

import mujoco

from porse.tasks import looks

_XML = """
<mujoco model="Humanoid">
  <compiler angle="degree" autolimits="true"/>
  <option integrator="implicitfast"/>
  <default>
    <geom type="capsule" condim="3" friction="1 0.005 0.0001" contype="1" conaffinity="2" solref="0.0045 1"
          rgba="0.8 0.6 0.4 1"/>
    <joint solreflimit="0.005 1" solimplimit="0.95 0.99 0.001"/>
    <motor ctrlrange="-1 1"/>
    <default class="big_joint">
      <joint armature="0.01" damping="5" stiffness="10"/>
      <default class="big_stiff_joint"><joint stiffness="20"/></default>
    </default>
    <default class="small_joint"><joint armature="0.006" damping="1" stiffness="2"/></default>
    <default class="knee_joint"><joint armature="0.007" damping="0.1" stiffness="5"/></default>
  </default>
  <worldbody>
    <light name="light" pos="0 0 6" dir="0 0 -1" mode="trackcom"/>
    <geom name="floor" type="plane" size="100 100 0.2" contype="2" conaffinity="1" rgba="0.6 0.6 0.6 1"/>
    <body name="torso" pos="0 0 1.34">
      <freejoint name="root"/>
      <geom name="torso" fromto="0 -0.07 0 0 0.07 0" size="0.07"/>
      <geom name="upper_waist" fromto="-0.01 -0.06 -0.12 -0.01 0.06 -0.12" size="0.06"/>
      <body name="head" pos="0 0 0.19"><geom name="head" type="sphere" size="0.09"/></body>
      <body name="lower_waist" pos="-0.01 0 -0.26">
        <geom name="lower_waist" fromto="0 -0.06 0 0 0.06 0" size="0.06"/>
        <joint name="abdomen_z" class="big_stiff_joint" pos="0 0 0.065" axis="0 0 1" range="-45 45" armature="0.02"/>
        <joint name="abdomen_y" class="big_stiff_joint" pos="0 0 0.065" axis="0 1 0" range="-75 30"/>
        <body name="pelvis" pos="0 0 -0.165">
          <joint name="abdomen_x" class="big_joint" pos="0 0 0.1" axis="1 0 0" range="-35 35"/>
          <geom name="butt" fromto="-0.02 -0.07 0 -0.02 0.07 0" size="0.09"/>
          {legs}
        </body>
      </body>
      {arms}
    </body>
  </worldbody>
  <actuator>{motors}</actuator>
  <sensor>
    <force name="right_foot_force" site="right_foot"/><torque name="right_foot_torque" site="right_foot"/>
    <force name="left_foot_force" site="left_foot"/><torque name="left_foot_torque" site="left_foot"/>
  </sensor>
</mujoco>
"""

_LEG = """
<body name="{side}_thigh" pos="0 {y} -0.04">
  <joint name="{side}_hip_x" class="big_joint" axis="{m} 0 0" range="-45 15"/>
  <joint name="{side}_hip_z" class="big_joint" axis="0 0 {m}" range="-60 35"/>
  <joint name="{side}_hip_y" class="big_stiff_joint" axis="0 1 0" range="-120 45"/>
  <geom name="{side}_thigh" fromto="0 0 0 0 {t} -0.34" size="0.06"/>
  <body name="{side}_shin" pos="0 {t} -0.403">
    <joint name="{side}_knee" class="knee_joint" pos="0 0 0.02" axis="0 -1 0" range="-160 2"/>
    <geom name="{side}_shin" fromto="0 0 0 0 0 -0.3" size="0.049"/>
    <body name="{side}_foot" pos="0 0 -0.39">
      <joint name="{side}_ankle_y" class="small_joint" pos="0 0 0.08" axis="0 1 0" range="-50 50"/>
      <joint name="{side}_ankle_x" class="small_joint" pos="0 0 0.08" axis="{m} 0 0.5" range="-50 50"/>
      <geom name="{side}_foot_outer" fromto="-0.07 {o} 0 0.14 {p} 0" size="0.027"/>
      <geom name="{side}_foot_inner" fromto="-0.07 0 0 0.14 {i} 0" size="0.027"/>
      <site name="{side}_foot"/>
    </body>
  </body>
</body>
"""

_ARM = """
<body name="{side}_upper_arm" pos="0 {y} 0.06">
  <joint name="{side}_shoulder1" class="big_joint" axis="2 1 {m}" range="-90 70"/>
  <joint name="{side}_shoulder2" class="big_joint" axis="0 -1 {m}" range="-90 70"/>
  <geom name="{side}_upper_arm" fromto="0 0 0 0.16 {u} -0.16" size="0.04"/>
  <body name="{side}_lower_arm" pos="0.18 {e} -0.18">
    <joint name="{side}_elbow" class="small_joint" axis="0 -1 {k}" range="-90 50"/>
    <geom name="{side}_lower_arm" fromto="0.01 {a} 0.01 0.17 {b} 0.17" size="0.031"/>
    <body name="{side}_hand" pos="0.18 {h} 0.18"><geom name="{side}_hand" type="sphere" size="0.04"/></body>
  </body>
</body>
"""

_LEG_JOINTS = ("hip_x", "hip_z", "hip_y", "knee", "ankle_y", "ankle_x")
_ARM_JOINTS = ("shoulder1", "shoulder2", "elbow")

JOINTS = (
    "abdomen_z", "abdomen_y", "abdomen_x",
    *(f"{side}_{joint}" for side in ("right", "left") for joint in _LEG_JOINTS),
    *(f"{side}_{joint}" for side in ("right", "left") for joint in _ARM_JOINTS),
)  # fmt: skip
"""All joints, in the order of actions and observations."""

GEARS = (67.5, 67.5, 67.5, *(45.0, 45.0, 135.0, 90.0, 22.5, 22.5) * 2, *(67.5, 67.5, 45.0) * 2)
"""Torque (N m) of each joint at action 1."""


def humanoid_scene() -> mujoco.MjSpec:
    """Returns the scene."""
    legs = _LEG.format(side="right", m=1, y=-0.1, t=0.01, o=-0.02, p=-0.04, i=0.02)
    legs += _LEG.format(side="left", m=-1, y=0.1, t=-0.01, o=0.02, p=0.04, i=-0.02)
    arms = _ARM.format(side="right", m=1, k=1, y=-0.17, u=-0.16, e=-0.18, a=0.01, b=0.17, h=0.18)
    arms += _ARM.format(side="left", m=-1, k=-1, y=0.17, u=0.16, e=0.18, a=-0.01, b=-0.17, h=-0.18)
    motors = "".join(
        f'<motor name="{joint}" joint="{joint}" gear="{gear}"/>' for joint, gear in zip(JOINTS, GEARS, strict=True)
    )
    spec = mujoco.MjSpec.from_string(_XML.format(legs=legs, arms=arms, motors=motors))
    looks.surround(spec)
    return spec
