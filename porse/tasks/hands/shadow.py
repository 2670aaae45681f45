"""The Shadow Hand of `gymnasium-robotics` (OpenAI's model), placed in a scene as the Bi-DexHands tasks place it.

Both hands are the same right hand. The files are located without importing their package, whose import prints. Kept
from them: bodies, joints, meshes, collision geoms, contact pairs, position actuators, and the four tendons that couple
the two last joints of a finger. Dropped: touch sensors, the antagonist tendons, the sky.
"""

import importlib.util
import math
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import mujoco

from porse.errors import TaskError

FINGERS = ("ff", "mf", "rf", "lf", "th")

ACTUATED = (
    "WRJ1", "WRJ0", "FFJ3", "FFJ2", "FFJ1", "MFJ3", "MFJ2", "MFJ1", "RFJ3", "RFJ2", "RFJ1",
    "LFJ4", "LFJ3", "LFJ2", "LFJ1", "THJ4", "THJ3", "THJ2", "THJ1", "THJ0",
)  # fmt: skip
"""Joints with a position actuator, in the order of the actions."""

JOINTS = (
    "WRJ1", "WRJ0", "FFJ3", "FFJ2", "FFJ1", "FFJ0", "MFJ3", "MFJ2", "MFJ1", "MFJ0", "RFJ3", "RFJ2", "RFJ1", "RFJ0",
    "LFJ4", "LFJ3", "LFJ2", "LFJ1", "LFJ0", "THJ4", "THJ3", "THJ2", "THJ1", "THJ0",
)  # fmt: skip
"""All joints of a hand, in the order of the observations."""

RANGES = (
    (-0.489, 0.14), (-0.698, 0.489),
    (-0.349, 0.349), (0.0, 1.571), (0.0, 1.571), (0.0, 1.571),
    (-0.349, 0.349), (0.0, 1.571), (0.0, 1.571), (0.0, 1.571),
    (-0.349, 0.349), (0.0, 1.571), (0.0, 1.571), (0.0, 1.571),
    (0.0, 0.785), (-0.349, 0.349), (0.0, 1.571), (0.0, 1.571), (0.0, 1.571),
    (-1.047, 1.047), (0.0, 1.222), (-0.209, 0.209), (-0.524, 0.524), (-1.571, 0.0),
)  # fmt: skip
"""Limits of `JOINTS` (rad), as the files have them."""

BODIES = (
    "hand mount", "forearm", "wrist", "palm",
    "ffknuckle", "ffproximal", "ffmiddle", "ffdistal", "mfknuckle", "mfproximal", "mfmiddle", "mfdistal",
    "rfknuckle", "rfproximal", "rfmiddle", "rfdistal",
    "lfmetacarpal", "lfknuckle", "lfproximal", "lfmiddle", "lfdistal",
    "thbase", "thproximal", "thhub", "thmiddle", "thdistal",
)  # fmt: skip
"""All bodies of a hand, in the order of `rigid_body_states`."""

CENTRE = (0.0016, 0.0081, 0.2917)
"""Centre of mass of a straight hand in the frame of its mount (m)."""

FIRM = (0.95, 0.99, 0.001, 0.5, 2.0)
"""Impedance of firm contacts: MuJoCo's default lets a hand press a light object centimetres into a table."""

FOREARM_MARGIN = 0.006
"""Distance (m) at which a forearm begins to be held off by the other hand.

Two hands under full force close at 0.56 m/s, which is 4.6 mm in a physics step.
"""

_FOREARM_SOLREF = (0.0167, 1.0)
"""Two physics steps and critical damping: the stiffest contact that MuJoCo allows."""

_MOUNT_QUATERNION = (0.0, 0.0, -math.sqrt(0.5), math.sqrt(0.5))
"""The model's own rotation of the mount, Rx(pi/2) Rz(pi), as w, x, y, z."""


@dataclass(frozen=True)
class BasePose:
    """Where a hand starts.

    Attributes:
        position: of the mount, world frame (m).
        euler: angles a, b, c (rad) of the actor's rotation Rz(c) Ry(b) Rx(a), which the mount's own rotation follows.
    """

    position: tuple[float, float, float]
    euler: tuple[float, float, float]


