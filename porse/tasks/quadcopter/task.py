"""Quadcopter: four tilting rotors on a small chassis reach and hover near a fixed position.

After the Isaac Gym task of that name: geometry, masses, actions, observations, resets and reward are the same.
Departures: the rotor joints follow their targets with a damping of 10 N m s/rad (the original: none), because
stiffness 1000 on 9e-5 kg m2 needs it at this time step, and their limits hold because the targets keep them; the
bound on the chassis' angular velocity is applied once a control step; parts do not collide, since episodes end above
the ground.
"""

import math
from typing import ClassVar

import mujoco
import torch
from torch import Tensor

from porse.sim import rotations
from porse.tasks import looks
from porse.tasks.base import Task
from porse.tasks.plain import plain_variables
from porse.variables import Variable

TARGET = (0.0, 0.0, 1.0)
START_HEIGHT = 1.0
MAX_ANGULAR_VELOCITY = 4.0 * math.pi
TILT_LIMIT = math.pi / 6
JOINT_STIFFNESS = 1000.0
JOINT_DAMPING = 10.0
MAX_THRUST = 2.0
TILT_RATE = 8.0 * math.pi
THRUST_RATE = 200.0
TOO_FAR = 3.0
TOO_LOW = 0.3
ARM_RADIUS = 0.01
CHASSIS_RADIUS = 0.1
ROTOR_RADIUS = 0.04


def _add_arm(spec: mujoco.MjSpec, chassis: mujoco.MjsBody, index: int) -> None:
    """Adds one arm ("pitch", about its y axis) and its rotor ("roll", about its x axis)."""
    yaw = math.pi / 4 + index * math.pi / 2
    radius = CHASSIS_RADIUS + 0.25 * ARM_RADIUS
    quaternion = [math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)]
    arm = chassis.add_body(name=f"arm{index}", pos=[radius * math.cos(yaw), radius * math.sin(yaw), 0], quat=quaternion)
    arm.add_geom(
        name=f"arm{index}", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[ARM_RADIUS, 0, 0], density=200,
        contype=0, conaffinity=0, rgba=[0.3, 0.3, 0.3, 1],
    )  # fmt: skip
    rotor = arm.add_body(name=f"rotor{index}", pos=[ROTOR_RADIUS + 0.25 * ARM_RADIUS, 0, 0])
    rotor.add_geom(
        name=f"rotor{index}", type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[ROTOR_RADIUS, 0.005, 0], density=1000,
        contype=0, conaffinity=0, rgba=[0.8, 0.3, 0.2, 1],
    )  # fmt: skip
    rotor.add_site(name=f"thrust{index}")
    for body, name, axis in ((arm, "pitch", [0, 1, 0]), (rotor, "roll", [1, 0, 0])):
        body.add_joint(
            name=f"{name}{index}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis, damping=JOINT_DAMPING,
        )  # fmt: skip
        drive = spec.add_actuator(
            name=f"{name}{index}", trntype=mujoco.mjtTrn.mjTRN_JOINT, target=f"{name}{index}", forcelimited=True,
            # Against the damping, this bound is the original's bound on the joint's speed.
            forcerange=[-JOINT_DAMPING * MAX_ANGULAR_VELOCITY, JOINT_DAMPING * MAX_ANGULAR_VELOCITY],
        )  # fmt: skip
        drive.set_to_position(JOINT_STIFFNESS)


