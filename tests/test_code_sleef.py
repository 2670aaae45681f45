"""Sleef's functions over tensors: their values, every length and layout, and what they do not touch."""

import subprocess
import sys
from itertools import product
from typing import get_args

import pytest
import torch

from code_cases import VARIABLES, compile_reward, reward
from porse.functions.run import sleef

pytestmark = pytest.mark.skipif(not sleef.is_needed(), reason="torch goes to Sleef by itself here")
FUNCTIONS = get_args(sleef.Function)
DTYPES = {"f32": torch.float32, "f64": torch.float64}
DOMAIN = {
    "acos": (-1.0, 1.0),
    "asin": (-1.0, 1.0),
    "atan": (-1e3, 1e3),
    "tan": (-1e3, 1e3),
    "log10": (1e-6, 1e6),
}
ALL_FLOATS = 2**32


def over(function, precision, x):
    """Returns a function of a tensor, which is left as it was."""
    found = x.clone()
    sleef.operator(function, precision)(found.data_ptr(), found.numel())
    return found


def exact(function, x):
    return getattr(torch, function)(x.double())


def units(found, expected):
    """Returns the errors of float32 numbers in units of the last place of what is right."""
    _, exponent = torch.frexp(expected.abs().clamp(min=2.0**-126))
    return (found.double() - expected).abs() / torch.ldexp(torch.ones_like(expected), exponent - 24)


@pytest.mark.parametrize("function", FUNCTIONS)
def test_values_are_within_one_unit_in_the_last_place(function):
    x = torch.linspace(*DOMAIN[function], 100_001)
    assert units(over(function, "f32", x), exact(function, x)).max() <= 1.0


@pytest.mark.parametrize("function", FUNCTIONS)
def test_double_precision_keeps_its_digits(function):
    x = torch.linspace(*DOMAIN[function], 100_001, dtype=torch.float64)
    torch.testing.assert_close(over(function, "f64", x), exact(function, x), rtol=1e-15, atol=1e-15)


@pytest.mark.parametrize(
    ("function", "x", "y"),
    [
        ("acos", 1.0, 0.0),
        ("acos", -1.0, torch.pi),
        ("acos", 0.5, torch.pi / 3),
        ("asin", -1.0, -torch.pi / 2),
        ("atan", float("inf"), torch.pi / 2),
        ("tan", torch.pi / 4, 1.0),
        ("log10", 1000.0, 3.0),
        ("log10", 0.0, float("-inf")),
    ],
)
def test_values_that_a_person_knows(function, x, y):
    for precision, dtype in DTYPES.items():
        assert over(function, precision, torch.tensor(x, dtype=dtype)).item() == pytest.approx(y, abs=2e-7)


@pytest.mark.parametrize(
    ("function", "x"), [("acos", 1.0000001), ("asin", -2.0), ("log10", -1.0), ("tan", float("nan"))]
)
def test_outside_of_the_domain_there_is_no_number(function, x):
    for precision, dtype in DTYPES.items():
        assert over(function, precision, torch.tensor([x], dtype=dtype)).isnan().all()


@pytest.mark.parametrize(("function", "precision"), list(product(FUNCTIONS, DTYPES)))
def test_a_number_is_the_same_at_every_place_and_its_neighbours_stay(function, precision):
    """Of a tensor of 20, the first n: what fills no vector goes the same way, and nothing past it is written."""
    low, high = DOMAIN[function]
    whole = torch.linspace(low, high, 20, dtype=DTYPES[precision])
    expected = over(function, precision, whole)
    for n in range(21):
        x = whole.clone()
        sleef.operator(function, precision)(x.data_ptr(), n)
        assert torch.equal(x[:n], expected[:n])
        assert torch.equal(x[n:], whole[n:])


@pytest.mark.parametrize("given", [torch.float64, torch.float32, torch.float16, torch.int64, torch.bool])
def test_the_type_of_a_result_is_what_torch_makes_of_it(given):
    x = torch.tensor([0, 1], dtype=given)
    torch.testing.assert_close(sleef.function("acos")(x), torch.acos(x))
    assert x.tolist() == [0, 1]


def test_a_tensor_on_another_device_is_refused():
    with pytest.raises(ValueError, match="expected a tensor on the CPU for Sleef's acos, found one on meta"):
        sleef.function("acos")(torch.ones(3, device="meta"))