def palms_up(distance: float) -> tuple[BasePose, BasePose]:
    """Returns the poses of a right and a left hand that lie palm up, face to face, so far (m) from each other."""
    return BasePose((0.0, 0.0, 0.5), (0.0, 0.0, 0.0)), BasePose((0.0, -distance, 0.5), (0.0, 0.0, math.pi))


def quaternion_product(p: tuple[float, ...], q: tuple[float, ...]) -> tuple[float, float, float, float]:
    """Returns the product of two quaternions in MuJoCo's order (w, x, y, z)."""
    pw, px, py, pz = p
    qw, qx, qy, qz = q
    return (
        pw * qw - px * qx - py * qy - pz * qz,
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
    )


def quaternion_of(euler: tuple[float, float, float]) -> tuple[float, float, float, float]:
    """Returns Rz(c) Ry(b) Rx(a) for the angles (a, b, c) in rad, in MuJoCo's order (w, x, y, z)."""
    a, b, c = (angle / 2 for angle in euler)
    about_z = (math.cos(c), 0.0, 0.0, math.sin(c))
    about_y = (math.cos(b), 0.0, math.sin(b), 0.0)
    about_x = (math.cos(a), math.sin(a), 0.0, 0.0)
    return quaternion_product(quaternion_product(about_z, about_y), about_x)


def rotated(q: tuple[float, ...], v: tuple[float, float, float]) -> tuple[float, float, float]:
    """Returns the vector `v` turned by `q` (w, x, y, z)."""
    inverse = (q[0], -q[1], -q[2], -q[3])
    return quaternion_product(quaternion_product(q, (0.0, *v)), inverse)[1:]


