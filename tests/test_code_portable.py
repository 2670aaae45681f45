"""The portable forms: right values, everywhere where the plain ones are defined, and the same bits on other CPUs."""

import contextlib
import json
import os
import shutil
import subprocess
import sys

import pytest
import torch

from code_cases import VARIABLES, compile_reward, reward, traced, values
from porse.functions.run.operators import Watch
from porse.functions.run.portable import with_norms
from porse.functions.verdict import CodeError
from porse.tasks import find_task

PLAIN = {
    "torch.sqrt(y.abs())": torch.linspace(-4, 4, 999),
    "y.abs() ** 0.5": torch.linspace(-4, 4, 999),
    "torch.pow(y.abs(), 0.5)": torch.linspace(-4, 4, 999),
    "y.abs() ** scale": torch.linspace(-4, 4, 999),
    "torch.acos(y)": torch.linspace(-1, 1, 999),
    "torch.arccos(y)": torch.linspace(-1, 1, 999),
    "y.asin()": torch.linspace(-1, 1, 999),
    "torch.atan(y)": torch.linspace(-1e4, 1e4, 999),
    "torch.atan2(y, a[:, 1])": torch.linspace(-4, 4, 999),
    "torch.tan(y)": torch.linspace(-1.5, 1.5, 999),
    "torch.log10(y.abs() + 1e-6)": torch.linspace(-4, 4, 999),
    "F.gelu(y)": torch.linspace(-6, 6, 999),
    "F.gelu(y, approximate='tanh')": torch.linspace(-6, 6, 999),
}
STRIDED = dict.fromkeys(
    [
        "torch.sigmoid(y)",
        "y.logit()",
        "torch.exp2(y)",
        "torch.atanh(y)",
        "torch.arctanh(y)",
        "torch.sinh(y)",
        "torch.cosh(y)",
        "torch.hypot(y, a[:, 1])",
        "torch.logaddexp(y, a[:, 2])",
        "F.silu(y)",
        "F.softplus(y)",
        "F.mish(y)",
        "y ** 2.5",
        "torch.special.expit(y)",
        "torch.sigmoid(a.t()[1])",
        "a.unbind(1)[2].sigmoid()",
        "a[:, 0:1].sigmoid().squeeze(1)",
    ],
    torch.linspace(0.05, 0.95, 999),
)
"""Operators that torch gives to the C library for strided tensors alone."""
_NOT_PORTABLE = {"sqrt", "acos", "arccos", "asin", "atan", "tan", "log10", "gelu"}


@pytest.mark.parametrize("expression", [*PLAIN, *STRIDED])
def test_portable_forms_are_as_good_as_the_plain_ones(expression):
    """Against double precision, the portable form is at most one last digit (1.2e-7) worse than the plain one."""
    source = reward(f"y = a[:, 0]\nx = {expression}", arguments="a, scale")
    points = torch.stack([(PLAIN | STRIDED)[expression]] * 3, dim=-1)
    space = {"torch": torch, "F": torch.nn.functional, "a": points.double(), "y": points.double()[:, 0], "scale": 0.5}
    exact = eval(expression, space)
    results = [
        compile_reward(source, VARIABLES, portable)({"a": points, "scale": 0.5})[0] for portable in (False, True)
    ]
    plain, portable = (((found - exact).abs() / exact.abs().clamp(min=0.1)).max() for found in results)
    assert portable <= plain + 1.3e-7 * 4


@pytest.mark.parametrize(
    ("expression", "point", "expected"),
    [
        ("torch.sqrt(y)", 0.0, 0.0),
        ("torch.sqrt(y)", float("inf"), float("inf")),
        ("torch.acos(y)", 1.0, 0.0),
        ("torch.acos(y)", -1.0, torch.pi),
        ("torch.asin(y)", 1.0, torch.pi / 2),
        ("torch.asin(y)", -1.0, -torch.pi / 2),
        ("torch.atan(y)", float("-inf"), -torch.pi / 2),
    ],
)
def test_portable_forms_hold_at_the_ends(expression, point, expected):
    source = reward(f"y = a[:, 0]\nx = {expression}")
    total, _ = compile_reward(source, VARIABLES, True)({"a": torch.full((2, 3), point), "b": torch.zeros(2, 3)})
    assert total.tolist() == pytest.approx([expected] * 2, abs=1e-7)


