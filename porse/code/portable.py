"""Portable forms of the operators whose bits depend on the CPU's vendor, put into a compiled graph.

Square root, powers, arc cosine and arc sine go through MKL's vector maths, which no environment variable makes the
same on every CPU. They are replaced, where they stand, by operators that are the same everywhere.
"""

from typing import Any

import torch

from porse.code.graph import nodes


def make_portable(graph: Any) -> None:
    """Replaces, in place, every operator on tensors that is not portable."""
    tensor = torch._C.TensorType.get()
    for node in list(nodes(graph)):
        form = _FORMS.get(node.kind())
        if form is not None and node.outputsSize() == 1 and node.output().type().isSubtypeOf(tensor):
            form(_Builder(graph, node), node)


class _Builder:
    """Writes nodes in front of one node."""

    def __init__(self, graph: Any, node: Any) -> None:
        self.graph = graph
        self.node = node

    def op(self, kind: str, *inputs: Any) -> Any:
        """Returns the output of a new tensor operator."""
        new = self.graph.create(f"aten::{kind}", list(inputs), 1)
        new.insertBefore(self.node)
        new.copyMetadata(self.node)
        new.output().setType(torch._C.TensorType.get())
        return new.output()

    def constant(self, value: Any) -> Any:
        """Returns a constant."""
        constant = self.graph.insertConstant(value)
        constant.node().moveBefore(self.node)
        return constant

    def finish(self, value: Any) -> None:
        """Puts `value` in the node's place."""
        self.node.output().replaceAllUsesWith(value)
        self.node.destroy()


def _sqrt_of(builder: _Builder, value: Any) -> Any:
    """Both steps are exactly rounded on every CPU; 0 and infinity go through infinity and 0 and come back."""
    return builder.op("reciprocal", builder.op("rsqrt", value))


def _sqrt(builder: _Builder, node: Any) -> None:
    builder.finish(_sqrt_of(builder, node.inputsAt(0)))


def _root_of_complement(builder: _Builder, value: Any) -> Any:
    """Returns sqrt((1 - x)(1 + x))."""
    one = builder.constant(1)
    above = builder.op("add", value, one, one)
    below = builder.op("rsub", value, one, one)
    return _sqrt_of(builder, builder.op("mul", below, above))


def _acos(builder: _Builder, node: Any) -> None:
    value = node.inputsAt(0)
    builder.finish(builder.op("atan2", _root_of_complement(builder, value), value))


def _asin(builder: _Builder, node: Any) -> None:
    value = node.inputsAt(0)
    builder.finish(builder.op("atan2", value, _root_of_complement(builder, value)))


def _pow(builder: _Builder, node: Any) -> None:
    exponent = node.inputsAt(1)
    if exponent.node().kind() == "prim::Constant" and exponent.toIValue() == 0.5:
        builder.finish(_sqrt_of(builder, node.inputsAt(0)))


_FORMS = {
    "aten::sqrt": _sqrt,
    "aten::acos": _acos,
    "aten::arccos": _acos,
    "aten::asin": _asin,
    "aten::arcsin": _asin,
    "aten::pow": _pow,
}