LAYOUTS = {
    "a column": "y = a[:, 1]",
    "rows": "y = a",
    "columns": "y = a.t()",
    "every second": "y = a[::2]",
    "one number for all": "y = a[:1, :1].expand(5, 4)",
    "one number": "y = a.sum() * 0.01",
    "whole numbers": "y = steps",
    "truth values": "y = a > 0",
    "read again": "y = torch.abs(a) * 0.9\nz = y + 1.0",
}


@pytest.mark.parametrize("function", FUNCTIONS)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_and_type_gives_what_torch_gives_and_leaves_its_argument(function, layout):
    lines = LAYOUTS[layout].split("\n")
    source = reward(*lines, f"f = torch.{function}(y)", "x = f.sum() + a[:, 0] + y.sum()", arguments="a, steps")
    states = {
        "a": torch.linspace(-0.9, 0.9, 40).reshape(10, 4).abs(),
        "steps": torch.arange(10) % 2 + (function == "log10"),
    }
    before = {name: value.clone() for name, value in states.items()}
    plain, portable = (compile_reward(source, VARIABLES, form)(states)[0] for form in (False, True))
    torch.testing.assert_close(portable, plain, equal_nan=True)
    assert all(torch.equal(states[name], value) for name, value in before.items())


@pytest.mark.parametrize("dtype", ["float64", "float16"])
def test_other_floats_stay_what_they_are(dtype):
    """`where` with one of them fails if its other branch has become another type."""
    source = reward(
        f"y = a[:, 0].to(torch.{dtype}) * 1.0",
        "f = torch.acos(y)",
        "y.copy_(torch.where(y > 0.5, f, y))",
        "x = y.float() + f.float()",
    )
    states = {"a": torch.linspace(-1, 1, 30).reshape(10, 3), "b": torch.zeros(10, 3)}
    plain, portable = (compile_reward(source, VARIABLES, form)(states)[0] for form in (False, True))
    torch.testing.assert_close(portable, plain, rtol=1e-2 if dtype == "float16" else 1e-6, atol=1e-6)


def test_in_branches_and_loops_too():
    source = reward("y = a[:, 0].clamp(-1.0, 1.0)", "for i in range(3):", "    y = torch.atan(y)", "x = y if scale > 1 else y.asin()",
                    arguments="a, scale")  # fmt: skip
    for scale in (0.5, 2.0):
        states = {"a": torch.linspace(-2, 2, 30).reshape(10, 3), "scale": scale}
        plain, portable = (compile_reward(source, VARIABLES, form)(states)[0] for form in (False, True))
        torch.testing.assert_close(portable, plain)


def test_only_what_is_asked_for_is_made(root):
    """A loop costs 5 ms; a process whose functions take no arcs makes none."""
    program = (
        "import torch; from porse.functions.run import sleef; from code_cases import VARIABLES, compile_reward, reward, values\n"
        "compile_reward(reward('x = a[:, 0].sin()'), VARIABLES, True)(values()); print(sleef.operator.cache_info().currsize)\n"
        "compile_reward(reward('x = a[:, 0].acos()'), VARIABLES, True)(values()); print(sleef.operator.cache_info().currsize)\n"
        "compile_reward(reward('x = b[:, 0].acos() + torch.arccos(a[:, 0])'), VARIABLES, True)(values()); print(sleef.operator.cache_info().currsize)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=root / "tests",
        env={"PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
    )
    assert done.stdout.split() == ["0", "1", "1"], done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("function", FUNCTIONS)
def test_floats_of_every_size_are_within_one_unit_in_the_last_place(function):
    """Every 61st of all float32, from zero to infinity and NaN, of both signs: 70 million."""
    worst = 0.0
    for start in range(0, ALL_FLOATS, 61 * 2**22):
        bits = torch.arange(start, min(start + 61 * 2**22, ALL_FLOATS), 61)
        x = bits.to(torch.uint32).view(torch.float32)
        expected, found = exact(function, x), over(function, "f32", x)
        assert torch.equal(found.isnan(), expected.isnan())
        sound = expected.abs() < torch.finfo(torch.float32).max
        if bool(sound.any()):
            worst = max(worst, float(units(found[sound], expected[sound]).max()))
    print(f"{function}: {worst:.3f} units")
    assert worst <= 1.0
