"""What brings derived fields up to date after a step: as little of the physics as the fields that are read depend on.

A step leaves derived fields as they were before its last substep. MuJoCo makes those of positions and velocities current with
a second pass, the stages of a step up to its velocities. Half of such a pass or more is collisions and constraints, on which
few fields depend. Here the pass goes without them where every field that is read comes out with the same bits: a field's
name decides. A field that is not named here gets the whole pass.
"""

import copy
from dataclasses import dataclass

import mujoco

LEFT = frozenset(("qfrc_actuator", "qfrc_constraint"))
"""Fields that only a step computes, and that no second pass touches."""

PASSIVE = frozenset(("qfrc_passive",))
"""Fields that depend on positions, velocities, springs, dampers and gravity."""

KINEMATIC = frozenset((
    "xpos", "xquat", "xmat", "xipos", "ximat", "xanchor", "xaxis", "geom_xpos", "geom_xmat", "site_xpos", "site_xmat",
    "subtree_com", "cinert", "cdof", "cvel", "cdof_dot",
))  # fmt: skip
"""Fields that depend on positions and velocities only."""

_UNMET = (
    mujoco.mjtDisableBit.mjDSBL_CONTACT, mujoco.mjtDisableBit.mjDSBL_CONSTRAINT, mujoco.mjtDisableBit.mjDSBL_SENSOR,
)  # fmt: skip
_LIMP = (
    mujoco.mjtDisableBit.mjDSBL_SPRING, mujoco.mjtDisableBit.mjDSBL_DAMPER, mujoco.mjtDisableBit.mjDSBL_GRAVITY,
)  # fmt: skip


@dataclass(frozen=True)
class SecondPass:
    """What runs after a step.

    Attributes:
        stepped: fields to read from the simulations that are stepped.
        derived: fields to read from other simulations, of `model`, which are put into the same states.
        model: what computes these, or None where there are none.
        is_whole: whether the stepped simulations themselves have to run the stages up to their velocities.
    """

    stepped: tuple[str, ...]
    derived: tuple[str, ...]
    model: mujoco.MjModel | None
    is_whole: bool


def second_pass(model: mujoco.MjModel, fields: tuple[str, ...]) -> SecondPass:
    """Returns the cheapest pass that gives the same bits as the whole one.

    Args:
        model: the compiled model.
        fields: the derived `MjData` fields that are read.
    """
    left = LEFT | ({"sensordata"} if _senses_forces_only(model) else set())
    stepped = tuple(name for name in fields if name in left)
    derived = tuple(name for name in fields if name not in left)
    if not derived:
        return SecondPass(stepped, (), None, is_whole=False)
    if not _is_plain(model) or not KINEMATIC | PASSIVE >= {*derived}:
        return SecondPass(fields, (), None, is_whole=True)
    lean = copy.copy(model)
    for flag in _UNMET if PASSIVE & {*derived} else _UNMET + _LIMP:
        lean.opt.disableflags |= flag
    return SecondPass(stepped, derived, lean, is_whole=False)


def _senses_forces_only(model: mujoco.MjModel) -> bool:
    """Returns whether all sensors wait for accelerations: then a second pass computes none."""
    return bool((model.sensor_needstage == mujoco.mjtStage.mjSTAGE_ACC.value).all())


def _is_plain(model: mujoco.MjModel) -> bool:
    """Returns whether nothing in the model makes forces of what touches: no adhesion, no soft body, no plugin."""
    adheres = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_BODY.value).any()
    return not (adheres or model.flg_adhesion or model.nflex or model.nplugin)
