"""The base of the two-hand tasks whose hands move as wholes: palm and finger points, handles, and their observations.

A force and a torque act on each forearm, and a strong drag slows the hand (see `porse.sim.drag`). A handle is a point that
moves with a body; rewards are about the distances between it and the fingertips.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from porse.sim import rotations
from porse.tasks.hands import shadow
from porse.tasks.hands.observations import free_hands, hand_observations, moving_body
from porse.tasks.hands.two_hands import DISTAL, HAND_BODIES, PALM, TwoHandTask
from porse.tasks.hands.variables import FREE_ACTIONS, SIDES, point_variables
from porse.variables import Variable

PALM_POINT = (0.0, -0.02, 0.08)
"""Palm point in the frame of the palm (m)."""

FINGER_POINT = (0.0, 0.0, 0.02)
"""Fingertip point in the frame of a last finger link (m)."""

_TIPS = tuple(f"{hand}_hand_{finger}" for hand in SIDES for finger in shadow.FINGERS)


@dataclass(frozen=True)
class Handle:
    """A point that moves with a body.

    Attributes:
        name: offered as `name`_pos and `name`_rot.
        body: the body, one of the task's `OBJECT_BODIES`.
        meaning: what is there, in words for prompts.
        offset: in the body's frame (m).
        hand: "right" or "left" where that hand reaches for it, else empty.
    """

    name: str
    body: str
    meaning: str
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    hand: str = ""


def handle_variables(handles: tuple[Handle, ...]) -> tuple[Variable, ...]:
    """Returns position and orientation of the handles as variables."""
    return tuple(v for handle in handles for v in point_variables(handle.name, handle.meaning))


class FreeHandTask(TwoHandTask):
    """Two hands that move as wholes, and objects with handles.

    Attributes:
        BODIES: pairs of a variable's first part and the body whose pose and velocities it offers.
        HANDLES: points on objects.
        START_JOINTS: angle or travel and speed at which an object's joint starts, where they are not zero.
    """

    FREE: ClassVar[bool] = True
    LINK_DAMPING: ClassVar[float] = 100.0
    NUM_ACTIONS: ClassVar[int] = FREE_ACTIONS
    OBSERVATION_HELPERS: ClassVar[tuple[Callable[..., Tensor], ...]] = (hand_observations, free_hands, moving_body)
    BODIES: ClassVar[tuple[tuple[str, str], ...]] = (("object", "object"), ("goal", "goal"))
    HANDLES: ClassVar[tuple[Handle, ...]] = ()
    START_JOINTS: ClassVar[dict[str, tuple[float, float]]] = {}

    right_hand_pos: Tensor
    right_hand_rot: Tensor
    left_hand_pos: Tensor
    left_hand_rot: Tensor

    def _place(self, ids: Tensor) -> None:
        for name, (position, speed) in self.START_JOINTS.items():
            joint = self._physics.model.joint(name)
            self._physics.qpos[ids, int(joint.qposadr[0])] = position
            self._physics.qvel[ids, int(joint.dofadr[0])] = speed

    def _prepare(self) -> None:
        super()._prepare()
        # All points that move with bodies, and in one go: palms, fingertips, handles.
        objects = [2 * HAND_BODIES + self.OBJECT_BODIES.index(handle.body) for handle in self.HANDLES]
        columns = [PALM, HAND_BODIES + PALM, *self.fingertip_handles, *self.fingertip_another_handles, *objects]
        self._point_bodies = torch.tensor(columns)
        offsets = [PALM_POINT] * 2 + [FINGER_POINT] * len(_TIPS) + [handle.offset for handle in self.HANDLES]
        self._offsets = torch.tensor(offsets)
        names = [f"{hand}_hand" for hand in SIDES] + [*_TIPS] + [handle.name for handle in self.HANDLES]
        self._point_names = [(f"{name}_pos", f"{name}_rot") for name in names]

    def _name_measurements(self) -> None:
        states = self.rigid_body_states.index_select(1, self._point_bodies)
        turns = states[..., 3:7]
        points = states[..., :3] + rotations.rotate(turns, self._offsets)
        for (pos, rot), point, turn in zip(self._point_names, points.unbind(1), turns.unbind(1), strict=True):
            setattr(self, pos, point)
            setattr(self, rot, turn)
        self._tips = points[:, 2 : 2 + len(_TIPS)].view(self.num_envs, 2, len(DISTAL), 3)
        for name, body in self.BODIES:
            self._name_body(name, body)

    def reach(self, side: str, point: Tensor) -> Tensor:
        """Returns the sum (m) of the distances from a hand's five fingertips to a point `(num_envs, 3)`."""
        tips = self._tips[:, SIDES.index(side)]
        return torch.norm(point.unsqueeze(1) - tips, dim=-1).sum(dim=-1)

    def joint_position(self, name: str) -> Tensor:
        """Returns the angle (rad) or travel (m) of an object's joint, `(num_envs,)`."""
        return self._physics.qpos[:, int(self._physics.model.joint(name).qposadr[0])].float()
