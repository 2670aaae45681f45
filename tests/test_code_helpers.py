"""The helpers that functions of the original environments find in scope compute what they compute there."""

import math

import pytest
import torch

from code_cases import compile_reward, reward, values, variable
from porse.functions.contract import HELPERS
from porse.generation.conversations import contract_text
from porse.helpers import HELPERS_IN_SCOPE

HALF = math.sqrt(0.5)
NONE = (0.0, 0.0, 0.0, 1.0)
QUARTER = (0.0, 0.0, HALF, HALF)
"""A quarter turn about z."""
BACK = (0.0, 0.0, -HALF, HALF)
THREE_QUARTERS = (0.0, 0.0, math.sin(0.75 * math.pi), math.cos(0.75 * math.pi))
ROLLED = (0.5, 0.5, 0.5, 0.5)
"""A quarter turn about x, then one about z."""
DOUBLE = (0.0, 0.0, 1.0, 2.0)
"""A quaternion whose norm is not 1."""
ONE_TWO_THREE = (1.0, 2.0, 3.0)

CASES = [
    ("quat_mul", (QUARTER, QUARTER), (0.0, 0.0, 1.0, 0.0)),
    ("quat_mul", (QUARTER, (HALF, 0.0, 0.0, HALF)), ROLLED),
    ("quat_conjugate", (QUARTER,), BACK),
    ("quat_rotate", (QUARTER, ONE_TWO_THREE), (-2.0, 1.0, 3.0)),
    ("my_quat_rotate", (QUARTER, ONE_TWO_THREE), (-2.0, 1.0, 3.0)),
    ("get_basis_vector", (QUARTER, ONE_TWO_THREE), (-2.0, 1.0, 3.0)),
    # (2 w w - 1) v + 2 w (u x v) + 2 u (u . v) = 7 (1, 2, 3) + 4 (-2, 1, 0) + 2 (0, 0, 3)
    ("quat_rotate", (DOUBLE, ONE_TWO_THREE), (-1.0, 18.0, 27.0)),
    ("quat_rotate_inverse", (QUARTER, ONE_TWO_THREE), (2.0, -1.0, 3.0)),
    ("quat_rotate_inverse", (DOUBLE, ONE_TWO_THREE), (15.0, 10.0, 27.0)),
    ("quat_apply", (QUARTER, ONE_TWO_THREE), (-2.0, 1.0, 3.0)),
    # v + w t + u x t with t = 2 (u x v) = (-4, 2, 0)
    ("quat_apply", (DOUBLE, ONE_TWO_THREE), (-9.0, 2.0, 3.0)),
    ("normalize", ((3.0, 0.0, 4.0),), (0.6, 0.0, 0.8)),
    ("quat_unit", ((0.0, 0.0, 3.0, 4.0),), (0.0, 0.0, 0.6, 0.8)),
    ("quat_axis", (QUARTER,), (0.0, 1.0, 0.0)),
    ("quat_axis", (QUARTER, 1), (-1.0, 0.0, 0.0)),
    ("quat_diff_rad", (NONE, QUARTER), math.pi / 2),
    ("quat_diff_rad", (QUARTER, (0.0, 0.0, -0.5, -math.sqrt(0.75))), math.pi / 6),
    ("quat_from_angle_axis", (math.pi / 2, (0.0, 0.0, 5.0)), QUARTER),
    ("quat_to_angle_axis", (QUARTER,), (math.pi / 2, (0.0, 0.0, 1.0))),
    ("quat_to_angle_axis", (THREE_QUARTERS,), (-math.pi / 2, (0.0, 0.0, 1.0))),
    ("quat_to_angle_axis", (NONE,), (0.0, (0.0, 0.0, 1.0))),
    ("quat_from_euler_xyz", (math.pi / 2, 0.0, math.pi / 2), ROLLED),
    ("quat_from_euler_xyz", (0.0, math.pi / 2, 0.0), (0.0, HALF, 0.0, HALF)),
    ("get_euler_xyz", (ROLLED,), (math.pi / 2, 0.0, math.pi / 2)),
    ("get_euler_xyz", (BACK,), (0.0, 0.0, 1.5 * math.pi)),
    ("get_euler_xyz", ((0.0, -0.6, 0.0, 0.8),), (0.0, 2 * math.pi - math.asin(0.96), 0.0)),
    ("normalize_angle", (7.0,), 7.0 - 2 * math.pi),
    ("normalize_angle", (-4.0,), 2 * math.pi - 4.0),
    ("copysign", (1.5, (-2.0, 0.0, 3.0)), (-1.5, 0.0, 1.5)),
    ("slerp", (NONE, QUARTER, (1 / 3,)), (0.0, 0.0, math.sin(math.pi / 12), math.cos(math.pi / 12))),
    ("slerp", (NONE, (0.0, 0.0, -HALF, -HALF), (1 / 3,)), (0.0, 0.0, math.sin(math.pi / 12), math.cos(math.pi / 12))),
    ("slerp", (QUARTER, QUARTER, (0.25,)), QUARTER),
    ("tf_inverse", (QUARTER, ONE_TWO_THREE), (BACK, (-2.0, 1.0, -3.0))),
    ("tf_apply", (QUARTER, ONE_TWO_THREE, (4.0, 5.0, 6.0)), (-4.0, 6.0, 9.0)),
    ("tf_vector", (QUARTER, (4.0, 5.0, 6.0)), (-5.0, 4.0, 6.0)),
    ("tf_combine", (QUARTER, (1.0, 0.0, 0.0), QUARTER, (0.0, 2.0, 0.0)), ((0.0, 0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))),
    ("scale", (0.5, 2.0, 10.0), 8.0),
    ("unscale", (8.0, 2.0, 10.0), 0.5),
    ("scale_transform", (8.0, 2.0, 10.0), 0.5),
    ("unscale_transform", (0.5, 2.0, 10.0), 8.0),
    ("tensor_clamp", ((-5.0, 1.0, 7.0), (-1.0, 0.0, 2.0), (4.0, 3.0, 6.0)), (-1.0, 1.0, 6.0)),
    ("saturate", ((-5.0, 1.0, 7.0), (-1.0, 0.0, 2.0), (4.0, 3.0, 6.0)), (-1.0, 1.0, 6.0)),
    ("local_to_world_space", ((1.0, 0.0, 0.0), (1.0, 2.0, 3.0, *QUARTER)), (1.0, 3.0, 3.0)),
    ("normalise_quat_in_pose", ((1.0, 2.0, 3.0, 0.0, 0.0, 3.0, 4.0),), (1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8)),
    ("calc_heading", (ROLLED,), math.pi / 2),
    ("calc_heading_quat", (ROLLED,), QUARTER),
    ("calc_heading_quat_inv", (ROLLED,), BACK),
    (
        "compute_heading_and_up",
        (QUARTER, NONE, (3.0, 4.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), 2),
        (QUARTER, 1.0, 0.8, (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
    ),
    (
        "compute_rot",
        (QUARTER, ONE_TWO_THREE, (4.0, 5.0, 6.0), (2.0, 9.0, 3.0), (1.0, 0.0, 2.0)),
        ((2.0, -1.0, 3.0), (5.0, -4.0, 6.0), 0.0, 0.0, math.pi / 2, math.pi / 4 - math.pi / 2),
    ),
    ("dist", ((1.0, 2.0, 3.0), (1.0, 5.0, 7.0)), 5.0),
    ("rot_dist", (NONE, QUARTER), math.pi / 2),
]  # fmt: skip
"""Helper, arguments of one environment, result."""


def row(value):
    """Returns a number or a tuple of them as a tensor of one environment; whole numbers stay."""
    return value if isinstance(value, int) else torch.tensor([value])


@pytest.mark.parametrize(
    ("name", "given", "expected"), CASES, ids=lambda value: value if isinstance(value, str) else ""
)
def test_a_helper_computes_what_the_original_does(name, given, expected):
    arguments = [value if name == "copysign" and place == 0 else row(value) for place, value in enumerate(given)]
    found = HELPERS_IN_SCOPE[name](*arguments)
    parts = zip(found, expected, strict=True) if isinstance(found, tuple) else [(found, expected)]
    for part, value in parts:
        wanted = torch.tensor([value])
        assert part.shape == wanted.shape
        torch.testing.assert_close(part, wanted, atol=2e-6, rtol=1e-6)


def test_numbers_become_vectors_as_in_the_original():
    assert HELPERS_IN_SCOPE["get_axis_params"](0.04, 1) == [0.0, 0.04, 0.0]
    assert HELPERS_IN_SCOPE["get_axis_params"](0.01, 1, 0.3) == [0.3, 0.01, 0.0]
    made = HELPERS_IN_SCOPE["to_torch"]([1, 2], device="cpu")
    assert (made.tolist(), made.dtype) == ([1.0, 2.0], torch.float32)


def test_every_helper_has_a_case():
    assert {name for name, _, _ in CASES} | {"get_axis_params", "to_torch"} == HELPERS_IN_SCOPE.keys()


CALLS = [
    "roll, pitch, yaw = get_euler_xyz(q)\nx = roll + 2.0 * pitch + 3.0 * yaw",
    "x = quat_diff_rad(quat_unit(q), r)",
    "x = normalize_angle(3.0 * a[:, 0])",
    "x = quat_axis(q, 2)[:, 2]",
    "x = unscale(a, b - 2.0, b + 2.0).sum(dim=-1) + scale(a[:, 0], -1.0, 2.0)",
    "turn, place = tf_combine(q, a, r, b)\nback, away = tf_inverse(turn, place)\nx = tf_apply(back, away, place).sum(-1)",
    "x = tf_vector(q, to_torch(get_axis_params(1.0, 2), device=device).repeat((num_envs, 1)))[:, 0]",
    "angle, axis = quat_to_angle_axis(q)\nx = quat_diff_rad(quat_from_angle_axis(angle, axis), r)",
    "x = calc_heading(slerp(q, r, torch.full_like(a[:, 0:1], 0.25)))",
    "x = quat_rotate(q, a)[:, 0] + quat_rotate_inverse(q, a)[:, 1] + quat_apply(q, a)[:, 2]",
]  # fmt: skip


@pytest.mark.parametrize("body", CALLS)
def test_a_function_that_calls_helpers_gives_what_they_give(body):
    variables = [variable("a", 3), variable("b", 3), variable("q", 4), variable("r", 4),
                 variable("num_envs", kind="int"), variable("device", kind="device")]  # fmt: skip
    states = values(24, variables)
    source = reward(body, arguments="a, b, q, r, num_envs, device")
    found, _ = compile_reward(source, variables, portable=True)(states)
    beside = {"torch": torch, **HELPERS_IN_SCOPE, **states}
    exec(body, beside)
    torch.testing.assert_close(found, beside["x"], atol=1e-5, rtol=1e-5)


def test_prompts_name_the_two_helpers_of_the_contract_alone(root):
    text = contract_text(root / "prompts", "mapping")
    assert [name for name in HELPERS_IN_SCOPE if f"{name}(" in text] == list(HELPERS)
