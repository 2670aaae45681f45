"""Forces of joints' springs and dampers, without MuJoCo."""

from typing import Self

import mujoco
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_ONE_DOF = (mujoco.mjtJoint.mjJNT_SLIDE.value, mujoco.mjtJoint.mjJNT_HINGE.value)


class JointSprings:
    """Computes MuJoCo's `qfrc_passive`, with the same bits, where only springs and dampers of joints are in it.

    A force is -k (q - q0) - d v for a joint with one degree of freedom, and -d v for each of any other joint's.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        """Looks the joints up; `are_all_of` says whether the model is one that this computes."""
        stiff = np.flatnonzero(model.jnt_stiffness)
        self._dofs, self._places = model.jnt_dofadr[stiff], model.jnt_qposadr[stiff]
        self._pull, self._rest = -model.jnt_stiffness[stiff], model.qpos_spring[self._places]
        self._drag = -model.dof_damping

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Self | None:
        """Returns them, or None where other passive forces act, or springs and dampers of another kind."""
        stiff = model.jnt_stiffness != 0
        other = (
            (stiff & ~np.isin(model.jnt_type, _ONE_DOF)).any(),
            model.jnt_stiffnesspoly.any() or model.dof_dampingpoly.any() or (model.jnt_plasticadr >= 0).any(),
            model.ntendon and any(_of_tendons(model)),
            model.ngravcomp and model.opt.gravity.any(),
            model.opt.density or model.opt.viscosity,
            model.nflex or model.nplugin or model.flg_adhesion,
            model.opt.disableflags & (mujoco.mjtDisableBit.mjDSBL_SPRING | mujoco.mjtDisableBit.mjDSBL_DAMPER),
        )
        return None if any(other) else cls(model)

    def forces(self, qpos: Floats, qvel: Floats) -> Floats:
        """Returns the forces (N m or N) of states: positions `(n, nq)` and velocities `(n, nv)`, as `(n, nv)`."""
        # MuJoCo adds both parts to zeros, which makes of -0 a 0.
        forces = qvel * self._drag + 0.0
        if len(self._dofs):
            forces[:, self._dofs] += self._pull * (qpos[:, self._places] - self._rest)
        return forces


def _of_tendons(model: mujoco.MjModel) -> tuple[bool, ...]:
    parts = (model.tendon_stiffness, model.tendon_stiffnesspoly, model.tendon_damping, model.tendon_dampingpoly)
    return tuple(bool(part.any()) for part in parts)
