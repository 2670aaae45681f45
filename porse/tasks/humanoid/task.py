"""Humanoid: a capsule figure runs as fast as it can along +x.

After the Isaac Gym task of that name. Departures: the joints' springs act, as MuJoCo reads the original's model file
(whether they do in the original is not known); eight physics steps a control step instead of two, so that feet stay out
of the floor; parts of the figure meet the floor only; foot forces are MuJoCo's force and torque sensors.
"""

import math
from typing import ClassVar

import mujoco
import torch
from torch import Tensor

from porse.sim import rotations
from porse.tasks import looks
from porse.tasks.plain import plain_variables
from porse.tasks.walking import WalkingTask
from porse.variables import Variable

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

FALLEN = 0.8
TARGET = (1000.0, 0.0, 0.0)
FORWARD = torch.tensor([1.0, 0.0, 0.0])
UP = torch.tensor([0.0, 0.0, 1.0])
"""Axes of the torso's own frame."""

EFFORT_RATIO = torch.tensor(GEARS) / 135.0


def wrapped(angle: Tensor) -> Tensor:
    """Returns the angle (rad) in [-pi, pi)."""
    return torch.remainder(angle + math.pi, 2.0 * math.pi) - math.pi


class Humanoid(WalkingTask):
    """Run as fast as possible."""

    NAME = "Humanoid"
    DESCRIPTION = "to make the humanoid run as fast as possible"
    STARTS = (
        "the humanoid stands with its torso at 1.34 m, each joint within 0.2 rad of straight and turning at up to "
        "0.1 rad/s"
    )
    ENDS = "as soon as the torso is lower than 0.8 m"
    FITNESS = "the speed (m/s) at which the humanoid comes nearer to a target 1000 m ahead on the x axis"
    NUM_OBSERVATIONS = 108
    NUM_ACTIONS = 21
    EPISODE_LENGTH = 1000
    TIME_LIMIT = 999
    CONTROL_DT = 0.0166
    SUBSTEPS = 8
    FIELDS = ("qfrc_actuator", "qfrc_passive", "qfrc_constraint", "sensordata")
    JOINTS = JOINTS
    FORCES: ClassVar[dict[str, int]] = {"dof_force_tensor": 21, "vec_sensor_tensor": 12}
    MEASURED = ("dof_force_tensor", "vec_sensor_tensor", "potentials", "prev_potentials")
    VARIABLES = (
        Variable("root_states", "tensor", (13,), "m, 1, m/s, rad/s", "world", "pose and velocities of the torso"),
        Variable("targets", "tensor", (3,), "m", "world", "the place to run to, far ahead"),
        Variable("potentials", "tensor", (), "m/s", "-", "minus the distance to the target, over dt"),
        Variable("prev_potentials", "tensor", (), "m/s", "-", "the same one step before"),
        Variable("dof_pos", "tensor", (21,), "rad", "joint", "joint angles"),
        Variable("dof_vel", "tensor", (21,), "rad/s", "joint", "joint speeds"),
        Variable("dof_limits_lower", "tensor", (21,), "rad", "joint", "lower limits of the joints"),
        Variable("dof_limits_upper", "tensor", (21,), "rad", "joint", "upper limits of the joints"),
        Variable("dof_force_tensor", "tensor", (21,), "N m", "joint", "joint torques"),
        Variable("vec_sensor_tensor", "tensor", (12,), "N, N m", "body", "force and torque at the right and left foot"),
        Variable("up_vec", "tensor", (3,), "1", "world", "up axis of the torso"),
        Variable("heading_vec", "tensor", (3,), "1", "world", "forward axis of the torso"),
        Variable("inv_start_rot", "tensor", (4,), "1", "world", "inverse of the torso's start orientation"),
        Variable("basis_vec0", "tensor", (3,), "1", "body", "forward axis in the torso's own frame"),
        Variable("basis_vec1", "tensor", (3,), "1", "body", "up axis in the torso's own frame"),
        Variable("dof_vel_scale", "float", (), "1", "-", "scale of joint speeds in the observations"),
        Variable("angular_velocity_scale", "float", (), "1", "-", "scale of angular velocities in the observations"),
        Variable("contact_force_scale", "float", (), "1", "-", "scale of joint and foot forces in the observations"),
        Variable("power_scale", "float", (), "1", "-", "scale of the joint torques that actions ask for"),
        Variable("dt", "float", (), "s", "-", "control step"),
        *plain_variables(108, 21),
    )
    OBSERVATION_HELPERS = (wrapped,)
    dt: ClassVar[float] = CONTROL_DT
    dof_vel_scale: ClassVar[float] = 0.1
    angular_velocity_scale: ClassVar[float] = 0.25
    contact_force_scale: ClassVar[float] = 0.01
    power_scale: ClassVar[float] = 1.0

    dof_force_tensor: Tensor
    vec_sensor_tensor: Tensor

    @classmethod
    def scene(cls) -> mujoco.MjSpec:
        """Returns the figure on a plane."""
        spec = looks.read_scene(__file__)
        looks.surround(spec)
        return spec

    def _prepare(self) -> None:
        super()._prepare()
        limits = torch.tensor([self._physics.model.joint(name).range.tolist() for name in JOINTS])
        self.dof_limits_lower = limits[:, 0].repeat(self.num_envs, 1)
        self.dof_limits_upper = limits[:, 1].repeat(self.num_envs, 1)
        self.targets = torch.tensor(TARGET).repeat(self.num_envs, 1)
        self.inv_start_rot = torch.tensor([0.0, 0.0, 0.0, 1.0]).repeat(self.num_envs, 1)
        self._axes = torch.stack((UP, FORWARD))
        self.basis_vec0 = FORWARD.repeat(self.num_envs, 1)
        self.basis_vec1 = UP.repeat(self.num_envs, 1)
        self.potentials = torch.zeros(self.num_envs)
        self.prev_potentials = torch.zeros(self.num_envs)

    def _start(self, ids: Tensor) -> None:
        n = len(ids)
        angles = self._uniform(-0.2, 0.2, n, 21).clamp(self.dof_limits_lower[0], self.dof_limits_upper[0])
        self._physics.qpos[ids.unsqueeze(-1), self._qpos_index] = angles.to(self._physics.real)
        self._physics.qvel[ids.unsqueeze(-1), self._qvel_index] = self._uniform(-0.1, 0.1, n, 21).to(self._physics.real)

    def _act(self) -> None:
        self._physics.ctrl[:] = self.power_scale * self.actions.to(self._physics.real)

    def _measure(self) -> None:
        read = self._physics.read
        forces = read("qfrc_actuator").add_(read("qfrc_passive")).add_(read("qfrc_constraint"))
        self.dof_force_tensor = forces.index_select(1, self._qvel_index)
        self.vec_sensor_tensor = read("sensordata")
        self._name_measurements()
        self.prev_potentials = self.potentials
        self.potentials = self._potential()

    def _measure_started(self, ids: Tensor) -> None:
        super()._measure_started(ids)
        start = self._potential()[ids]
        self.prev_potentials = self.prev_potentials.index_copy(0, ids, start)
        self.potentials = self.potentials.index_copy(0, ids, start)

    def _name_measurements(self) -> None:
        super()._name_measurements()
        turned = rotations.rotate(self.root_states[:, 3:7].unsqueeze(1), self._axes)
        self.up_vec, self.heading_vec = turned.unbind(1)

    def _potential(self) -> Tensor:
        """Returns minus the horizontal distance to the target over the control step, `(num_envs,)`."""
        return -torch.norm(self.targets[:, :2] - self.root_states[:, :2], dim=-1) / self.CONTROL_DT

    def compute_observations(self) -> Tensor:
        """Returns the observations before clipping, `(num_envs, 108)`."""
        position, orientation = self.root_states[:, 0:3], self.root_states[:, 3:7]
        turned = rotations.multiply(orientation, self.inv_start_rot)
        angles = rotations.euler_xyz(turned)
        to_target = self.targets - position
        bearing = torch.atan2(to_target[:, 1], to_target[:, 0])
        direction = to_target[:, :2] / torch.norm(to_target[:, :2], dim=-1, keepdim=True)
        lower, upper = self.dof_limits_lower, self.dof_limits_upper
        return torch.cat(
            (
                position[:, 2:3],
                rotations.rotate_inverse(turned, self.root_states[:, 7:10]),
                self.angular_velocity_scale * rotations.rotate_inverse(turned, self.root_states[:, 10:13]),
                wrapped(angles[:, 2:3]),
                wrapped(angles[:, 0:1]),
                wrapped(bearing.unsqueeze(-1) - angles[:, 2:3]),
                self.up_vec[:, 2:3],
                (self.heading_vec[:, :2] * direction).sum(dim=-1, keepdim=True),
                (2.0 * self.dof_pos - upper - lower) / (upper - lower),
                self.dof_vel_scale * self.dof_vel,
                self.contact_force_scale * self.dof_force_tensor,
                self.contact_force_scale * self.vec_sensor_tensor,
                self.actions,
            ),
            dim=-1,
        )

    def progress_speed(self) -> Tensor:
        """Returns how fast (m/s) the last step came nearer to the target, `(num_envs,)`."""
        return self.potentials - self.prev_potentials

    def failed(self) -> Tensor:
        """Returns where the torso is below 0.8 m."""
        return self.root_states[:, 2] < FALLEN

    def fitness(self) -> float:
        """Returns the mean progress (m/s) of the last step."""
        return float(Humanoid.mean_fitness(self))

    def mean_fitness(self) -> Tensor:
        """Returns the same as a tensor."""
        return self.progress_speed().mean()

    def sparse_reward(self) -> Tensor:
        """Returns the progress (m/s) of the last step."""
        return self.progress_speed()

    def human_reward(self) -> Tensor:
        """Returns the original's reward: progress, staying up, heading; actions, power and joint limits cost."""
        observations = self.compute_observations()
        up, heading = observations[:, 10], observations[:, 11]
        joints, speeds = observations[:, 12:33], observations[:, 33:54]
        upright = torch.where(up > 0.93, 0.1, 0.0)
        ahead = torch.where(heading > 0.8, 0.5, 0.5 * heading / 0.8)
        excess = 0.25 * (joints.abs() - 0.98) / 0.02
        limits = (torch.where(joints.abs() > 0.98, excess, 0.0) * EFFORT_RATIO).sum(dim=-1)
        power = ((self.actions * speeds).abs() * EFFORT_RATIO).sum(dim=-1)
        effort = (self.actions * self.actions).sum(dim=-1)
        reward = self.progress_speed() + 2.0 + upright + ahead - 0.01 * effort - 0.05 * power - limits
        return torch.where(self.failed(), -1.0, reward)
