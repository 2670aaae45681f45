"""Quadcopter: four tilting rotors on a small chassis reach and hover near a fixed position.

After the Isaac Gym task of that name: geometry, masses, actions, observations, resets and reward are the same.
Departures: the rotor joints follow their targets with a damping of 10 N m s/rad (the original: none), because
stiffness 1000 on 9e-5 kg m2 needs it at this time step, and their limits hold because the targets keep them; the
bound on the chassis' angular velocity is applied once a control step; parts do not collide, since episodes end above
the ground.
"""

import math

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
MAX_THRUST = 2.0
TILT_RATE = 8.0 * math.pi
THRUST_RATE = 200.0
TOO_FAR = 3.0
TOO_LOW = 0.3


class Quadcopter(Task):
    """Reach and hover near (0, 0, 1)."""

    NAME = "Quadcopter"
    FAMILY = "isaac"
    DESCRIPTION = "to make the quadcopter reach and hover near a fixed position"
    STARTS = (
        "the quadcopter is at rest and level, up to 1.5 m from the target along x and along y, and from 0.2 m "
        "below it to 1.5 m above it; the rotors are tilted by up to 0.2 rad and give no thrust"
    )
    ENDS = "as soon as the quadcopter is farther than 3 m from the target or lower than 0.3 m"
    FITNESS = "minus the distance (m) between quadcopter and target; 0 is the best"
    NUM_OBSERVATIONS = 21
    NUM_ACTIONS = 12
    EPISODE_LENGTH = 500
    TIME_LIMIT = 499
    CONTROL_DT = 0.01
    SUBSTEPS = 2
    OBSERVATION_CLIP = 5.0
    VARIABLES = (
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
        spec = looks.read_scene(__file__)
        looks.surround(spec, centre=TARGET)
        return spec

    def _prepare(self) -> None:
        self.target_root_positions = torch.tensor(TARGET).repeat(self.num_envs, 1)
        # A free joint has its position first, and then its orientation as MuJoCo orders it.
        self._orientation = torch.tensor([3 + part for part in rotations.XYZW_FROM_WXYZ])
        tilts, thrusts, real = 8, 4, self._physics.real
        self._rates = torch.tensor([TILT_RATE] * tilts + [THRUST_RATE] * thrusts, dtype=real)
        self._least = torch.tensor([-TILT_LIMIT] * tilts + [0.0] * thrusts, dtype=real)
        self._most = torch.tensor([TILT_LIMIT] * tilts + [MAX_THRUST] * thrusts, dtype=real)

    def _start(self, ids: Tensor) -> None:
        n = len(ids)
        physics = self._physics
        physics.qpos[ids, 0:2] = self._uniform(-1.5, 1.5, n, 2).to(physics.real)
        physics.qpos[ids, 2] = START_HEIGHT + self._uniform(-0.2, 1.5, n).to(physics.real)
        joints = self._uniform(-0.2, 0.2, n, 8).to(physics.real)
        physics.qpos[ids, 7:] = joints
        physics.ctrl[ids, :8] = joints

    def _act(self) -> None:
        spin = self._physics.qvel[:, 3:6]
        spin *= (MAX_ANGULAR_VELOCITY / torch.linalg.vector_norm(spin, dim=-1, keepdim=True)).clamp(max=1.0)
        change = (self.actions.to(self._physics.real) * self.CONTROL_DT).mul_(self._rates)
        self._physics.ctrl.add_(change).clamp_(self._least, self._most)

    def _measure(self) -> None:
        qpos = self._physics.positions()
        qvel = self._physics.velocities()
        self.root_positions = qpos[:, 0:3]
        self.root_quats = qpos.index_select(1, self._orientation)
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
        return torch.linalg.vector_norm(self.target_root_positions - self.root_positions, dim=-1)

    def failed(self) -> Tensor:
        """Returns where the quadcopter is farther than 3 m from the target or lower than 0.3 m."""
        return (self.distance() > TOO_FAR) | (self.root_positions[:, 2] < TOO_LOW)

    def fitness(self) -> float:
        """Returns the mean of minus the distance (m) from the target."""
        return float(Quadcopter.mean_fitness(self))

    def mean_fitness(self) -> Tensor:
        """Returns the same as a tensor."""
        return -self.distance().mean()

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
