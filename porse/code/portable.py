"""Portable forms of the operators whose bits depend on the CPU or on the C library, put into a compiled graph.

Measured with torch 2.13.0 on emulated CPUs (`docs/generated-code.md`): square root, pow(x, 0.5), arc cosine, arc sine,
arc tangent, tangent and the decimal logarithm go through MKL's vector maths, GELU through oneDNN, and no environment
variable makes these the same on every CPU. Others go number by number through the C library where a tensor is strided,
a column, say. They are replaced, where they stand, by operators that are the same everywhere, or given dense tensors.
"""

import functools
import math
from collections.abc import Callable
from typing import Any

import torch

from porse.code import sleef
from porse.code.contract import words
from porse.code.graph import Writer, nodes
from porse.code.numbers import is_single

_FLOAT32, _FLOAT64 = 6, 7
"""TorchScript's numbers for float32 and float64."""
_CONTIGUOUS = 0
"""TorchScript's number for the usual layout."""
_VIEWS = words("""
    __getitem__ broadcast_to detach diagonal expand expand_as flatten moveaxis movedim mT narrow numpy_T permute ravel reshape
    reshape_as select slice squeeze swapaxes swapdims t to transpose type_as unbind unflatten unsqueeze view view_as
    ListUnpack
    """)
"""Operators whose results may be strided. Task variables are dense, and so is what other operators make of dense ones."""
_EXACT_POWERS = (-2, -1, -0.5, 0, 1, 2, 3)
"""Exponents for which torch multiplies, divides and takes roots."""


def make_portable(graph: Any) -> None:
    """Replaces, in place, every operator on tensors that is not portable."""
    tensor = torch._C.TensorType.get()
    single = is_single(graph)
    for node in list(nodes(graph)):
        form = _FORMS.get(node.kind())
        if form is not None and node.outputsSize() == 1 and node.output().type().isSubtypeOf(tensor):
            value = form(_Builder(graph, node, single), *node.inputs())
            if value is not None:
                node.output().replaceAllUsesWith(value)
                node.destroy()


class _Builder(Writer):
    """Writes nodes in front of one; `single` says whether every tensor of floats in the graph is float32."""

    def __init__(self, graph: Any, node: Any, single: bool) -> None:
        super().__init__(graph, node)
        self.single = single


def _sqrt(to: _Builder, x: Any) -> Any:
    """Both steps are exactly rounded on every CPU; 0 and infinity go through infinity and 0 and come back."""
    norm = _norm(to, x)
    return to.op("reciprocal_", to.op("rsqrt", x)) if norm is None else norm


def _norm(to: _Builder, total: Any) -> Any:
    """Returns the root of a sum of squares as the norm that it is, in two operators for four; None for anything else.

    Nothing else may read the squares, and nothing may stand between, where it could write to what is squared.
    """
    added = total.node()
    if (
        not to.single
        or added.kind() != "aten::sum"
        or added.inputsSize() != 4
        or not added.inputsAt(3).node().mustBeNone()
    ):
        return None
    squares = added.inputsAt(0)
    root = _root_of_square(squares.node())
    if root is None or len(squares.uses()) > 1 or len(total.uses()) > 1:
        return None
    before = to.node.prev()
    while before.kind() in ("prim::Constant", "prim::ListConstruct") or before == added:
        before = before.prev()
    if before != squares.node():
        return None
    dim, keepdim = added.inputsAt(1), added.inputsAt(2)
    to.node.replaceInput(0, root)
    added.destroy()
    before.destroy()
    no = to.constant(False)
    floats = to.op("to", root, to.constant(_FLOAT32), no, no, to.constant(None))  # a norm takes no integers
    return to.op("linalg_vector_norm", floats, to.constant(2), dim, keepdim, to.constant(None))


