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
from porse.code.numbers import is_single

_ONE = torch.tensor(1.0)
_FLOAT32 = 6
"""TorchScript's number for float32."""


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


class _Builder:
    """Writes nodes in front of one node.

    Attributes:
        node: the node.
        single: whether every tensor of floats in the graph is float32.
    """

    def __init__(self, graph: Any, node: Any, single: bool) -> None:
        self._graph = graph
        self.node = node
        self.single = single

    def op(self, kind: str, *inputs: Any) -> Any:
        """Returns the output of a new operator on tensors."""
        new = self._graph.create(f"aten::{kind}", list(inputs), 1)
        new.insertBefore(self.node)
        new.copyMetadata(self.node)
        new.output().setType(torch._C.TensorType.get())
        return new.output()

    def constant(self, value: Any) -> Any:
        """Returns a constant."""
        constant = self._graph.insertConstant(value)
        constant.node().moveBefore(self.node)
        return constant


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


def _tangent_of_asin(to: _Builder, x: Any) -> Any:
    """Returns x / sqrt(1 - x x), infinite at 1 and -1; `addcmul` rounds once, so the difference keeps its digits there.

    It is dense where x may be a column: of strided tensors `atan2` takes each number by itself, through the C library.
    """
    return to.op("mul_", to.op("rsqrt_", to.op("addcmul", to.constant(_ONE), x, x, to.constant(-1))), x)


def _acos(to: _Builder, x: Any) -> Any:
    tangent = _tangent_of_asin(to, x)
    return to.op("atan2", to.constant(_ONE), tangent, tangent)  # into the tangent, which nothing else reads


def _asin(to: _Builder, x: Any) -> Any:
    return to.op("atan2_", _tangent_of_asin(to, x), to.constant(_ONE))


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
