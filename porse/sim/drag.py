"""Drag of links as PhysX applies it, and the same motion in other words.

PhysX multiplies a damped link's velocity once in every physics step, after the forces on it and before contacts and
drives: v' = (1 - c dt) (v + F dt / m). All links of a hand have one damping c, for linear and angular velocity alike,
and the velocities of its links are linear in those of its joints; so the joints' velocities and the outer forces are
multiplied by the same share, and nothing else changes (`Physics.kept`).

MuJoCo's own damping is implicit, v' = (v + F dt / m) / (1 + c' dt). Both are one motion where
1 / (1 + c' dt) = 1 - c dt, that is c' = c / (1 - c dt): six times c for c = 100 and a step of 1/120 s.
"""

from porse.errors import TaskError


def kept_share(damping: float, dt: float) -> float:
    """Returns the share of its velocity that a link with that damping (1/s) keeps in a step of `dt` (s), 1 - c dt.

    Raises:
        TaskError: a step would stop or turn back the link.
    """
    share = 1.0 - damping * dt
    if not 0.0 < share <= 1.0:
        raise TaskError(
            f"A link with a damping of {damping:g} 1/s should keep a positive share of its velocity in a physics step, "
            f"and would keep {share:g} in one of {dt:g} s. Take a shorter step or a lower damping."
        )
    return share