class Quadcopter(Task):
    """Reach and hover near (0, 0, 1)."""

    NAME: ClassVar[str] = "Quadcopter"
    FAMILY: ClassVar[str] = "isaac"
    DESCRIPTION: ClassVar[str] = "to make the quadcopter reach and hover near a fixed position"
    STARTS: ClassVar[str] = (
        "the quadcopter is at rest and level, up to 1.5 m from the target along x and along y, and from 0.2 m "
        "below it to 1.5 m above it; the rotors are tilted by up to 0.2 rad and give no thrust"
    )
    ENDS: ClassVar[str] = "as soon as the quadcopter is farther than 3 m from the target or lower than 0.3 m"
    FITNESS: ClassVar[str] = "minus the distance (m) between quadcopter and target; 0 is the best"
    NUM_OBSERVATIONS: ClassVar[int] = 21
    NUM_ACTIONS: ClassVar[int] = 12
    EPISODE_LENGTH: ClassVar[int] = 500
    TIME_LIMIT: ClassVar[int] = 499
    CONTROL_DT: ClassVar[float] = 0.01
    SUBSTEPS: ClassVar[int] = 2
    OBSERVATION_CLIP: ClassVar[float] = 5.0
    VARIABLES: ClassVar[tuple[Variable, ...]] = (
        Variable("root_positions", "tensor", (3,), "m", "world", "position of the chassis"),
        Variable("root_quats", "tensor", (4,), "1", "world", "orientation of the chassis"),
        Variable("root_linvels", "tensor", (3,), "m/s", "world", "linear velocity of the chassis"),
        Variable("root_angvels", "tensor", (3,), "rad/s", "world", "angular velocity of the chassis"),
        Variable("dof_positions", "tensor", (8,), "rad", "joint", "tilt of the rotors: pitch0, roll0, pitch1, ..."),
        Variable("target_root_positions", "tensor", (3,), "m", "world", "the position to reach"),
        *plain_variables(21, 12),
    )

    @classmethod
    def scene(cls) -> mujoco.MjSpec:
        """Returns the chassis with four arms above a floor."""
        spec = mujoco.MjSpec()
        spec.modelname = cls.NAME
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.worldbody.add_light(name="light", pos=[0, 0, 4], dir=[0, 0, -1])
        spec.worldbody.add_geom(
            name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[4, 4, 0.1], contype=0, conaffinity=0,
            rgba=[0.6, 0.6, 0.6, 1],
        )  # fmt: skip
        spec.worldbody.add_site(name="target", pos=TARGET, size=[0.03, 0.03, 0.03], rgba=[0.2, 0.8, 0.2, 0.5])
        chassis = spec.worldbody.add_body(name="chassis", pos=[0, 0, START_HEIGHT])
        chassis.add_freejoint(name="root")
        chassis.add_geom(
            name="chassis", type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[CHASSIS_RADIUS, 0.015, 0], density=50,
            contype=0, conaffinity=0, rgba=[0.2, 0.3, 0.6, 1],
        )  # fmt: skip
        for index in range(4):
            _add_arm(spec, chassis, index)
        for index in range(4):
            thrust = spec.add_actuator(
                name=f"thrust{index}", trntype=mujoco.mjtTrn.mjTRN_SITE, target=f"thrust{index}",
                gear=[0, 0, 1, 0, 0, 0],
            )  # fmt: skip
            thrust.set_to_motor()
        looks.surround(spec, centre=(0.0, 0.0, 1.0))
        return spec

    def _prepare(self) -> None:
        self.target_root_positions = torch.tensor(TARGET).repeat(self.num_envs, 1)

    def _start(self, ids: Tensor) -> None:
        n = len(ids)
        physics = self._physics
        physics.qpos[ids, 0:2] = self._uniform(-1.5, 1.5, n, 2).double()
        physics.qpos[ids, 2] = START_HEIGHT + self._uniform(-0.2, 1.5, n).double()
        joints = self._uniform(-0.2, 0.2, n, 8).double()
        physics.qpos[ids, 7:] = joints
        physics.ctrl[ids, :8] = joints

    def _act(self) -> None:
        spin = self._physics.qvel[:, 3:6]
        spin *= (MAX_ANGULAR_VELOCITY / torch.norm(spin, dim=-1, keepdim=True)).clamp(max=1.0)
        rate = self.actions.double() * self.CONTROL_DT
        ctrl = self._physics.ctrl
        ctrl[:, :8] = (ctrl[:, :8] + TILT_RATE * rate[:, :8]).clamp(-TILT_LIMIT, TILT_LIMIT)
        ctrl[:, 8:] = (ctrl[:, 8:] + THRUST_RATE * rate[:, 8:]).clamp(0.0, MAX_THRUST)

    def _measure(self) -> None:
        qpos = self._physics.qpos.float()
        qvel = self._physics.qvel.float()
        self.root_positions = qpos[:, 0:3]
        self.root_quats = qpos[:, [4, 5, 6, 3]]
        self.root_linvels = qvel[:, 0:3]
        # MuJoCo keeps a free joint's angular velocity in the body's own frame.
        self.root_angvels = rotations.rotate(self.root_quats, qvel[:, 3:6])
        self.dof_positions = qpos[:, 7:]

    def compute_observations(self) -> Tensor:
        """Returns the observations before clipping, `(num_envs, 21)`."""
        return torch.cat(
            (
                (self.target_root_positions - self.root_positions) / 3.0,
                self.root_quats,
                self.root_linvels / 2.0,
                self.root_angvels / math.pi,
                self.dof_positions,
            ),
            dim=-1,
        )

    def distance(self) -> Tensor:
        """Returns the distance (m) from the target, `(num_envs,)`."""
        return torch.norm(self.target_root_positions - self.root_positions, dim=-1)

    def failed(self) -> Tensor:
        """Returns where the quadcopter is farther than 3 m from the target or lower than 0.3 m."""
        return (self.distance() > TOO_FAR) | (self.root_positions[:, 2] < TOO_LOW)

    def fitness(self) -> float:
        """Returns the mean of minus the distance (m) from the target."""
        return -float(self.distance().mean())

    def sparse_reward(self) -> Tensor:
        """Returns minus the distance (m) from the target."""
        return -self.distance()

    def human_reward(self) -> Tensor:
        """Returns p + p (u + s): near the target, and there upright and without spinning."""
        distance = self.distance()
        position = 1.0 / (1.0 + distance * distance)
        tilt = 1.0 - rotations.tilted_up(self.root_quats)
        upright = 1.0 / (1.0 + tilt * tilt)
        spin = self.root_angvels[:, 2]
        still = 1.0 / (1.0 + spin * spin)
        return position + position * (upright + still)
