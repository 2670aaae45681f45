"""The skeleton of a model: its bodies and joints, and nothing that meets, pulls, senses or is seen.

Where bodies are and how they move follows from positions and velocities alone. A skeleton computes it with the same bits as
the whole model, in less than half of the time: without collisions, constraints, geoms, actuators and tendons.
"""

import mujoco

FIELDS = frozenset((
    "xpos", "xquat", "xmat", "xipos", "ximat", "xanchor", "xaxis", "subtree_com", "cinert", "cdof", "cvel", "cdof_dot",
))  # fmt: skip
"""Derived `MjData` fields that a skeleton has in common with its model."""

STATE = ("qpos", "qvel", "mocap_pos", "mocap_quat")
"""The part of a state on which they depend."""

_SHARED = (
    "body_pos", "body_quat", "body_ipos", "body_iquat", "body_sameframe", "body_mass", "body_subtreemass", "body_inertia",
    "jnt_pos", "jnt_axis", "qpos0",
)  # fmt: skip

_IDLE = (
    mujoco.mjtDisableBit.mjDSBL_CONSTRAINT, mujoco.mjtDisableBit.mjDSBL_SPRING, mujoco.mjtDisableBit.mjDSBL_DAMPER,
    mujoco.mjtDisableBit.mjDSBL_GRAVITY,
)  # fmt: skip


def skeleton_of(model: mujoco.MjModel) -> mujoco.MjModel:
    """Returns the skeleton of a model without soft bodies and plugins."""
    spec = mujoco.MjSpec()
    made = [spec.worldbody]
    for body in range(1, model.nbody):
        bone = made[int(model.body_parentid[body])].add_body(
            mass=1.0, inertia=[1.0, 1.0, 1.0], explicitinertial=True, mocap=bool(model.body_mocapid[body] >= 0)
        )
        first = int(model.body_jntadr[body])
        for joint in range(first, first + int(model.body_jntnum[body])):
            # The armature keeps the matrix of inertias, which nobody reads, from being singular.
            bone.add_joint(type=mujoco.mjtJoint(int(model.jnt_type[joint])), armature=1.0)
        made.append(bone)
    bones = spec.compile()
    # Compiling rounds frames and masses anew, so the compiled ones are taken.
    for name in _SHARED:
        getattr(bones, name)[:] = getattr(model, name)
    for flag in _IDLE:
        bones.opt.disableflags |= flag
    return bones
