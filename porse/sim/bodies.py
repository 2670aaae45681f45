"""States of named bodies, laid out as in the original environments: position, orientation, linear, angular velocity."""

import torch
from torch import Tensor

from porse.sim import rotations
from porse.sim.physics import Physics

FIELDS = ("xpos", "xquat", "cvel", "subtree_com")
"""Derived fields that `Bodies` reads."""


class Bodies:
    """Reads the states of some bodies.

    Attributes:
        names: the bodies, in the order of the states.
    """

    def __init__(self, physics: Physics, names: tuple[str, ...]) -> None:
        """Looks the bodies up; the physics must have been made with `FIELDS`."""
        self.names = names
        ids = [physics.model.body(name).id for name in names]
        self._physics = physics
        self._ids = torch.tensor(ids, device=physics.device)
        self._roots = torch.tensor([int(physics.model.body_rootid[body]) for body in ids], device=physics.device)

    def states(self, ids: Tensor | None = None) -> Tensor:
        """Returns the states of the bodies' frames in the world frame.

        Args:
            ids: the simulations (int64) to read, or None for all.

        Returns:
            `(num_envs or len(ids), bodies, 13)`: position (m), orientation (x, y, z, w), linear velocity (m/s) of the
            frame's origin, angular velocity (rad/s).
        """
        position = self._physics.read("xpos", ids)[:, self._ids]
        orientation = self._physics.read("xquat", ids)[:, self._ids][..., rotations.XYZW_FROM_WXYZ]
        velocity = self._physics.read("cvel", ids)[:, self._ids]
        centre = self._physics.read("subtree_com", ids)[:, self._roots]
        # MuJoCo's linear part is of the point of the body that coincides with its tree's centre of mass.
        angular = velocity[..., :3]
        linear = velocity[..., 3:] + torch.cross(angular, position - centre, dim=-1)
        return torch.cat((position, orientation, linear, angular), dim=-1)
