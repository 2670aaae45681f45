"""FrankaCabinet: a Panda arm pulls the top drawer of a cabinet open.

After the Isaac Gym task of that name. Departures: the finger drives have stiffness 30 000 and push with 60 N instead of
1e6 and 200 N, which this time step and soft contacts cannot carry; the arm's joints have an armature of 0.1 kg m2 (the original:
none); the step has two physics steps instead of one; the handle is a bar on two posts, and the cubes ride with the drawer
(see `scene.py`). A drive's target leads its joint by no more than drives the joint at its highest speed.
"""

from typing import ClassVar

import mujoco
import torch
from torch import Tensor

from porse.sim import bodies, rotations
from porse.sim.bodies import Bodies
from porse.tasks.franka_cabinet.scene import STANCE, drives, franka_scene
from porse.tasks.plain import plain_variables
from porse.tasks.success import SuccessTask
from porse.variables import Variable

LOWER = torch.tensor([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973, 0.0, 0.0])
UPPER = torch.tensor([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973, 0.04, 0.04])
START = torch.tensor(STANCE)
START_NOISE = 0.125
SPEED = torch.tensor([7.5] * 7 + [0.75] * 2) / 60.0
"""Change of a joint's target in a control step at action 1 (rad; fingers m)."""

OPEN = 0.39
"""Opening (m) at which the drawer counts as open."""

BODY_NAMES = (
    *(f"panda_link{i}" for i in range(8)), "panda_hand", "panda_leftfinger", "panda_rightfinger",
    "cabinet", "door_left", "door_right", "drawer_bottom", "drawer_top",
)  # fmt: skip
CABINET_JOINTS = ("door_left_joint", "door_right_joint", "drawer_bottom_joint", "drawer_top_joint")
DRAWER_GRASP = torch.tensor([0.3, 0.01, 0.0])
FINGER_REACH = torch.tensor([0.0, 0.04, 0.1654])
"""Grasp point in the frame of link 7 (m): between the fingers, and 4 cm along its y axis as in the original."""

FINGER_TURN = torch.tensor([0.0, 0.0, -0.38268343, 0.92387953])
"""Turn of the fingers in the frame of link 7: -45 degrees about z."""


