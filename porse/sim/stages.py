"""What brings derived fields up to date after a step: no more of the physics than the fields that are read depend on.

A step leaves derived fields as they were before its last substep. MuJoCo makes those of positions and velocities current with
a second pass, the stages of a step up to its velocities. Much of it is collisions and constraints, on which few fields
depend. Here a field's name decides how it comes out with the same bits for less, and a name that is not known asks for the
whole pass.
"""

from dataclasses import dataclass

import mujoco

from porse.sim import skeleton
from porse.sim.springs import JointSprings

LEFT = frozenset(("qfrc_actuator", "qfrc_constraint"))
"""Fields that only a step computes, and that no second pass touches."""

PASSIVE = "qfrc_passive"


@dataclass(frozen=True)
class SecondPass:
    """What follows a step.

    Attributes:
        stepped: fields to read from the simulations that are stepped.
        posed: fields to read from a skeleton in the same states.
        springs: what computes `PASSIVE`, or None where it is not read, or is among `stepped`.
        is_whole: whether the stepped simulations themselves run the stages up to their velocities.
    """

    stepped: tuple[str, ...]
    posed: tuple[str, ...] = ()
    springs: JointSprings | None = None
    is_whole: bool = False


def second_pass(model: mujoco.MjModel, fields: tuple[str, ...]) -> SecondPass:
    """Returns the least that gives the same bits as the whole pass.

    Args:
        model: the compiled model.
        fields: the derived `MjData` fields that are read.
    """
    stepped = LEFT | ({"sensordata"} if _senses_forces_only(model) else set())
    posed = skeleton.FIELDS if not (model.nflex or model.nplugin) else frozenset()
    springs = JointSprings.of(model) if PASSIVE in fields else None
    if not {*fields} <= stepped | posed | ({PASSIVE} if springs else set()):
        return SecondPass(fields, is_whole=True)
    return SecondPass(tuple(f for f in fields if f in stepped), tuple(f for f in fields if f in posed), springs)


def _senses_forces_only(model: mujoco.MjModel) -> bool:
    """Returns whether all sensors wait for accelerations: then a second pass computes none."""
    return bool((model.sensor_needstage == mujoco.mjtStage.mjSTAGE_ACC.value).all())
