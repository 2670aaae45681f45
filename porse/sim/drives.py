"""Position drives whose whole force, stiffness and damping together, stays within the force limit, as in PhysX.

A MuJoCo position actuator with `kv` is such a drive: its force k (target - q) - d v is clamped as a whole. It is
evaluated before a step, though, and where d dt exceeds the joint's inertia a clamped drive overshoots and comes back
in every other step. PhysX solves the drive at the end of the step instead: the force that brings about v' is
k (target - q - dt v') - d v', clamped. For one joint of inertia I that is the explicit force

    f = (k (target - q) - (d + k dt) v) / (1 + x),    x = (d + k dt) dt / I,

so a drive with the gains k / (1 + x) and (d + k dt) / (1 + x) does the same in an explicit step, at any stiffness.
"""

from dataclasses import dataclass


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
    fastest: float = float("inf")

    def explicit(self, inertia: float, dt: float) -> tuple[float, float]:
        """Returns stiffness and damping that do in an explicit step of `dt` (s) what this drive does in an implicit one.

        Args:
            inertia: of the joint, with the armature (kg m2 or kg).
            dt: physics step (s).
        """
        damping = self.damping + self.stiffness * dt
        share = 1.0 / (1.0 + damping * dt / inertia)
        return self.stiffness * share, damping * share

    def lead(self, dt: float) -> float:
        """Returns how far (rad or m) the target may lead the joint without driving it faster than `fastest`.

        Where damping and stiffness balance, k (lead - dt v) = d v.
        """
        return (self.damping / self.stiffness + dt) * self.fastest