def add_hand(spec: mujoco.MjSpec, side: str, pose: BasePose, free: bool) -> None:
    """Adds a hand to a scene; its names get the prefix `side` and a slash.

    A free hand moves by three slides and a ball joint at its centre of mass, "side/base_x", "_y", "_z" and
    "side/base_turn".

    Args:
        spec: the scene.
        side: "right" or "left".
        pose: where the mount is.
        free: whether the hand can move as a whole.
    """
    hand = _load()
    _drive_wholly(hand)
    _free_of_friction(hand)
    _add_sensors(hand)
    other = "left" if side == "right" else "right"
    bit = {"right": 2, "left": 4}
    for geom in hand.geoms:
        if geom.classname.name == "DC_Hand":
            # Bit 1 meets objects; a hand's own bit meets the other hand only. Pairs within a hand are listed.
            geom.contype = 1 | bit[side]
            geom.conaffinity = bit[other]
        else:
            # Two specks that only mark links would otherwise catch on their own forearm.
            geom.contype = geom.conaffinity = 0
    turn = quaternion_product(quaternion_of(pose.euler), _MOUNT_QUATERNION)
    if not free:
        frame = spec.worldbody.add_frame(pos=pose.position, quat=turn)
        spec.attach(hand, prefix=f"{side}/", frame=frame)
        return
    offset = rotated(turn, CENTRE)
    base = spec.worldbody.add_body(name=f"{side}/base", pos=[p + o for p, o in zip(pose.position, offset, strict=True)])
    for axis, direction in (("x", [1, 0, 0]), ("y", [0, 1, 0]), ("z", [0, 0, 1])):
        base.add_joint(name=f"{side}/base_{axis}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=direction)
    base.add_joint(name=f"{side}/base_turn", type=mujoco.mjtJoint.mjJNT_BALL)
    frame = base.add_frame(pos=[-o for o in offset], quat=turn)
    spec.attach(hand, prefix=f"{side}/", frame=frame)


def hold_off_forearms(spec: mujoco.MjSpec) -> None:
    """Adds contact pairs between each forearm and the other hand; both hands must be in the scene."""
    parts = {side: [g.name for g in spec.geoms if g.name.startswith(f"{side}/C_")] for side in ("right", "left")}
    for side, other in (("right", "left"), ("left", "right")):
        forearm = f"{side}/C_forearm"
        # The two forearms themselves are a pair once.
        for part in (name for name in parts[other] if side == "right" or name != f"{other}/C_forearm"):
            spec.add_pair(
                name=f"{forearm} {part}", geomname1=forearm, geomname2=part, margin=FOREARM_MARGIN,
                solref=_FOREARM_SOLREF, solimp=FIRM, friction=[1.0, 1.0, 0.005, 0.0001, 0.0001], condim=3,
            )  # fmt: skip


def _drive_wholly(hand: mujoco.MjSpec) -> None:
    """Moves the damping of driven joints into their actuators, so that the force limit holds for the whole drive."""
    for actuator in hand.actuators:
        joint = hand.joint(actuator.target)
        damping = joint.damping.copy()
        actuator.biasprm[2] = -float(damping[0])
        joint.damping = 0.0 * damping


def _free_of_friction(hand: mujoco.MjSpec) -> None:
    """Takes the dry friction out of the joints: 1e-3 N m, what their damping does at 0.01 rad/s.

    Each such joint is a row of the contact solver in every step, 48 of the 60 rows of two hands with an egg.
    """
    for joint in hand.joints:
        joint.frictionloss = 0.0 * joint.frictionloss


def _add_sensors(hand: mujoco.MjSpec) -> None:
    """Adds a force and a torque sensor at the frame of each last finger link."""
    for finger in FINGERS:
        hand.body(f"{finger}distal").add_site(name=f"{finger}distal")
        for kind, name in ((mujoco.mjtSensor.mjSENS_FORCE, "force"), (mujoco.mjtSensor.mjSENS_TORQUE, "torque")):
            hand.add_sensor(
                name=f"{finger}_{name}", type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=f"{finger}distal"
            )


def _load() -> mujoco.MjSpec:
    """Returns the hand by itself, its mount at the origin, its names without the files' own prefix."""
    assets = _assets()
    robot, asset, shared = (_parse(assets / "hand" / f"{name}.xml") for name in ("robot", "shared_asset", "shared"))
    model = ElementTree.Element("mujoco")
    ElementTree.SubElement(model, "compiler", angle="radian", meshdir=str(assets / "stls" / "hand"))
    model.append(_section(shared, "default"))
    kept = ElementTree.SubElement(model, "asset")
    kept.extend(element for element in asset if element.tag == "mesh" or element.get("name") in ("MatColl", "MatViz"))
    mount = robot[0]
    mount.set("pos", "0 0 0")
    del mount.attrib["euler"]
    ElementTree.SubElement(model, "worldbody").append(mount)
    contact = ElementTree.SubElement(model, "contact")
    pairs = {f"{pair.get('geom1')} {pair.get('geom2')}": pair for pair in _section(shared, "contact")}
    for name, pair in pairs.items():
        pair.set("name", name)
    contact.extend(pairs.values())
    tendons = ElementTree.SubElement(model, "tendon")
    tendons.extend(tendon for tendon in _section(shared, "tendon") if tendon.get("name", "").endswith("J1c"))
    model.append(_section(shared, "actuator"))
    return mujoco.MjSpec.from_string(ElementTree.tostring(model, encoding="unicode"))


def _parse(path: Path) -> ElementTree.Element:
    """Returns the file's tree with plain names and without user data, which would set sizes of the whole scene."""
    root = ElementTree.fromstring(path.read_text(encoding="utf-8").replace("robot0:", ""))
    for element in root.iter():
        element.attrib.pop("user", None)
    return root


def _section(root: ElementTree.Element, tag: str) -> ElementTree.Element:
    """Returns the one section of a file.

    Raises:
        TaskError: the file has none.
    """
    found = root.find(tag)
    if found is None:
        raise TaskError(
            f"The Shadow Hand files of gymnasium-robotics should have a section <{tag}>, and it is not there. Install "
            "the version that the project's lock names."
        )
    return found


def _assets() -> Path:
    """Returns the folder of the robot files, located without importing the package that holds them."""
    found = importlib.util.find_spec("gymnasium_robotics")
    if found is None or found.origin is None:
        raise TaskError(
            "The two-hand tasks need the Shadow Hand files of the package gymnasium-robotics, and it is not installed "
            "here. Install the project's locked requirements."
        )
    return Path(found.origin).parent / "envs" / "assets"