def _root_of_square(node: Any) -> Any:
    """Returns what a node squares, None when it does not."""
    values = list(node.inputs())
    if node.kind() == "aten::pow":
        return values[0] if values[1].node().kind() == "prim::Constant" and values[1].toIValue() == 2 else None
    if node.kind() == "aten::mul":
        return values[0] if values[0].debugName() == values[1].debugName() else None
    return values[0] if node.kind() == "aten::square" else None


def _by_sleef(function: sleef.Function, to: _Builder, x: Any) -> Any:
    """Sleef writes over a copy, which `porse.code.reuse` takes away where nothing else reads x."""
    if not sleef.is_needed():
        return None
    copy = to.op("mul", x, to.constant(1.0))  # the copy is dense, and integers become floats as they would
    if to.single:
        return to.op(sleef.operator(function, "f32"), copy)
    no = to.constant(False)
    double = to.op("to", copy, to.constant(_FLOAT64), no, no, to.constant(None))
    return to.op("type_as", to.op(sleef.operator(function, "f64"), double), copy)


def _on_dense(to: _Builder, *inputs: Any) -> Any:
    """Returns the same operator on dense tensors, which go through Sleef; None when they are dense as they are."""
    dense = [_dense(to, value) for value in inputs]
    return None if dense == list(inputs) else to.op(to.node.kind(), *dense)


def _dense(to: _Builder, value: Any) -> Any:
    is_view = value.node().kind().partition("::")[2] in _VIEWS
    is_tensor = value.type().isSubtypeOf(torch._C.TensorType.get())
    return to.op("contiguous", value, to.constant(_CONTIGUOUS)) if is_tensor and is_view else value


def _gelu(to: _Builder, x: Any, approximate: Any) -> Any:
    if approximate.toIValue() == "tanh":
        one = to.constant(1)
        cube = to.op("mul", to.op("mul", to.op("mul", x, x), x), to.constant(0.044715))
        inner = to.op("tanh", to.op("mul", to.op("add", x, cube, one), to.constant(math.sqrt(2.0 / math.pi))))
        return to.op("mul", to.op("mul", x, to.constant(0.5)), to.op("add", inner, one, one))
    half = to.op("mul", x, to.constant(0.5))
    inner = to.op("erf", to.op("mul", half, to.constant(math.sqrt(2.0))))
    return to.op("addcmul", half, half, inner, to.constant(1))


def _pow(to: _Builder, x: Any, exponent: Any) -> Any:
    """An exponent that is a number not known yet, and may be 0.5, becomes a tensor, which has no special case."""
    tensor = torch._C.TensorType.get()
    if x.type().isSubtypeOf(tensor) and not exponent.type().isSubtypeOf(tensor):
        if exponent.node().kind() == "prim::Constant":
            if exponent.toIValue() == 0.5:
                return _sqrt(to, x)
            if exponent.toIValue() in _EXACT_POWERS:
                return None
            return _on_dense(to, x, exponent)
        if exponent.type().str() == "float":
            return to.op("pow", x, to.op("scalar_tensor", exponent, *[to.constant(None)] * 4))
    return None  # dense copies of both tensors, and Sleef, take 1.35 times as long as columns in the C library


_BY_SLEEF: dict[str, sleef.Function] = {
    "acos": "acos",
    "arccos": "acos",
    "asin": "asin",
    "arcsin": "asin",
    "atan": "atan",
    "arctan": "atan",
    "tan": "tan",
    "log10": "log10",
}
_DENSE_BY_SLEEF = words("""
    arctan2 arctanh atan2 atanh cosh exp2 hypot logaddexp logit mish sigmoid silu sinh softplus special_exp2 special_expit
    special_logit
    """)
_FORMS: dict[str, Callable[..., Any]] = {
    "aten::sqrt": _sqrt,
    "aten::pow": _pow,
    "aten::gelu": _gelu,
    **{f"aten::{name}": functools.partial(_by_sleef, function) for name, function in _BY_SLEEF.items()},
    **{f"aten::{name}": _on_dense for name in sorted(_DENSE_BY_SLEEF)},
}