@pytest.mark.parametrize("expression", [*PLAIN, *STRIDED])
def test_a_number_has_the_same_bits_in_a_row_and_in_a_column(expression):
    """Torch's own operators take strided tensors through the C library, which differs by version."""
    function = compile_reward(reward(f"y = a[:, 0]\nx = {expression}", arguments="a, scale"), VARIABLES, True)
    points = (PLAIN | STRIDED)[expression][:992]  # torch takes what is left of sixteen number by number
    columns = torch.stack([points] * 3, dim=-1)
    rows = columns.t().contiguous().t()
    layouts = {"columns": columns, "rows": rows, "backwards": columns.flip(0), "every second": columns[::2].clone()}
    found = {name: function({"a": layout, "scale": 0.5})[0].nan_to_num() for name, layout in layouts.items()}
    assert torch.equal(found["columns"], found["rows"])
    assert torch.equal(found["columns"], found["backwards"].flip(0))
    assert torch.equal(found["columns"][::2], found["every second"])


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("expression", "exact"), [("torch.acos(y)", torch.acos), ("torch.asin(y)", torch.asin)])
def test_arcs_keep_their_digits_near_one(expression, exact, sign):
    """Every float32 from 1 - 2^-10 to 1, as a row, as a column and alone: the last digit at most is off by one."""
    points = sign * (1.0 - torch.arange(2**14) * 2.0**-24)
    function = compile_reward(reward(f"y = a[:, 0]\nx = {expression}"), VARIABLES, True)
    expected = exact(points.double())
    unit = 2.0 ** (expected.abs().clamp(min=2.0**-12).log2().floor() - 23)
    row = function({"a": points[:, None], "b": torch.zeros(1)})[0]
    column = function({"a": torch.stack([points] * 3, dim=-1), "b": torch.zeros(1)})[0]
    alone = torch.cat([function({"a": p.reshape(1, 1), "b": torch.zeros(1)})[0] for p in points[::97]])
    assert torch.equal(row, column)
    assert torch.equal(alone, row[::97])
    assert ((row - expected).abs() / unit).max() <= 1


@pytest.mark.parametrize("point", [1.0000001, -1.0000001, float("inf"), float("-inf"), float("nan")])
@pytest.mark.parametrize("expression", ["torch.acos(y)", "torch.asin(y)"])
def test_arcs_are_undefined_outside_their_domain(expression, point):
    source = reward(f"y = a[:, 0]\nx = {expression}")
    total, _ = compile_reward(source, VARIABLES, True)({"a": torch.full((2, 3), point), "b": torch.zeros(2, 3)})
    assert torch.isnan(total).all()


@pytest.mark.parametrize("expression", ["torch.sqrt(y)", "torch.acos(y)"])
def test_portable_forms_are_undefined_where_the_plain_ones_are(expression):
    source = reward(f"y = a[:, 0]\nx = {expression}")
    total, _ = compile_reward(source, VARIABLES, True)({"a": torch.full((2, 3), -2.0), "b": torch.zeros(2, 3)})
    assert torch.isnan(total).all()


def test_replacements_stand_where_the_operator_stood():
    """A root that is taken after a change in place must see the change."""
    source = reward("y = a[:, 0].abs()\ny[b[:, 0] > 0] = 4.0\nx = torch.sqrt(y)\ny *= 0.0")
    states = {"a": torch.ones(2, 3), "b": torch.tensor([[1.0, 0, 0], [-1.0, 0, 0]])}
    assert compile_reward(source, VARIABLES, True)(states)[0].tolist() == [2.0, 1.0]


@pytest.mark.parametrize(
    ("lines", "is_norm"),
    [
        ("x = torch.sqrt(torch.sum((a - b) ** 2, dim=-1))", True),
        ("d = a - b\nx = (d * d).sum(-1, keepdim=True).sqrt()[:, 0]", True),
        ("s = torch.square(a - b)\nx = torch.sum(s, 1) ** 0.5", True),
        ("x = torch.sqrt(torch.sum(steps[:, None] ** 2, dim=-1))", True),
        ("x = torch.sqrt(torch.sum((a - b) ** 2, dim=-1) + 0.5)", False),
        ("x = torch.sqrt(torch.sum((a - b) ** 4, dim=-1))", False),
        ("x = torch.sqrt(torch.sum(a * a.abs(), dim=-1).abs())", False),
        ("x = torch.sqrt(torch.sum((a - b).double() ** 2, dim=-1))", False),
        ("s = (a - b) ** 2\nx = torch.sqrt(torch.sum(s, dim=-1)) + s[:, 0]", False),
        ("c = a[:, 0].abs()\ns = (b * b).sum(-1)\nx = torch.sqrt(c)\nx = x + 3.0 * s", False),
        ("d = a - b\ns = d * d\nd += 1.0\nx = torch.sqrt(torch.sum(s, dim=-1)) + d[:, 0]", False),
    ],
)
def test_the_root_of_a_sum_of_squares_becomes_a_norm_where_that_is_the_same(lines, is_norm):
    source, states = reward(lines, arguments="a, b, steps"), values(1025)
    plain, portable = (compile_reward(source, VARIABLES, form) for form in (False, True))
    torch.testing.assert_close(portable(states)[0], plain(states)[0], rtol=3e-7, atol=3e-7)
    kinds = [step.operator for step in with_norms(portable.program).steps]
    if "double" not in lines:  # then nothing is replaced, and `with_norms` is not asked
        assert ("linalg_vector_norm.default" in kinds) == is_norm
        assert ("sum.dim_IntList" in kinds) != is_norm


