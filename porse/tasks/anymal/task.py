"""Anymal: a quadruped follows commanded forward, sideways and turning velocities.

After the Isaac Gym task of that name. Departures: eight physics steps of 2.5 ms a control step instead of two of 10 ms,
so that feet stay out of the floor; legs meet the floor only; masses of the links are ours (their sum is the robot's); joints
begin a physics step at 20 rad/s at most, and may end it faster.
"""

from typing import ClassVar

import mujoco
import torch
from torch import Tensor

from porse.sim import rotations
from porse.tasks import looks
from porse.tasks.plain import plain_variables
from porse.tasks.walking import WalkingTask
from porse.variables import Variable

JOINTS = tuple(f"{leg}_{joint}" for leg in ("LF", "LH", "RF", "RH") for joint in ("HAA", "HFE", "KFE"))
"""All joints, in the order of actions and observations: hip abduction, hip flexion, knee flexion of each leg."""

FASTEST = 20.0
"""Highest speed (rad/s) of a joint, by the robot's description."""

DEFAULT = torch.tensor([0.03, 0.4, -0.8, 0.03, -0.4, 0.8, -0.03, 0.4, -0.8, -0.03, -0.4, 0.8])
"""Default joint angles (rad), in the order of `JOINTS`."""

ACTION_SCALE = 0.5
TOUCHED = 1.0
"""Contact force (N) on the base or a thigh above which an episode ends."""


