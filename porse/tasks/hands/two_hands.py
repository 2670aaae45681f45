"""The base of the two-hand tasks: scene, actions, measurements, observations, resets and the success statistic.

After Bi-DexHands: 60 Hz, two physics steps a control step, absolute joint targets, and for free hands a force and a
torque on each forearm. A task adds its objects to the scene, places them at a reset, and says what success, failure
and the human reward are.
"""

from abc import abstractmethod
from typing import ClassVar

import mujoco
import torch
from torch import Tensor

from porse.sim import bodies, rotations
from porse.sim.bodies import Bodies
from porse.sim.drag import kept_share
from porse.tasks import looks
from porse.tasks.hands import shadow
from porse.tasks.hands.observations import JOINT_RANGES
from porse.tasks.success import SuccessTask

HAND_BODIES = len(shadow.BODIES)
HAND_JOINTS = len(shadow.JOINTS)
PALM = shadow.BODIES.index("palm")
DISTAL = [shadow.BODIES.index(f"{finger}distal") for finger in shadow.FINGERS]

_GRAVITY = 9.81
"""Acceleration (m/s2) of free fall."""

_LINEAR_GAIN = 1e5
_ANGULAR_GAIN = 1e3


class TwoHandTask(SuccessTask):
    """Two Shadow Hands and some objects.

    Attributes:
        RIGHT: start pose of the right hand.
        LEFT: start pose of the left hand.
        FREE: whether the hands move as wholes; then an action begins with a force and a torque for each.
        LINK_DAMPING: damping of every link of the hands (1/s), linear and angular.
        FORCE_SCALE: the original's transition_scale.
        TORQUE_SCALE: the original's orientation_scale.
        JOINT_NOISE: width of the start noise of the joints, as a share of their ranges.
        OBJECT_BODIES: bodies that follow the hands' in `rigid_body_states`, in order.
        ACTORS: the bodies that are roots of actors after the two hands, in order.
    """

    FAMILY: ClassVar[str] = "bidex"
    CONTROL_DT: ClassVar[float] = 0.01667
    SUBSTEPS: ClassVar[int] = 2
    OBSERVATION_CLIP: ClassVar[float] = float("inf")
    FIELDS: ClassVar[tuple[str, ...]] = (
        *bodies.FIELDS, "qfrc_actuator", "qfrc_passive", "qfrc_constraint", "sensordata",
    )  # fmt: skip
    MEASURED: ClassVar[tuple[str, ...]] = (
        "rigid_body_states", "dof_force_tensor", "vec_sensor_tensor", "successes", "outcomes",
    )  # fmt: skip

    RIGHT: ClassVar[shadow.BasePose]
    LEFT: ClassVar[shadow.BasePose]
    FREE: ClassVar[bool]
    LINK_DAMPING: ClassVar[float] = 0.01
    FORCE_SCALE: ClassVar[float] = 0.0
    TORQUE_SCALE: ClassVar[float] = 0.0
    JOINT_NOISE: ClassVar[float] = 0.0
    OBJECT_BODIES: ClassVar[tuple[str, ...]]
    ACTORS: ClassVar[tuple[str, ...]]

    fingertip_handles: ClassVar[tuple[int, ...]] = tuple(DISTAL)
    fingertip_another_handles: ClassVar[tuple[int, ...]] = tuple(HAND_BODIES + body for body in DISTAL)

    rigid_body_states: Tensor
    root_state_tensor: Tensor
    dof_force_tensor: Tensor
    vec_sensor_tensor: Tensor
    shadow_hand_dof_pos: Tensor
    shadow_hand_dof_vel: Tensor
    shadow_hand_another_dof_pos: Tensor
    shadow_hand_another_dof_vel: Tensor
    fingertip_state: Tensor
    fingertip_pos: Tensor
    fingertip_another_state: Tensor
    fingertip_another_pos: Tensor
    object_pose: Tensor
    object_pos: Tensor
    object_rot: Tensor
    object_linvel: Tensor
    object_angvel: Tensor
    goal_states: Tensor
    goal_pose: Tensor
    goal_pos: Tensor
    goal_rot: Tensor

    @classmethod
    def scene(cls) -> mujoco.MjSpec:
        """Returns the hands above a floor, with the task's objects."""
        spec = mujoco.MjSpec()
        spec.modelname = cls.NAME
        spec.compiler.degree = False
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        # Hands are weightless, and what is not gets its weight as an outer force (`_start`): gravity that a body is spared
        # costs a Jacobian in every step, and would be in the forces that are measured.
        spec.option.gravity = [0.0, 0.0, 0.0]
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        # Newton is there after two to five iterations, and its dense matrices are small, one for each hand and what it
        # touches. With sparse ones, MuJoCo's own choice from 60 degrees of freedom on, it now and then does not converge at
        # all, and a finger between two bodies shoots away at hundreds of rad/s.
        spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
        spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        spec.worldbody.add_light(name="light", pos=[1, 0, 3], dir=[-0.3, 0, -1])
        spec.worldbody.add_geom(
            name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[3, 3, 0.1], rgba=[0.7, 0.7, 0.7, 1]
        )
        shadow.add_hand(spec, "right", cls.RIGHT, cls.FREE)
        shadow.add_hand(spec, "left", cls.LEFT, cls.FREE)
        shadow.hold_off_forearms(spec)
        cls.add_objects(spec)
        looks.surround(spec)
        return spec

    @classmethod
    @abstractmethod
    def add_objects(cls, spec: mujoco.MjSpec) -> None:
        """Adds the task's objects and goals to the scene."""

    @abstractmethod
    def _place(self, ids: Tensor) -> None:
        """Writes start states of the objects and goals into the restarted simulations `ids`."""

    @abstractmethod
    def _name_measurements(self) -> None:
        """Sets the task's own variables from `rigid_body_states` and the joints."""

    def _prepare(self) -> None:
        super()._prepare()
        model = self._physics.model
        sides = ("right", "left")
        names = [f"{side}/{body}" for side in sides for body in shadow.BODIES] + list(self.OBJECT_BODIES)
        self._bodies = Bodies(self._physics, tuple(names))
        actors = ["right/hand mount", "left/hand mount", *self.ACTORS]
        self._actors = torch.tensor([names.index(name) for name in actors])
        self._tip_bodies = torch.tensor([*self.fingertip_handles, *self.fingertip_another_handles])
        for name in self.ACTORS:
            setattr(self, f"{name}_indices", actors.index(name))
        joints = [model.joint(f"{side}/{joint}") for side in sides for joint in shadow.JOINTS]
        self._qpos_index = torch.tensor([int(joint.qposadr[0]) for joint in joints])
        self._qvel_index = torch.tensor([int(joint.dofadr[0]) for joint in joints])
        self._lower, self._upper = JOINT_RANGES[:, 0], JOINT_RANGES[:, 1]
        self._driven = torch.tensor([shadow.JOINTS.index(joint) for joint in shadow.ACTUATED])
        self._lowest = self._lower[self._driven]
        self._span = self._upper[self._driven] - self._lowest
        self._control_index = torch.tensor(
            [model.actuator(f"{side}/A_{joint}").id for side in sides for joint in shadow.ACTUATED]
        )
        self._kept_share = kept_share(self.LINK_DAMPING, self.CONTROL_DT / self.SUBSTEPS)
        self._physics.kept = torch.tensor(
            [self._kept_share if _is_of_a_hand(model, dof) else 1.0 for dof in range(model.nv)],
            dtype=self._physics.real,
        )
        heavy = [body for body in range(1, model.nbody) if _has_weight(model, body)]
        self._heavy = torch.tensor(heavy, dtype=torch.int64)
        self._weights = torch.tensor(
            [float(model.body_mass[body]) * _GRAVITY for body in heavy], dtype=self._physics.real
        )
        self._forearms = [model.body(f"{side}/forearm").id for side in sides]
        gains = [self.FORCE_SCALE * _LINEAR_GAIN] * 3 + [self.TORQUE_SCALE * _ANGULAR_GAIN] * 3
        self._push_scale = torch.tensor(gains, dtype=self._physics.real)
        sensors = [f"{side}/{f}_{kind}" for side in sides for f in shadow.FINGERS for kind in ("force", "torque")]
        starts = [int(model.sensor(name).adr[0]) for name in sensors]
        self._sensor_index = torch.tensor([start + axis for start in starts for axis in range(3)])
        self.rigid_body_states = torch.zeros(self.num_envs, len(names), 13)
        self.dof_force_tensor = torch.zeros(self.num_envs, 2 * HAND_JOINTS)
        self.vec_sensor_tensor = torch.zeros(self.num_envs, 60)

    def _start(self, ids: Tensor) -> None:
        super()._start(ids)
        n = len(ids)
        u = self._uniform(-1.0, 1.0, n, HAND_JOINTS)
        noise = self.JOINT_NOISE * (self._lower + (self._upper - self._lower) * u)
        # The original's noise leaves the joint ranges, and its contact solver pushes the joints back at once.
        angles = (self._default_joints() + noise).clamp(self._lower, self._upper).to(self._physics.real)
        physics = self._physics
        physics.force[ids.unsqueeze(-1), self._heavy, 2] = -self._weights
        physics.qpos[ids.unsqueeze(-1), self._qpos_index] = angles.repeat(1, 2)
        physics.ctrl[ids.unsqueeze(-1), self._control_index] = angles[:, self._driven].repeat(1, 2)
        self._place(ids)

    def _default_joints(self) -> Tensor:
        """Returns the joint angles (rad) of a hand at a start without noise, `(24,)`."""
        return torch.zeros(HAND_JOINTS)

    def _act(self) -> None:
        actions = self.actions
        if self.FREE:
            push = actions.view(self.num_envs, 2, 26)[:, :, :6].to(self._physics.real) * self.CONTROL_DT
            wrenches = push.mul_(self._push_scale).mul_(self._kept_share)
            for side, forearm in enumerate(self._forearms):
                self._physics.force[:, forearm] = wrenches[:, side]
        share = (actions.view(self.num_envs, 2, -1)[:, :, -20:] + 1.0).mul_(0.5)
        targets = share.mul_(self._span).add_(self._lowest).flatten(1)
        self._physics.ctrl.index_copy_(1, self._control_index, targets.to(self._physics.real))

    def _measure(self) -> None:
        read = self._physics.read
        self.rigid_body_states = self._bodies.states()
        forces = read("qfrc_actuator").add_(read("qfrc_passive")).add_(read("qfrc_constraint"))
        self.dof_force_tensor = forces.index_select(1, self._qvel_index)
        self.vec_sensor_tensor = read("sensordata").index_select(1, self._sensor_index)
        self._name_all()

    def _measure_started(self, ids: Tensor) -> None:
        self.rigid_body_states[ids] = self._bodies.states(ids)
        # Forces belong to a step, and an episode that begins has had none.
        self.dof_force_tensor[ids] = 0.0
        self.vec_sensor_tensor[ids] = 0.0
        self._name_all()

    def _remeasure(self) -> None:
        self._name_all()

    def _name_all(self) -> None:
        """Sets the attributes named in `VARIABLES` from the buffers."""
        joints = self._physics.positions().index_select(1, self._qpos_index)
        speeds = self._physics.velocities().index_select(1, self._qvel_index)
        self.shadow_hand_dof_pos, self.shadow_hand_another_dof_pos = joints.split(HAND_JOINTS, dim=-1)
        self.shadow_hand_dof_vel, self.shadow_hand_another_dof_vel = speeds.split(HAND_JOINTS, dim=-1)
        states = self.rigid_body_states
        self.root_state_tensor = states.index_select(1, self._actors)
        tips = states.index_select(1, self._tip_bodies)
        self.fingertip_state, self.fingertip_another_state = tips.split(len(DISTAL), dim=1)
        self.fingertip_pos = self.fingertip_state[..., :3]
        self.fingertip_another_pos = self.fingertip_another_state[..., :3]
        self._name_measurements()

    def _name_body(self, name: str, body: str) -> None:
        """Sets `name`_states, _pose, _pos, _rot, _linvel and _angvel from an object body."""
        state = self.rigid_body_states[:, 2 * HAND_BODIES + self.OBJECT_BODIES.index(body)]
        setattr(self, f"{name}_states", state)
        setattr(self, f"{name}_pose", state[:, 0:7])
        setattr(self, f"{name}_pos", state[:, 0:3])
        setattr(self, f"{name}_rot", state[:, 3:7])
        setattr(self, f"{name}_linvel", state[:, 7:10])
        setattr(self, f"{name}_angvel", state[:, 10:13])

    def random_rotations(self, n: int) -> Tensor:
        """Returns start orientations Rx(pi u0) Ry(pi u1), u ~ U[-1, 1], `(n, 4)`."""
        angle = self._uniform(-torch.pi, torch.pi, n, 2)
        return rotations.multiply(rotations.about_axis(0, angle[:, 0]), rotations.about_axis(1, angle[:, 1]))


def _is_of_a_hand(model: mujoco.MjModel, dof: int) -> bool:
    """Returns whether a degree of freedom is one of the hands' own."""
    return model.joint(int(model.dof_jntid[dof])).name.split("/")[0] in ("right", "left")


def _has_weight(model: mujoco.MjModel, body: int) -> bool:
    """Returns whether gravity acts on a body: on every one that moves, is not part of a hand and is not spared it."""
    part_of_a_hand = model.body(body).name.split("/")[0] in ("right", "left")
    moves, spared = model.body_weldid[body] != 0, model.body_gravcomp[body] == 1.0
    return bool(moves and not part_of_a_hand and not spared)
