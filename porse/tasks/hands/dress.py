"""What the objects of the two-hand tasks look like: each function dresses the bodies that its task has built.

The frames are those of the objects' links: y is up, except for the pen, which lies along it.
"""

import math
from collections.abc import Sequence

import mujoco

from porse.tasks import looks
from porse.tasks.looks import BLUE, DARK, GREEN, ORANGE, RED, STEEL, WHITE, Point

_KETTLE = (
    (0.0, -0.074), (0.07, -0.074), (0.084, -0.068), (0.09, -0.05), (0.092, -0.02), (0.088, 0.012), (0.076, 0.04),
    (0.058, 0.056), (0.05, 0.061), (0.0, 0.061),
)  # fmt: skip
_KETTLE_LID = (
    (0.0, 0.06), (0.05, 0.06), (0.053, 0.064), (0.045, 0.072), (0.02, 0.078), (0.008, 0.08), (0.007, 0.087),
    (0.014, 0.092), (0.014, 0.1), (0.008, 0.105), (0.0, 0.105),
)  # fmt: skip
_BUCKET = (
    (0.0, -0.053), (0.046, -0.053), (0.048, -0.05), (0.057, 0.036), (0.061, 0.038), (0.061, 0.0445), (0.055, 0.0445),
    (0.044, -0.045), (0.0, -0.045),
)  # fmt: skip
_CUP = (
    (0.0, -0.084), (0.03, -0.084), (0.034, -0.08), (0.036, -0.07), (0.043, -0.045), (0.045, 0.0), (0.045, 0.07),
    (0.0, 0.07),
)  # fmt: skip
_CUP_LID = ((0.0, 0.07), (0.047, 0.07), (0.047, 0.076), (0.03, 0.082), (0.009, 0.084), (0.009, 0.092), (0.0, 0.094))
_POT = (
    (0.0, -0.065), (0.1, -0.065), (0.114, -0.058), (0.12, -0.04), (0.12, 0.06), (0.124, 0.062), (0.124, 0.069),
    (0.0, 0.069),
)  # fmt: skip
_POT_LID = (
    (0.0, 0.07), (0.119, 0.07), (0.119, 0.075), (0.09, 0.085), (0.04, 0.092), (0.012, 0.094), (0.01, 0.104),
    (0.02, 0.11), (0.02, 0.118), (0.01, 0.123), (0.0, 0.123),
)  # fmt: skip
_BOTTLE = (
    (0.0, -0.026), (0.032, -0.026), (0.036, -0.021), (0.036, 0.085), (0.033, 0.1), (0.022, 0.116), (0.0125, 0.124),
    (0.012, 0.138), (0.0, 0.138),
)  # fmt: skip
_BOTTLE_CAP = ((0.0, 0.139), (0.0135, 0.139), (0.0135, 0.1485), (0.012, 0.15), (0.0, 0.15))
_PEN = (
    (0.0, -0.159), (0.0095, -0.15), (0.0105, -0.14), (0.0105, 0.135), (0.0085, 0.15), (0.003, 0.19), (0.001, 0.2),
    (0.0, 0.2),
)  # fmt: skip
_PEN_CAP = ((0.0, -0.172), (0.009, -0.172), (0.0115, -0.166), (0.013, -0.041), (0.0, -0.041))


def dress_kettle(spec: mujoco.MjSpec) -> None:
    """Dresses "link_1" as a round kettle with spout and handle, "link_0" as its lid."""
    body = spec.body("link_1")
    looks.hide(spec, "kettle", "spout", "handle", "lid")
    looks.add_lathe(spec, "kettle_look", _KETTLE)
    looks.look(body, "kettle_look", "kettle_look", RED)
    spout: list[Point] = [
        (0.0, -0.03, 0.07),
        (0.0, -0.02, 0.1),
        (0.0, 0.02, 0.135),
        (0.0, 0.052, 0.175),
        (0.0, 0.07, 0.2),
    ]
    looks.add_tube(spec, "spout_look", spout, (0.027, 0.024, 0.018, 0.014, 0.013))
    looks.look(body, "spout_look", "spout_look", RED)
    grip: list[Point] = [
        (0.0, 0.03, -0.075), (0.0, 0.053, -0.11), (0.0, 0.045, -0.145), (0.0, 0.0, -0.155), (0.0, -0.045, -0.145),
        (0.0, -0.055, -0.11), (0.0, -0.04, -0.08),
    ]  # fmt: skip
    looks.add_tube(spec, "handle_look", grip, (0.009, 0.01, 0.012, 0.012, 0.012, 0.01, 0.009))
    looks.look(body, "handle_look", "handle_look", DARK)
    looks.add_lathe(spec, "lid_look", _KETTLE_LID)
    looks.look(spec.body("link_0"), "lid_look", "lid_look", DARK)


def dress_bucket(spec: mujoco.MjSpec, body: str) -> None:
    """Dresses a body as a bucket."""
    looks.hide(spec, "bucket_")
    looks.add_lathe(spec, "bucket_look", _BUCKET)
    looks.look(spec.body(body), "bucket_look", "bucket_look", BLUE)


