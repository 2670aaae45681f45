"""Portable forms of the operators whose bits depend on the CPU's vendor, put into a compiled graph.

Measured with torch 2.13.0 on emulated CPUs (`docs/generated-code.md`): square root, pow(x, 0.5), arc cosine, arc sine,
arc tangent, tangent and the decimal logarithm go through MKL's vector maths, GELU through oneDNN, and no environment
variable makes these the same on every CPU. They are replaced, where they stand, by operators that are.
"""

import math
from collections.abc import Callable
from typing import Any

import torch

from porse.code.graph import nodes

_ONE = torch.tensor(1.0)


def make_portable(graph: Any) -> None:
    """Replaces, in place, every operator on tensors that is not portable."""
    tensor = torch._C.TensorType.get()
    for node in list(nodes(graph)):
        form = _FORMS.get(node.kind())
        if form is not None and node.outputsSize() == 1 and node.output().type().isSubtypeOf(tensor):
            value = form(_Builder(graph, node), *node.inputs())
            if value is not None:
                node.output().replaceAllUsesWith(value)
                node.destroy()


class _Builder:
    """Writes nodes in front of one node."""

    def __init__(self, graph: Any, node: Any) -> None:
        self._graph = graph
        self._node = node

    def op(self, kind: str, *inputs: Any) -> Any:
        """Returns the output of a new operator on tensors."""
        new = self._graph.create(f"aten::{kind}", list(inputs), 1)
        new.insertBefore(self._node)
        new.copyMetadata(self._node)
        new.output().setType(torch._C.TensorType.get())
        return new.output()

    def constant(self, value: Any) -> Any:
        """Returns a constant."""
        constant = self._graph.insertConstant(value)
        constant.node().moveBefore(self._node)
        return constant


def _sqrt(to: _Builder, x: Any) -> Any:
    """Both steps are exactly rounded on every CPU; 0 and infinity go through infinity and 0 and come back."""
    return to.op("reciprocal_", to.op("rsqrt", x))


def _tangent_of_asin(to: _Builder, x: Any) -> Any:
    """Returns x / sqrt((1 - x)(1 + x)), infinite at 1 and -1; the product keeps its digits there."""
    one = to.constant(1)
    below = to.op("rsub", x, one, one)
    return to.op("mul_", to.op("rsqrt", to.op("addcmul", below, x, below, one)), x)


def _acos(to: _Builder, x: Any) -> Any:
    return to.op("atan2", to.constant(_ONE), _tangent_of_asin(to, x))


def _asin(to: _Builder, x: Any) -> Any:
    return to.op("atan2", _tangent_of_asin(to, x), to.constant(_ONE))


def _atan(to: _Builder, x: Any) -> Any:
    return to.op("atan2", x, to.constant(_ONE))


def _tan(to: _Builder, x: Any) -> Any:
    return to.op("div", to.op("sin", x), to.op("cos", x))


def _log10(to: _Builder, x: Any) -> Any:
    return to.op("mul", to.op("log", x), to.constant(1.0 / math.log(10.0)))


def _gelu(to: _Builder, x: Any, approximate: Any) -> Any:
    one, half = to.constant(1), to.constant(0.5)
    if approximate.toIValue() == "tanh":
        cube = to.op("mul", to.op("mul", to.op("mul", x, x), x), to.constant(0.044715))
        inner = to.op("tanh", to.op("mul", to.op("add", x, cube, one), to.constant(math.sqrt(2.0 / math.pi))))
    else:
        inner = to.op("erf", to.op("mul", x, to.constant(math.sqrt(0.5))))
    return to.op("mul", to.op("mul", x, half), to.op("add", inner, one, one))


def _pow(to: _Builder, x: Any, exponent: Any) -> Any:
    """Only the exponent 0.5 is at risk; one that is not known yet becomes a tensor, which has no special case."""
    if not x.type().isSubtypeOf(torch._C.TensorType.get()) or exponent.type().isSubtypeOf(torch._C.TensorType.get()):
        return None
    if exponent.node().kind() == "prim::Constant":
        return _sqrt(to, x) if exponent.toIValue() == 0.5 else None
    if exponent.type().str() != "float":
        return None
    return to.op("pow", x, to.op("scalar_tensor", exponent, *[to.constant(None)] * 4))


_FORMS: dict[str, Callable[..., Any]] = {
    "aten::sqrt": _sqrt,
    "aten::acos": _acos,
    "aten::arccos": _acos,
    "aten::asin": _asin,
    "aten::arcsin": _asin,
    "aten::atan": _atan,
    "aten::arctan": _atan,
    "aten::tan": _tan,
    "aten::log10": _log10,
    "aten::gelu": _gelu,
    "aten::pow": _pow,
}