def test_no_operator_at_risk_is_left():
    """No step of the portable form leads to an operator whose bits differ between CPUs."""
    lines = [f"y{i} = {e.replace('y', 'a[:, 0]')}" for i, e in enumerate(PLAIN) if "F." not in e]
    total = "x = " + " + ".join(f"y{i}" for i in range(len(lines)))
    function = compile_reward(reward(*lines, total, arguments="a, scale"), VARIABLES, True)
    seen = Watch()
    with torch.inference_mode():
        function(values(16))  # the first call looks at shapes, with the operators as they are named
        with seen:
            function(values(16))
    names = {name.partition(".")[0] for name in seen.names}
    assert names
    assert not names & _NOT_PORTABLE


def test_scalars_are_left_alone():
    source = reward("x = a[:, 0] * math.sqrt(scale) * scale ** 0.5", arguments="a, scale")
    states = values(4)
    plain, portable = (compile_reward(source, VARIABLES, form)(states)[0] for form in (False, True))
    assert torch.equal(plain, portable)


_BITS = """
import hashlib, json, torch
torch.set_num_threads(1)
from code_cases import VARIABLES, reward, values
from code_cases import compile_reward
expressions = {expressions}
states = values(4099) | {{"scale": 0.5}}
found = {{}}
for portable in (False, True):
    for expression in expressions:
        source = reward("y = a[:, 0]\\nx = torch.nan_to_num(" + expression + ")", arguments="a, b, q, scale")
        total, _ = compile_reward(source, VARIABLES, portable)(states)
        found[f"{{expression}} {{portable}}"] = hashlib.sha256(total.numpy().tobytes()).hexdigest()
print(json.dumps(found))
"""


def on_three_cpus(root, program, given):
    """Returns what a Python program prints as JSON, natively and on two emulated CPUs."""
    emulator = shutil.which("qemu-x86_64")
    if emulator is None:
        pytest.skip("needs qemu-x86_64 (package qemu-user)")
    environment = os.environ | {"PYTHONPATH": f"{root}:{root / 'tests'}"}
    found = []
    for prefix in ([], [emulator, "-cpu", "EPYC"], [emulator, "-cpu", "Haswell"]):
        command = [*prefix, sys.executable, "-c", program]
        result = subprocess.run(command, env=environment, input=given, capture_output=True, check=True, text=True)
        found.append(json.loads(result.stdout))
    return found


_RECORDED = """
import hashlib, json, sys, torch
torch.set_num_threads(1)
from code_cases import values, variable
from code_cases import MappingFunction, RewardFunction
given = json.load(sys.stdin)
states = values(128, [variable(name, *shape) for name, shape in given["variables"]], seed=3)
found = []
for kind, text in given["lists"]:
    if kind == "reward":
        total, components = RewardFunction(text, True)(states)
        results = [total, *components.values()]
    else:
        results = MappingFunction(text, True)(states)[0]
    results = [result.nan_to_num(7.0).numpy().tobytes() for result in results]
    found.append(hashlib.sha256(b"".join(results)).hexdigest())
print(json.dumps(found))
"""


@pytest.mark.slow
def test_the_default_runs_functions_give_the_same_bits_on_emulated_cpus_of_other_makes(root):
    task = find_task("Quadcopter")
    tensors = [v for v in task.VARIABLES if v.kind == "tensor"]
    states, lists = values(16, task.VARIABLES), []
    for path in sorted((root / "llm_cache").glob("*/*.json")):
        text = json.loads(path.read_text())["reply"]["text"]
        for kind in ("reward", "mapping"):
            with contextlib.suppress(CodeError):
                found = traced(text if isinstance(text, str) else "\n".join(text), kind, task.VARIABLES, states)
                lists.append((kind, found.text))
    assert len(lists) >= 52
    given = json.dumps({"variables": [(v.name, v.shape) for v in tensors], "lists": lists})
    native, epyc, haswell = on_three_cpus(root, _RECORDED, given)
    assert native == epyc == haswell
    assert len(native) == len(lists)


@pytest.mark.slow
def test_bits_are_the_same_on_an_emulated_cpu_of_another_make(root):
    """About a minute. What the plain forms do is printed by a failure and kept in docs/generated-code.md."""
    more = [
        "torch.norm(a - b, dim=-1)",
        "torch.sqrt(torch.sum((a - b) ** 2, dim=-1))",
        "rot_dist(q, q.flip(0))",
        "torch.cdist(a, b[:30]).sum(-1)",
        "torch.cdist(a[:, None], torch.stack([a, b], 1)).sum((-1, -2))",
        "torch.cdist(a[:, None], torch.stack([a, b], 1), p=3).sum((-1, -2))",
        "torch.exp(y) + torch.tanh(y) * torch.sin(y)",
    ]
    program = _BITS.format(expressions=[*PLAIN, *STRIDED, *more])
    found = on_three_cpus(root, program, "")
    for name in found[0]:
        if name.endswith("True"):
            assert found[0][name] == found[1][name] == found[2][name], name
