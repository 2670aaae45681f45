"""Pieces of the two-hand scenes: tables, blocks, goals, and the small functions that build articulated objects.

Dimensions, joints and masses are those of the original objects' bounding boxes; the shapes are our own boxes and
cylinders. In the originals an object hangs on a massless base link; its other links have axes x = -y, y = z, z = -x of
that base. Their frames are kept, because handles are offsets in them.

Contacts: a hand meets everything; an object meets hands, tables and the floor, and other objects where it says so. An
object's friction is used as it is (`priority`), and is the mean of the original's two values, as PhysX combines them.
"""

import math

import mujoco

from porse.tasks import looks
from porse.tasks.hands import shadow

Vector = tuple[float, float, float]

LINK_EULER: Vector = (math.pi / 2, 0.0, -math.pi / 2)
"""Turn of an object's links in the frame of its base."""

SPIN_INERTIA = 2e-5
"""Inertia (kg m2) added to free objects: slim ones would otherwise spin up without bound between two fingers."""

LIFT = 10.0
"""Height (m) by which most originals lift a goal that says nothing, above its object's own place."""

HAND_BIT = 1
OBJECT_BIT = 8


def add_table(spec: mujoco.MjSpec, size: Vector, x: float = 0.0, y: float = 0.0, friction: float = 1.0) -> None:
    """Adds a fixed table: a box of the given full size (m) that stands on the floor."""
    table = spec.worldbody.add_body(name="table", pos=[x, y, size[2] / 2])
    table.add_geom(
        name="table", type=mujoco.mjtGeom.mjGEOM_BOX, size=[s / 2 for s in size], friction=[friction, 0.005, 0.0001],
        contype=0, conaffinity=HAND_BIT | OBJECT_BIT, rgba=looks.WOOD,
    )  # fmt: skip


def add_goal(
    spec: mujoco.MjSpec, position: Vector, euler: Vector = (0.0, 0.0, 0.0), name: str = "goal", lift: float = 0.0
) -> mujoco.MjsBody:
    """Adds a goal pose, `lift` (m) above a position: a body that touches nothing and that only a task moves."""
    x, y, z = position
    goal = spec.worldbody.add_body(name=name, mocap=True, pos=[x, y, z + lift], quat=shadow.quaternion_of(euler))
    goal.add_site(name=name, size=[0.015, 0.015, 0.015], rgba=[0.2, 0.8, 0.3, 0.6])
    return goal


def add_base(
    spec: mujoco.MjSpec, name: str, position: Vector, euler: Vector = (0.0, 0.0, 0.0), free: bool = True
) -> mujoco.MjsBody:
    """Adds the base of an object, free or fixed."""
    base = spec.worldbody.add_body(name=name, pos=position, quat=shadow.quaternion_of(euler))
    if free:
        base.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_FREE, armature=SPIN_INERTIA)
    return base


def add_link(base: mujoco.MjsBody, name: str) -> mujoco.MjsBody:
    """Adds a link that is fixed to a base, in the links' own orientation."""
    return base.add_body(name=name, quat=shadow.quaternion_of(LINK_EULER))


def add_box(
    body: mujoco.MjsBody,
    name: str,
    low: Vector,
    high: Vector,
    mass: float,
    friction: float = 1.0,
    meets_objects: bool = False,
) -> None:
    """Adds a box between two corners (m, the body's frame)."""
    _add(
        body, name, mujoco.mjtGeom.mjGEOM_BOX, [(b - a) / 2 for a, b in zip(low, high, strict=True)],
        [(a + b) / 2 for a, b in zip(low, high, strict=True)], mass, friction, meets_objects,
    )  # fmt: skip


def add_rod(
    body: mujoco.MjsBody,
    name: str,
    start: Vector,
    end: Vector,
    radius: float,
    mass: float,
    friction: float = 1.0,
) -> None:
    """Adds a cylinder between two points (m, the body's frame)."""
    body.add_geom(
        name=name, type=mujoco.mjtGeom.mjGEOM_CYLINDER, fromto=[*start, *end], size=[radius, 0, 0], mass=mass,
        friction=[friction, 0.005, 0.0001], priority=1, solimp=shadow.FIRM, condim=4, contype=OBJECT_BIT, conaffinity=HAND_BIT,
        rgba=looks.STEEL,
    )  # fmt: skip


def add_tub(
    body: mujoco.MjsBody, name: str, low: Vector, high: Vector, wall: float, up: int, mass: float, friction: float = 1.0
) -> None:
    """Adds an open box: a bottom and four walls on it, open toward the positive end of axis `up`; it meets other objects."""
    sides = [axis for axis in range(3) if axis != up]
    for axis in (*sides, up):
        for end in ("low", "high") if axis != up else ("low",):
            corner_a, corner_b = list(low), list(high)
            if axis != up:
                # On the bottom, not beside it: a tub that stands has one box on its table, not five.
                corner_a[up] += wall
            if end == "low":
                corner_b[axis] = low[axis] + wall
            else:
                corner_a[axis] = high[axis] - wall
            add_box(
                body, f"{name}_{'xyz'[axis]}_{end}", (corner_a[0], corner_a[1], corner_a[2]),
                (corner_b[0], corner_b[1], corner_b[2]), mass / 5, friction, meets_objects=True,
            )  # fmt: skip


def add_block(
    spec: mujoco.MjSpec, name: str, position: Vector, friction: float = 1.0, meets_objects: bool = True
) -> None:
    """Adds the free 5 cm cube of 0.0709 kg."""
    block = add_base(spec, name, position)
    half = (0.025, 0.025, 0.025)
    add_box(block, name, (-0.025, -0.025, -0.025), half, 0.0709, friction, meets_objects)
    looks.add_cube_material(spec)
    spec.geom(name).material, spec.geom(name).rgba = "cube", [1.0, 1.0, 1.0, 1.0]


def add_hinge(
    body: mujoco.MjsBody, name: str, axis: Vector, limits: tuple[float, float], damping: float, friction: float
) -> None:
    """Adds a hinge (rad, N m s/rad, N m) at the origin of a link."""
    body.add_joint(
        name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis, limited=True, range=limits, damping=damping,
        frictionloss=friction, armature=1e-3,
    )  # fmt: skip


def add_slide(
    body: mujoco.MjsBody, name: str, axis: Vector, limits: tuple[float, float], damping: float, friction: float
) -> None:
    """Adds a slide (m, N s/m, N) at the origin of a link."""
    body.add_joint(
        name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis, limited=True, range=limits, damping=damping,
        frictionloss=friction, armature=1e-2,
    )  # fmt: skip


def _add(
    body: mujoco.MjsBody,
    name: str,
    kind: mujoco.mjtGeom,
    size: list[float],
    position: list[float],
    mass: float,
    friction: float,
    meets_objects: bool,
) -> None:
    """Adds a geom that hands, tables and the floor meet."""
    body.add_geom(
        name=name, type=kind, size=size, pos=position, mass=mass, friction=[friction, 0.005, 0.0001], priority=1, solimp=shadow.FIRM,
        condim=4, contype=OBJECT_BIT, conaffinity=HAND_BIT | (OBJECT_BIT if meets_objects else 0), rgba=looks.STEEL,
    )  # fmt: skip
