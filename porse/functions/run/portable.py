"""Portable forms of the operators whose bits depend on the CPU or on the C library, in place of them in a list.

Measured with torch 2.13.0 on emulated CPUs (`docs/generated-code.md`): square root, pow(x, 0.5), arc cosine, arc sine,
arc tangent, tangent and the decimal logarithm go through MKL's vector maths, GELU through oneDNN, and no environment
variable makes these the same on every CPU. Others go number by number through the C library where a tensor is strided,
a column, say. They are replaced by what is the same everywhere, or given dense tensors.
"""

import dataclasses
import functools
import math
from collections import Counter
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from porse.functions.run import sleef
from porse.functions.run.operators import base_of, operator
from porse.functions.run.program import Program, Register, Step, reads, replaced
from porse.functions.verdict import words

_EXACT_POWERS = (-2, -1, -0.5, 0, 1, 2, 3)
"""Exponents for which torch multiplies, divides and takes roots."""
_KERNEL_POINTS = 25
"""Points up to which torch's cdist subtracts; it multiplies matrices where there are more."""


def with_norms(program: Program) -> Program:
    """Returns a list with the root of a sum of squares as the norm that it is, in two operators for four.

    Nothing else may read the squares, and nothing may stand between, where it could write to what is squared.
    """
    uses = Counter(index for step in program.steps for index in reads(step)) + Counter(program.results)
    steps: list[Step] = []
    moved: dict[int, int] = {}
    old = new = program.first_made
    for step in program.steps:
        squared = _squared(program, steps[-2:], moved, uses, old) if _is_root(step) else None
        if squared is not None:
            steps[-2:] = [
                Step("to.dtype", (squared, torch.float32), ()),
                Step("linalg_vector_norm.default", (Register(new - 2), 2, *steps[-1].arguments[1:]), ()),
            ]
            moved[old] = new - 1
        else:
            given = tuple(replaced(value, moved) for value in step.arguments)
            steps.append(dataclasses.replace(step, arguments=given, keywords=_moved(step.keywords, moved)))
            for index in range(step.makes):
                moved[old + index] = new + index
            new += step.makes
        old += step.makes
    return dataclasses.replace(program, steps=tuple(steps), results=tuple(moved.get(r, r) for r in program.results))


def _is_root(step: Step) -> bool:
    is_power = step.operator == "pow.Tensor_Scalar" and step.arguments[1] == 0.5
    return step.operator == "sqrt.default" or is_power


def _moved(keywords: tuple[tuple[str, Any], ...], moved: dict[int, int]) -> tuple[tuple[str, Any], ...]:
    return tuple((name, replaced(value, moved)) for name, value in keywords)


def _squared(program: Program, before: list[Step], moved: dict[int, int], uses: Counter[int], old: int) -> Any:
    """Returns what the two steps before a root at `old` square and then add along dimensions, None where they do not."""
    if len(before) < 2 or uses[old - 1] != 1 or uses[old - 2] != 1:
        return None
    square, added = before
    is_next = added.arguments[:1] == (Register(moved.get(old - 2, -1)),) and square.makes == added.makes == 1
    if added.operator != "sum.dim_IntList" or added.keywords or not is_next or added.arguments[1] is None:
        return None
    values = square.arguments
    if square.operator == "pow.Tensor_Scalar":
        return values[0] if values[1] == 2 else None
    if square.operator == "mul.Tensor":
        return values[0] if values[0] == values[1] else None
    return values[0] if square.operator == "square.default" else None


def portable(name: str, arguments: tuple[Any, ...], single: bool) -> Callable[..., Any] | None:
    """Returns what computes an operator the same way on every CPU, None where the operator itself does.

    Args:
        name: the operator, with its overload.
        arguments: what it is given.
        single: every tensor of floats in the list is float32.
    """
    base = base_of(name)
    form = _FORMS.get(base)
    if base == "pow":
        form = _power(arguments) if name in ("pow.Tensor_Scalar", "pow_.Scalar") else None
    elif base in _BY_SLEEF:
        form = _by_sleef(_BY_SLEEF[base], single) if sleef.is_needed() else None
    elif base in _DENSE_BY_SLEEF:
        form = _on_dense(name.replace("_.", ".", 1) if name.startswith(f"{base}_.") else name)
    if form is None or not name.startswith(f"{base}_."):
        return form
    return lambda x, *more, **named: x.copy_(form(x, *more, **named))


def _sqrt(x: Tensor) -> Tensor:
    """Both steps are exactly rounded on every CPU; 0 and infinity go through infinity and 0 and come back."""
    return torch.reciprocal_(torch.rsqrt(x))


def _power(arguments: tuple[Any, ...]) -> Callable[..., Any] | None:
    exponent = arguments[1]
    if exponent == 0.5:
        return lambda x, half: _sqrt(x)
    return None if exponent in _EXACT_POWERS else lambda x, number: torch.pow(x.contiguous(), number)


def _by_sleef(function: sleef.Function, single: bool) -> Callable[..., Any]:
    """Sleef writes over a copy, which is dense, and in which integers are floats as they would be."""
    calls = {
        p: getattr(torch.ops.porse, sleef.operator(function, p).partition("::")[2]).default for p in ("f32", "f64")
    }
    if single:
        return lambda x: calls["f32"](torch.mul(x, 1.0))

    def in_double(x: Tensor) -> Tensor:
        copy = torch.mul(x, 1.0)
        return calls["f64"](copy.to(torch.float64)).type_as(copy)

    return in_double


def _on_dense(name: str) -> Callable[..., Any]:
    """Returns the same operator on dense tensors, which go through Sleef."""
    call = operator(name).call
    return lambda *given, **named: call(*[v.contiguous() if isinstance(v, Tensor) else v for v in given], **named)


def _gelu(x: Tensor, *, approximate: str = "none") -> Tensor:
    if approximate == "tanh":
        cube = ((x * x) * x) * 0.044715
        return (x * 0.5) * (torch.tanh((x + cube) * math.sqrt(2.0 / math.pi)) + 1)
    half = x * 0.5
    return torch.addcmul(half, half, torch.erf(half * math.sqrt(2.0)))


def _cdist(a: Tensor, b: Tensor, p: float = 2.0, mode: int | None = None) -> Tensor:
    """As torch computes it, which takes a root behind a product of matrices where points are many."""
    if p != 2.0 or mode == 2 or (mode is None and max(a.size(-2), b.size(-2)) <= _KERNEL_POINTS):
        return torch.ops.aten.cdist.default(a, b, p, 2)
    s, t = torch.sum(a * a, -1, True), torch.sum(b * b, -1, True)
    x = torch.cat([a * -2.0, s, torch.ones_like(s)], -1)
    y = torch.cat([b, torch.ones_like(t), t], -1)
    return _sqrt(torch.clamp_min(torch.matmul(x, torch.transpose(y, -2, -1)), 0.0))


_BY_SLEEF: dict[str, sleef.Function] = {
    **{"acos": "acos", "arccos": "acos", "asin": "asin", "arcsin": "asin", "atan": "atan", "arctan": "atan"},
    **{"tan": "tan", "log10": "log10"},
}
_DENSE_BY_SLEEF = words("""
    arctan2 arctanh atan2 atanh cosh exp2 hypot logaddexp logit mish sigmoid silu sinh softplus special_exp2
    special_expit special_logit
    """)
_FORMS: dict[str, Callable[..., Any]] = {"sqrt": _sqrt, "gelu": _gelu, "cdist": functools.partial(_cdist)}