def dress_cup(spec: mujoco.MjSpec) -> None:
    """Dresses the cup: "link_1" with the left handle, "link_2" with the right one, "link_0" as its lid."""
    looks.hide(spec, "cup", "lid", "left_handle", "right_handle")
    looks.add_lathe(spec, "cup_look", _CUP)
    looks.look(spec.body("link_1"), "cup_look", "cup_look", WHITE)
    looks.add_lathe(spec, "lid_look", _CUP_LID)
    looks.look(spec.body("link_0"), "lid_look", "lid_look", BLUE)
    for name, body, side in (("left", "link_1", 1), ("right", "link_2", -1)):
        ear: list[Point] = [
            (0.0, 0.045, 0.04 * side), (0.0, 0.05, 0.062 * side), (0.0, 0.025, 0.076 * side),
            (0.0, -0.02, 0.072 * side), (0.0, -0.05, 0.052 * side), (0.0, -0.055, 0.038 * side),
        ]  # fmt: skip
        looks.add_tube(spec, f"{name}_handle_look", ear, (0.0095,))
        looks.look(spec.body(body), f"{name}_handle_look", f"{name}_handle_look", ORANGE if side > 0 else BLUE)


def dress_pot(spec: mujoco.MjSpec) -> None:
    """Dresses "link_1" as a pot with two handles, "link_0" as its lid."""
    looks.hide(spec, "pot", "lid", "left_handle", "right_handle")
    looks.add_lathe(spec, "pot_look", _POT)
    looks.look(spec.body("link_1"), "pot_look", "pot_look", STEEL)
    looks.add_lathe(spec, "lid_look", _POT_LID)
    looks.look(spec.body("link_0"), "lid_look", "lid_look", (0.5, 0.53, 0.57, 1.0))
    for name, side in (("left", 1), ("right", -1)):
        grip: list[Point] = [
            (0.112 * side, 0.055, -0.04), (0.15 * side, 0.055, -0.041), (0.174 * side, 0.055, -0.025),
            (0.174 * side, 0.055, 0.025), (0.15 * side, 0.055, 0.041), (0.112 * side, 0.055, 0.04),
        ]  # fmt: skip
        looks.add_tube(spec, f"{name}_handle_look", grip, (0.009,))
        looks.look(spec.body("link_1"), f"{name}_handle_look", f"{name}_handle_look", DARK)


def dress_bottle(spec: mujoco.MjSpec) -> None:
    """Dresses "link_1" as a bottle, "link_0" as its cap."""
    looks.hide(spec, "foot", "bottle", "neck", "cap")
    looks.add_lathe(spec, "bottle_look", _BOTTLE)
    looks.look(spec.body("link_1"), "bottle_look", "bottle_look", GREEN)
    looks.add_lathe(spec, "cap_look", _BOTTLE_CAP)
    looks.look(spec.body("link_0"), "cap_look", "cap_look", RED, (-0.007, 0.0, -0.0075))


def dress_pen(spec: mujoco.MjSpec) -> None:
    """Dresses "link_1" as the barrel of a pen, "link_0" as its cap with a clip."""
    looks.hide(spec, "barrel", "cap")
    looks.add_lathe(spec, "barrel_look", _PEN)
    looks.look(spec.body("link_1"), "barrel_look", "barrel_look", WHITE)
    cap = spec.body("link_0")
    looks.add_lathe(spec, "cap_look", _PEN_CAP)
    looks.look(cap, "cap_look", "cap_look", BLUE)
    clip: list[Point] = [(0.0, -0.168, 0.008), (0.0, -0.162, 0.0155), (0.0, -0.12, 0.0165), (0.0, -0.075, 0.015)]
    looks.add_tube(spec, "clip_look", clip, (0.002,))
    looks.look(cap, "clip_look", "clip_look", STEEL)


def dress_scissors(spec: mujoco.MjSpec) -> None:
    """Dresses "link_1" and "link_0" as the halves of a pair of scissors: a blade, and a ring to hold it by."""
    looks.hide(spec, "link_")
    for body, side in (("link_1", 1), ("link_0", -1)):
        blade: list[Point] = [
            (0.03, 0.0, 0.006 * side),
            (-0.03, 0.0, 0.002 * side),
            (-0.12, 0.0, -0.002 * side),
            (-0.2, 0.0, 0.0),
        ]
        looks.add_tube(spec, f"{body}_blade_look", blade, (0.012, 0.012, 0.008, 0.001))
        looks.look(spec.body(body), f"{body}_blade_look", f"{body}_blade_look", STEEL)
        arm: list[Point] = [
            (0.02, 0.0, 0.004 * side),
            (0.06, 0.0, 0.022 * side),
            (0.1, 0.0, 0.05 * side),
            (0.13, 0.0, 0.07 * side),
        ]
        looks.add_tube(spec, f"{body}_arm_look", arm, (0.011, 0.009, 0.009, 0.009))
        looks.look(spec.body(body), f"{body}_arm_look", f"{body}_arm_look", RED)
        ring = _oval((0.18, 0.09 * side), 0.056, 0.026)
        looks.add_tube(spec, f"{body}_ring_look", ring, (0.008,), closed=True)
        looks.look(spec.body(body), f"{body}_ring_look", f"{body}_ring_look", RED)
    looks.look_sphere(spec.body("link_1"), "screw_look", (-0.0698, 0.008, 0.0034), 0.009, DARK)


def _oval(centre: tuple[float, float], length: float, width: float) -> list[Point]:
    """Returns twelve points of an oval in the x-z plane."""
    turns: Sequence[float] = [2.0 * math.pi * i / 12 for i in range(12)]
    return [(centre[0] + length * math.cos(t), 0.0, centre[1] + width * math.sin(t)) for t in turns]
