"""The scene of Anymal: a quadruped with the published frames of ANYmal C on a plane.

Frames, joint limits, effort and total mass are the published ones; how the mass is shared between the links, and the
shapes (a box and capsules), are ours.
"""

import mujoco

from porse.tasks import looks

LEGS = ("LF", "LH", "RF", "RH")

JOINTS = tuple(f"{leg}_{joint}" for leg in LEGS for joint in ("HAA", "HFE", "KFE"))
"""All joints, in the order of actions and observations: hip abduction, hip flexion, knee flexion of each leg."""

STIFFNESS = 85.0
DAMPING = 2.0
EFFORT = 80.0
FASTEST = 20.0
"""Highest speed (rad/s) of a joint, by the robot's description."""


_XML = """
<mujoco model="Anymal">
  <compiler angle="radian" autolimits="true"/>
  <option integrator="implicitfast"/>
  <default>
    <geom contype="1" conaffinity="2" friction="1 0.005 0.0001" solref="0.005 1" rgba="0.3 0.3 0.35 1"/>
    <joint solreflimit="0.005 1" solimplimit="0.95 0.99 0.001"/>
    <site group="4" rgba="1 0 0 0"/>
    <position kp="{stiffness}" kv="{damping}" forcerange="-{effort} {effort}"/>
  </default>
  <worldbody>
    <light name="light" pos="0 0 6" dir="0 0 -1" mode="trackcom"/>
    <geom name="floor" type="plane" size="100 100 0.2" contype="2" conaffinity="1" rgba="0.6 0.6 0.6 1"/>
    <body name="base" pos="0 0 0.62">
      <freejoint name="root"/>
      <inertial pos="0 0 0" mass="26.3" diaginertia="0.35 1.3 1.4"/>
      <geom name="base" type="box" size="0.36 0.12 0.09"/>
      <geom name="front" type="capsule" fromto="0.36 -0.06 0 0.36 0.06 0" size="0.09"/>
      <geom name="hind" type="capsule" fromto="-0.36 -0.06 0 -0.36 0.06 0" size="0.09"/>
      <site name="base" type="box" size="1 1 1"/>
      {legs}
    </body>
  </worldbody>
  <actuator>{drives}</actuator>
  <sensor>{sensors}</sensor>
</mujoco>
"""

_LEG = """
<body name="{leg}_HIP" pos="{hx} {hy} 0">
  <inertial pos="{ix} 0 0" mass="2.78" diaginertia="0.006 0.006 0.006"/>
  <joint name="{leg}_HAA" axis="1 0 0" range="{range}"/>
  <geom name="{leg}_HIP" type="sphere" size="0.05" pos="{ix} 0 0"/>
  <body name="{leg}_THIGH" pos="{fx} {fy} 0">
    <inertial pos="0 {ty} -0.2" mass="3.09" diaginertia="0.03 0.03 0.005"/>
    <joint name="{leg}_HFE" axis="0 1 0" range="-9.42 9.42"/>
    <geom name="{leg}_THIGH" type="capsule" fromto="0 {ty} -0.03 0 {ty} -0.26" size="0.04"/>
    <site name="{leg}_THIGH" type="sphere" size="0.6"/>
    <body name="{leg}_SHANK" pos="0 {ky} -0.285">
      <inertial pos="{sx} 0 -0.17" mass="0.58" diaginertia="0.008 0.008 0.001"/>
      <joint name="{leg}_KFE" axis="0 1 0" range="-9.42 9.42"/>
      <geom name="{leg}_SHANK" type="capsule" fromto="0 0 0 {ex} {ey} -0.338" size="0.02"/>
      <geom name="{leg}_FOOT" type="sphere" size="0.03" pos="{ex} {ey} -0.338"/>
      <site name="{leg}_FOOT" pos="{ex} {ey} -0.338"/>
    </body>
  </body>
</body>
"""


def _leg(leg: str) -> str:
    """Returns one leg; left and right, front and hind are mirrored."""
    side = 1 if leg[0] == "L" else -1
    end = 1 if leg[1] == "F" else -1
    return _LEG.format(
        leg=leg, hx=0.2999 * end, hy=0.104 * side, ix=0.05 * end, fx=0.0599 * end, fy=0.0838 * side, ty=0.09 * side,
        ky=0.1003 * side, sx=0.04 * end, ex=0.088 * end, ey=0.013 * side,
        range="-0.72 0.49" if side > 0 else "-0.49 0.72",
    )  # fmt: skip


def anymal_scene() -> mujoco.MjSpec:
    """Returns the scene. Touch sensors feel what the base and the thighs touch."""
    touched = ("base", *(f"{leg}_THIGH" for leg in LEGS))
    spec = mujoco.MjSpec.from_string(
        _XML.format(
            damping=DAMPING, stiffness=STIFFNESS, effort=EFFORT, legs="".join(_leg(leg) for leg in LEGS),
            drives="".join(f'<position name="{joint}" joint="{joint}"/>' for joint in JOINTS),
            sensors="".join(f'<touch name="{name}" site="{name}"/>' for name in touched),
        )
    )  # fmt: skip
    looks.surround(spec)
    return spec
