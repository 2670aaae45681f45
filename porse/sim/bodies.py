"""States of named bodies, laid out as in the original environments: position, orientation, linear, angular velocity."""

import torch
from torch import Tensor

from porse.sim import rotations
from porse.sim.physics import Physics

FIELDS = ("xpos", "xquat", "cvel", "subtree_com")
"""Derived fields that `Bodies` reads."""

_PARTS = ((0, 1, 2), rotations.XYZW_FROM_WXYZ, (0, 1, 2), (0, 1, 2))
"""What a state takes from a position, an orientation, a linear and a six-dimensional velocity, whose first half is angular."""


class Bodies:
    """Reads the states of some bodies.

    Attributes:
        names: the bodies, in the order of the states.
    """

    def __init__(self, physics: Physics, names: tuple[str, ...]) -> None:
        """Looks the bodies up; the physics must have been made with `FIELDS`."""
        self.names = names
        model = physics.model
        self._physics = physics
        self._roots = torch.tensor(model.body_rootid.tolist(), device=physics.device)
        # Where the states' columns lie in a row of all positions, orientations, linear and six-dimensional velocities.
        starts = [0, 3 * model.nbody, 7 * model.nbody, 10 * model.nbody]
        self._columns = torch.tensor(
            [
                start + width * model.body(name).id + part
                for name in names
                for start, width, parts in zip(starts, (3, 4, 3, 6), _PARTS, strict=True)
                for part in parts
            ],
            device=physics.device,
        )

    def states(self, ids: Tensor | None = None) -> Tensor:
        """Returns the states of the bodies' frames in the world frame.

        Args:
            ids: the simulations (int64) to read, or None for all.

        Returns:
            `(num_envs or len(ids), bodies, 13)`: position (m), orientation (x, y, z, w), linear velocity (m/s) of the
            frame's origin, angular velocity (rad/s).
        """
        read = self._physics.read
        position, orientation, velocity = read("xpos", ids), read("xquat", ids), read("cvel", ids)
        centre = read("subtree_com", ids).index_select(1, self._roots)
        # MuJoCo's linear part is of the point of the body that coincides with its tree's centre of mass.
        linear = velocity[..., 3:] + torch.cross(velocity[..., :3], position - centre, dim=-1)
        # All bodies' quantities side by side, and then one selection: many small ones take several times as long.
        rows = torch.cat([part.flatten(1) for part in (position, orientation, linear, velocity)], dim=1)
        return rows.index_select(1, self._columns).view(len(rows), len(self.names), 13)
