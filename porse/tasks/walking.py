"""The base of the tasks in which a jointed figure moves freely: Anymal and Humanoid."""

from typing import ClassVar

import torch
from torch import Tensor

from porse.sim import rotations
from porse.tasks.base import Task


class WalkingTask(Task):
    """A root body that is free, the scene's first joint, and named joints below it.

    Attributes:
        JOINTS: the joints, in the order of actions and observations.
        FORCES: attributes that hold forces of a step, each with its width.
    """

    FAMILY: ClassVar[str] = "isaac"
    OBSERVATION_CLIP: ClassVar[float] = 5.0
    JOINTS: ClassVar[tuple[str, ...]]
    FORCES: ClassVar[dict[str, int]]

    root_states: Tensor
    dof_pos: Tensor
    dof_vel: Tensor

    def _prepare(self) -> None:
        joints = [self._physics.model.joint(name) for name in self.JOINTS]
        self._qpos_index = torch.tensor([int(joint.qposadr[0]) for joint in joints])
        self._qvel_index = torch.tensor([int(joint.dofadr[0]) for joint in joints])
        # A free joint has its position first, and then its orientation as MuJoCo orders it.
        self._orientation = torch.tensor([3 + part for part in rotations.XYZW_FROM_WXYZ])
        for name, width in self.FORCES.items():
            setattr(self, name, torch.zeros(self.num_envs, width))

    def _measure_started(self, ids: Tensor) -> None:
        # Forces belong to a step, and an episode that begins has had none.
        for name in self.FORCES:
            getattr(self, name)[ids] = 0.0
        self._name_measurements()

    def _remeasure(self) -> None:
        self._name_measurements()

    def _name_measurements(self) -> None:
        """Sets the variables from the joints."""
        qpos, qvel = self._physics.positions(), self._physics.velocities()
        orientation = qpos.index_select(1, self._orientation)
        # MuJoCo keeps a free joint's angular velocity in the body's own frame.
        spin = rotations.rotate(orientation, qvel[:, 3:6])
        self.root_states = torch.cat((qpos[:, 0:3], orientation, qvel[:, 0:3], spin), dim=-1)
        self.dof_pos = qpos.index_select(1, self._qpos_index)
        self.dof_vel = qvel.index_select(1, self._qvel_index)
