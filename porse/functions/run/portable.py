"""Portable forms of the operators whose bits depend on the CPU or on the C library, in place of them in a list.

Measured with torch 2.13.0 on emulated CPUs (`docs/generated-code.md`): square root, pow(x, 0.5), arc cosine, arc sine,
arc tangent, tangent and the decimal logarithm go through MKL's vector maths, GELU through oneDNN, and no environment
variable makes these the same on every CPU. Others go number by number through the C library where a tensor is strided,
a column, say. They are replaced by what is the same everywhere, or given dense tensors.
"""

import dataclasses
import math
from collections import Counter
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from porse.functions.run import sleef
from porse.functions.run.operators import Operator, operator
from porse.functions.run.program import Program, Register, Step, registers
from porse.functions.verdict import words

_SQUARE, _ROOT = ("pow.Tensor_Scalar", 2), ("pow.Tensor_Scalar", 0.5)
_EXACT_POWERS = (-2, -1, -0.5, 0, 1, 2, 3)
"""Exponents for which torch multiplies, divides and takes roots."""
_KERNEL_POINTS = 25
"""Points up to which torch's cdist subtracts; it multiplies matrices where there are more."""


def with_norms(program: Program) -> Program:
    """Returns a list with the root of a sum of squares as the norm that it is; the squares then are read by nobody.

    Nothing else may read the squares or their sum, and nothing may stand between, where it could write to what is squared.
    """
    uses = Counter([*registers([step.arguments for step in program.steps]), *program.results])
    steps = list(program.steps)
    for place, made in enumerate(program.starts[2:-1]):
        square, added, root = program.steps[place : place + 3]
        squares, total = Register(made - 2), Register(made - 1)
        is_chain = added.arguments[:1] == (squares,) and root.arguments[:1] == (total,)
        if is_chain and uses[made - 2] == uses[made - 1] == 1 and _is_norm(square, added, root):
            steps[place + 1] = Step("to.dtype", (square.arguments[0], torch.float32), ())
            steps[place + 2] = Step("linalg_vector_norm.default", (total, 2, *added.arguments[1:]), ())
    return dataclasses.replace(program, steps=tuple(steps))


def _is_norm(square: Step, added: Step, root: Step) -> bool:
    """Whether steps square, add along dimensions and take a root."""
    is_square = square.operator == "square.default" or (square.operator, *square.arguments[1:]) == _SQUARE
    is_square = is_square or (square.operator == "mul.Tensor" and square.arguments[0] == square.arguments[1])
    is_sum = added.operator == "sum.dim_IntList" and not added.keywords and added.arguments[1] is not None
    return is_square and is_sum and (root.operator == "sqrt.default" or (root.operator, *root.arguments[1:]) == _ROOT)


def portable(op: Operator, arguments: tuple[Any, ...]) -> Callable[..., Any] | None:
    """Returns what computes an operator the same way on every CPU, None where it does itself."""
    form = _FORMS.get(op.base)
    if op.base == "pow":
        form = _power(arguments[1]) if op.name in ("pow.Tensor_Scalar", "pow_.Scalar") else None
    elif op.base in _BY_SLEEF and sleef.is_needed():
        form = sleef.function(_BY_SLEEF[op.base])
    elif op.base in _DENSE_BY_SLEEF:
        form = _on_dense(op.name.replace("_.", ".", 1) if op.writes else op.name)
    return form if form is None or not op.writes else lambda x, *more, **named: x.copy_(form(x, *more, **named))


def _sqrt(x: Tensor) -> Tensor:
    """Both steps are exactly rounded on every CPU; 0 and infinity go through infinity and 0 and come back."""
    return torch.reciprocal_(torch.rsqrt(x))


def _power(exponent: Any) -> Callable[..., Any] | None:
    form = (lambda x, half: _sqrt(x)) if exponent == 0.5 else lambda x, number: torch.pow(x.contiguous(), number)
    return None if exponent in _EXACT_POWERS else form


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
    "acos": "acos", "arccos": "acos", "asin": "asin", "arcsin": "asin", "atan": "atan", "arctan": "atan",
    "tan": "tan", "log10": "log10",
}  # fmt: skip
_DENSE_BY_SLEEF = words("""
    arctan2 arctanh atan2 atanh cosh exp2 hypot logaddexp logit mish sigmoid silu sinh softplus special_exp2
    special_expit special_logit
    """)
_FORMS: dict[str, Callable[..., Any]] = {"sqrt": _sqrt, "gelu": _gelu, "cdist": _cdist}