class FrankaCabinet(SuccessTask):
    """Open the top drawer."""

    NAME = "FrankaCabinet"
    FAMILY = "isaac"
    DESCRIPTION = "to open the cabinet door"
    STARTS = "the cabinet is shut, and the arm is at rest in front of it, each joint within 0.125 rad of one pose"
    ENDS = "as soon as the top drawer is open by more than 0.39 m"
    FITNESS = "the share of episodes in which the top drawer came to be open by more than 0.39 m"
    NUM_OBSERVATIONS = 23
    NUM_ACTIONS = 9
    EPISODE_LENGTH = 500
    TIME_LIMIT = 499
    CONTROL_DT = 0.0166
    SUBSTEPS = 2
    OBSERVATION_CLIP = 5.0
    FIELDS = bodies.FIELDS
    MEASURED = ("rigid_body_states", "successes", "outcomes", "_targets")
    VARIABLES = (
        Variable("franka_grasp_pos", "tensor", (3,), "m", "world", "grasp point of the gripper"),
        Variable("franka_grasp_rot", "tensor", (4,), "1", "world", "orientation of the gripper"),
        Variable("drawer_grasp_pos", "tensor", (3,), "m", "world", "grasp point of the top drawer's handle"),
        Variable("drawer_grasp_rot", "tensor", (4,), "1", "world", "orientation of the top drawer"),
        Variable(
            "franka_local_grasp_pos", "tensor", (3,), "m", "body", "grasp point in the frame of the last arm link"
        ),
        Variable("franka_local_grasp_rot", "tensor", (4,), "1", "body", "turn of the gripper in that frame"),
        Variable("drawer_local_grasp_pos", "tensor", (3,), "m", "body", "grasp point in the frame of the top drawer"),
        Variable("drawer_local_grasp_rot", "tensor", (4,), "1", "body", "turn of the handle in that frame: none"),
        Variable("franka_lfinger_pos", "tensor", (3,), "m", "world", "position of the left finger"),
        Variable("franka_lfinger_rot", "tensor", (4,), "1", "world", "orientation of the left finger"),
        Variable("franka_rfinger_pos", "tensor", (3,), "m", "world", "position of the right finger"),
        Variable("franka_rfinger_rot", "tensor", (4,), "1", "world", "orientation of the right finger"),
        Variable("cabinet_dof_pos", "tensor", (4,), "rad, m", "joint", "cabinet joints; index 3 is the top drawer"),
        Variable("cabinet_dof_vel", "tensor", (4,), "rad/s, m/s", "joint", "their speeds"),
        Variable("franka_dof_pos", "tensor", (9,), "rad, m", "joint", "arm joints (7), then fingers (2)"),
        Variable("franka_dof_vel", "tensor", (9,), "rad/s, m/s", "joint", "their speeds"),
        Variable("franka_dof_lower_limits", "tensor", (9,), "rad, m", "joint", "their lower limits"),
        Variable("franka_dof_upper_limits", "tensor", (9,), "rad, m", "joint", "their upper limits"),
        Variable("dof_vel_scale", "float", (), "1", "-", "scale of the speeds in the observations"),
        Variable("rigid_body_states", "tensor", (16, 13), "m, 1, m/s, rad/s", "world", "all bodies"),
        Variable("hand_handle", "int", (), "1", "-", "index of the last arm link in rigid_body_states"),
        Variable("lfinger_handle", "int", (), "1", "-", "index of the left finger in rigid_body_states"),
        Variable("rfinger_handle", "int", (), "1", "-", "index of the right finger in rigid_body_states"),
        Variable("drawer_handle", "int", (), "1", "-", "index of the top drawer in rigid_body_states"),
        *plain_variables(23, 9),
    )

    dof_vel_scale: ClassVar[float] = 0.1
    hand_handle: ClassVar[int] = BODY_NAMES.index("panda_link7")
    lfinger_handle: ClassVar[int] = BODY_NAMES.index("panda_leftfinger")
    rfinger_handle: ClassVar[int] = BODY_NAMES.index("panda_rightfinger")
    drawer_handle: ClassVar[int] = BODY_NAMES.index("drawer_top")

    @classmethod
    def scene(cls) -> mujoco.MjSpec:
        """Returns the arm before the cabinet."""
        return franka_scene(cls.CONTROL_DT / cls.SUBSTEPS)

    def _prepare(self) -> None:
        super()._prepare()
        self._bodies = Bodies(self._physics, BODY_NAMES)
        model = self._physics.model
        dt = self.CONTROL_DT / self.SUBSTEPS
        self._lead = torch.tensor([drive.lead for drive in drives(dt).values()], dtype=torch.float64)
        self._lower, self._upper = LOWER.double(), UPPER.double()
        self._targets = torch.zeros(self.num_envs, 9, dtype=torch.float64)
        self._drawers = torch.tensor([int(model.joint(name).qposadr[0]) for name in CABINET_JOINTS])
        self.franka_dof_lower_limits = LOWER.repeat(self.num_envs, 1)
        self.franka_dof_upper_limits = UPPER.repeat(self.num_envs, 1)
        self.franka_local_grasp_pos = FINGER_REACH.repeat(self.num_envs, 1)
        self.franka_local_grasp_rot = FINGER_TURN.repeat(self.num_envs, 1)
        self.drawer_local_grasp_pos = DRAWER_GRASP.repeat(self.num_envs, 1)
        self.drawer_local_grasp_rot = torch.tensor([0.0, 0.0, 0.0, 1.0]).repeat(self.num_envs, 1)
        self.rigid_body_states = torch.zeros(self.num_envs, len(BODY_NAMES), 13)

    def _start(self, ids: Tensor) -> None:
        super()._start(ids)
        joints = (START + self._uniform(-START_NOISE, START_NOISE, len(ids), 9)).clamp(LOWER, UPPER).double()
        self._physics.qpos[ids, :9] = joints.to(self._physics.real)
        self._physics.ctrl[ids] = joints.to(self._physics.real)
        self._targets[ids] = joints

    def _act(self) -> None:
        self._targets = (self._targets + (SPEED * self.actions).double()).clamp(self._lower, self._upper)
        joints = self._physics.qpos[:, :9]
        self._physics.ctrl.copy_(self._targets.clamp(joints - self._lead, joints + self._lead))

    def _measure(self) -> None:
        self.rigid_body_states = self._bodies.states()
        self._name_measurements()

    def _measure_started(self, ids: Tensor) -> None:
        self.rigid_body_states[ids] = self._bodies.states(ids)
        self._name_measurements()

    def _remeasure(self) -> None:
        self._name_measurements()

    def _name_measurements(self) -> None:
        """Sets the variables from the body states and the joints."""
        qpos, qvel = self._physics.positions(), self._physics.velocities()
        self.franka_dof_pos, self.franka_dof_vel = qpos[:, :9], qvel[:, :9]
        self.cabinet_dof_pos = qpos.index_select(1, self._drawers)
        self.cabinet_dof_vel = qvel.index_select(1, self._drawers)
        states = self.rigid_body_states
        hand, drawer = states[:, self.hand_handle], states[:, self.drawer_handle]
        left, right = states[:, self.lfinger_handle], states[:, self.rfinger_handle]
        self.franka_lfinger_pos, self.franka_lfinger_rot = left[:, 0:3], left[:, 3:7]
        self.franka_rfinger_pos, self.franka_rfinger_rot = right[:, 0:3], right[:, 3:7]
        self.franka_grasp_pos = hand[:, 0:3] + rotations.rotate(hand[:, 3:7], FINGER_REACH)
        self.franka_grasp_rot = rotations.multiply(hand[:, 3:7], FINGER_TURN)
        self.drawer_grasp_pos = drawer[:, 0:3] + rotations.rotate(drawer[:, 3:7], DRAWER_GRASP)
        self.drawer_grasp_rot = drawer[:, 3:7]

    def compute_observations(self) -> Tensor:
        """Returns the observations before clipping, `(num_envs, 23)`."""
        lower, upper = self.franka_dof_lower_limits, self.franka_dof_upper_limits
        return torch.cat(
            (
                2.0 * (self.franka_dof_pos - lower) / (upper - lower) - 1.0,
                self.franka_dof_vel * self.dof_vel_scale,
                self.drawer_grasp_pos - self.franka_grasp_pos,
                self.cabinet_dof_pos[:, 3:4],
                self.cabinet_dof_vel[:, 3:4],
            ),
            dim=-1,
        )

    def succeeded(self) -> Tensor:
        """Returns where the top drawer is open by more than 39 cm."""
        return self.cabinet_dof_pos[:, 3] > OPEN

    def failed(self) -> Tensor:
        """Returns the same: an episode ends when the drawer is open."""
        return self.succeeded()

    def human_reward(self) -> Tensor:
        """Returns the original's reward: near, aligned, fingers around the handle, drawer opening; small actions."""
        handle, opening = self.drawer_grasp_pos, self.cabinet_dof_pos[:, 3]
        distance = torch.norm(self.franka_grasp_pos - handle, dim=-1)
        near = 1.0 / (1.0 + distance * distance)
        near = near * near
        near = torch.where(distance <= 0.02, 2.0 * near, near)
        aligned = 0.5 * (self._alignment((0, 0, 1), (-1, 0, 0)) + self._alignment((0, 1, 0), (0, 0, 1)))
        left, right = self.franka_lfinger_pos, self.franka_rfinger_pos
        around = (left[:, 2] > handle[:, 2]) & (right[:, 2] < handle[:, 2])
        grasp = torch.where(around, 0.5, 0.0)
        heights = (left[:, 2] - handle[:, 2]).abs() + (right[:, 2] - handle[:, 2]).abs()
        pinch = torch.where(around, 0.08 - heights, 0.0)
        reward = 2.0 * near + 0.5 * aligned + 0.25 * grasp + 7.5 * (opening * grasp + opening) + 5.0 * pinch
        reward = reward - 0.01 * (self.actions * self.actions).sum(dim=-1)
        reward = reward + torch.where(opening > 0.01, 0.5, 0.0) + torch.where(opening > 0.2, grasp, 0.0)
        reward = reward + torch.where(opening > OPEN, 2.0 * grasp, 0.0)
        behind = torch.minimum(left[:, 0], right[:, 0]) < handle[:, 0] - 0.04
        return torch.where(behind, -1.0, reward)

    def _alignment(self, gripper: tuple[int, int, int], drawer: tuple[int, int, int]) -> Tensor:
        """Returns sgn(c) c^2, with c the cosine between an axis of the gripper and one of the drawer."""
        first = rotations.rotate(self.franka_grasp_rot, torch.tensor(gripper, dtype=torch.float32))
        second = rotations.rotate(self.drawer_grasp_rot, torch.tensor(drawer, dtype=torch.float32))
        cosine = (first * second).sum(dim=-1)
        return torch.sign(cosine) * cosine * cosine