class Anymal(WalkingTask):
    """Follow velocity commands."""

    NAME = "Anymal"
    DESCRIPTION = "to make the quadruped follow randomly chosen x, y, and yaw target velocities"
    STARTS = (
        "the quadruped stands at rest with its base at 0.62 m, its joints at 0.5 to 1.5 times their default "
        "angles, and a target velocity is drawn: x in [-2, 2] m/s, y in [-1, 1] m/s, yaw in [-1, 1] rad/s"
    )
    ENDS = "as soon as the base or a thigh touches something with more than 1 N"
    FITNESS = (
        "minus the squared errors of the velocities in the body's frame, (m/s)^2 over x and y plus (rad/s)^2 of "
        "the yaw; 0 is the best"
    )
    NUM_OBSERVATIONS = 48
    NUM_ACTIONS = 12
    EPISODE_LENGTH = 2500
    TIME_LIMIT = 2499
    CONTROL_DT = 0.02
    SUBSTEPS = 8
    FIELDS = ("qfrc_actuator", "qfrc_passive", "sensordata")
    JOINTS = JOINTS
    FORCES: ClassVar[dict[str, int]] = {"torques": 12, "_touch": 5}
    MEASURED = ("torques", "_touch", "commands")
    VARIABLES = (
        Variable("root_states", "tensor", (13,), "m, 1, m/s, rad/s", "world", "pose and velocities of the base"),
        Variable("dof_pos", "tensor", (12,), "rad", "joint", "joint angles: HAA, HFE, KFE of LF, LH, RF, RH"),
        Variable("default_dof_pos", "tensor", (12,), "rad", "joint", "joint angles of the default stance"),
        Variable("dof_vel", "tensor", (12,), "rad/s", "joint", "joint speeds"),
        Variable("commands", "tensor", (3,), "m/s, m/s, rad/s", "body", "velocities to follow: forward, left, turn"),
        Variable("gravity_vec", "tensor", (3,), "1", "world", "direction of gravity"),
        Variable("torques", "tensor", (12,), "N m", "joint", "joint torques"),
        Variable("lin_vel_scale", "float", (), "1", "-", "scale of linear velocities in the observations"),
        Variable("ang_vel_scale", "float", (), "1", "-", "scale of angular velocities in the observations"),
        Variable("dof_pos_scale", "float", (), "1", "-", "scale of joint angles in the observations"),
        Variable("dof_vel_scale", "float", (), "1", "-", "scale of joint speeds in the observations"),
        *plain_variables(48, 12),
    )
    lin_vel_scale: ClassVar[float] = 2.0
    ang_vel_scale: ClassVar[float] = 0.25
    dof_pos_scale: ClassVar[float] = 1.0
    dof_vel_scale: ClassVar[float] = 0.05

    commands: Tensor
    torques: Tensor
    _touch: Tensor

    @classmethod
    def scene(cls) -> mujoco.MjSpec:
        """Returns the quadruped on a plane."""
        spec = looks.read_scene(__file__)
        looks.surround(spec)
        return spec

    def _prepare(self) -> None:
        super()._prepare()
        fastest = torch.full((self._physics.model.nv,), float("inf"), dtype=self._physics.real)
        fastest[self._qvel_index] = FASTEST
        self._physics.fastest = fastest
        self.default_dof_pos = DEFAULT.repeat(self.num_envs, 1)
        self.gravity_vec = torch.tensor([0.0, 0.0, -1.0]).repeat(self.num_envs, 1)
        self.commands = torch.zeros(self.num_envs, 3)

    def _start(self, ids: Tensor) -> None:
        n = len(ids)
        angles = (DEFAULT * self._uniform(0.5, 1.5, n, 12)).to(self._physics.real)
        self._physics.qpos[ids.unsqueeze(-1), self._qpos_index] = angles
        self._physics.ctrl[ids] = angles
        self._physics.qvel[ids.unsqueeze(-1), self._qvel_index] = self._uniform(-0.1, 0.1, n, 12).to(self._physics.real)
        self.commands[ids] = self._uniform(-1.0, 1.0, n, 3) * torch.tensor([2.0, 1.0, 1.0])

    def _act(self) -> None:
        self._physics.ctrl[:] = (DEFAULT + ACTION_SCALE * self.actions).to(self._physics.real)

    def _measure(self) -> None:
        read = self._physics.read
        forces = read("qfrc_actuator").add_(read("qfrc_passive"))
        self.torques = forces.index_select(1, self._qvel_index)
        self._touch = read("sensordata")
        self._name_measurements()

    def compute_observations(self) -> Tensor:
        """Returns the observations before clipping, `(num_envs, 48)`. Gravity is turned as in the original."""
        orientation = self.root_states[:, 3:7]
        scales = torch.tensor([self.lin_vel_scale, self.lin_vel_scale, self.ang_vel_scale])
        return torch.cat(
            (
                rotations.rotate_inverse(orientation, self.root_states[:, 7:10]) * self.lin_vel_scale,
                rotations.rotate_inverse(orientation, self.root_states[:, 10:13]) * self.ang_vel_scale,
                rotations.rotate(orientation, self.gravity_vec),
                self.commands * scales,
                (self.dof_pos - self.default_dof_pos) * self.dof_pos_scale,
                self.dof_vel * self.dof_vel_scale,
                self.actions,
            ),
            dim=-1,
        )

    def errors(self) -> tuple[Tensor, Tensor]:
        """Returns the squared errors of the linear (m2/s2) and turning (rad2/s2) velocity, `(num_envs,)` each."""
        orientation = self.root_states[:, 3:7]
        linear = rotations.rotate_inverse(orientation, self.root_states[:, 7:10])
        angular = rotations.rotate_inverse(orientation, self.root_states[:, 10:13])
        off = self.commands[:, :2] - linear[:, :2]
        turn = self.commands[:, 2] - angular[:, 2]
        return (off * off).sum(dim=-1), turn * turn

    def failed(self) -> Tensor:
        """Returns where the base or a thigh touches something with more than 1 N."""
        return (self._touch > TOUCHED).any(dim=-1)

    def fitness(self) -> float:
        """Returns minus the mean of the squared velocity errors."""
        return float(Anymal.mean_fitness(self))

    def mean_fitness(self) -> Tensor:
        """Returns the same as a tensor."""
        return self.sparse_reward().mean()

    def sparse_reward(self) -> Tensor:
        """Returns minus the squared velocity errors."""
        linear, angular = self.errors()
        return -(linear + angular)

    def human_reward(self) -> Tensor:
        """Returns max(0, dt (exp(-e_linear / 0.25) + 0.5 exp(-e_angular / 0.25) - 2.5e-5 sum of torques^2))."""
        linear, angular = self.errors()
        follow = torch.exp(-linear / 0.25) + 0.5 * torch.exp(-angular / 0.25)
        effort = (self.torques * self.torques).sum(dim=-1)
        return (self.CONTROL_DT * (follow - 2.5e-5 * effort)).clamp(min=0.0)
