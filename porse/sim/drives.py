"""Position drives whose whole force, stiffness and damping together, stays within the force limit, as in PhysX.

A MuJoCo position actuator with `kv` is such a drive: its force k (target - q) - d v is clamped as a whole. It is
evaluated before a step, though, and where it is clamped, implicit integration no longer knows its damping: a joint with
a low inertia I overshoots and comes back in every other step, by limit * dt / I. PhysX solves the drive at the end of
the step instead: the force that brings about v' is k (target - q - dt v') - d v', clamped. That is the explicit force

    f = (k (target - q) - (d + k dt) v) / (1 + x),    x = (d + k dt) dt / I,

so a drive with the gains k / (1 + x) and (d + k dt) / (1 + x) moves a free joint as far, and does not overshoot. Its
stiffness against what holds the joint is lower; the limit is reached all the same where k / (1 + x) times the highest
lead of the target exceeds it.
"""

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Drive:
    """A position drive.

    Attributes:
        stiffness: force for each unit of distance to the target (N m/rad or N/m).
        damping: force for each unit of velocity (N m s/rad or N s/m).
        limit: highest force (N m or N).
        fastest: highest speed of the joint (rad/s or m/s).
    """

    stiffness: float
    damping: float
    limit: float
    fastest: float

    def explicit(self, inertia: float, dt: float) -> "Drive":
        """Returns the drive that does in an explicit step of `dt` (s) what this one does in an implicit one.

        Args:
            inertia: the lowest of the joint, with the armature (kg m2 or kg).
            dt: physics step (s).
        """
        damping = self.damping + self.stiffness * dt
        share = 1.0 / (1.0 + damping * dt / inertia)
        return replace(self, stiffness=self.stiffness * share, damping=damping * share)

    @property
    def lead(self) -> float:
        """How far (rad or m) the target may lead the joint without driving it faster than `fastest`.

        There stiffness and damping balance: k lead = d fastest.
        """
        return self.damping * self.fastest / self.stiffness
