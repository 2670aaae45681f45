"""Which arguments a compiled graph may change in place, through views, lists, dictionaries, branches and loops.

Torch's own alias analysis puts every tensor that was ever in a dictionary into one set with the arguments, and so
accuses every reward with components; it also takes it that loops run at least once. This one reads the alias marks in
the operators' schemas, counts a loop that runs no time, and stays on the safe side where a schema says nothing.
"""

import re
from collections.abc import Iterable
from typing import Any

from porse.code.graph import nodes

_FRESH = frozenset(
    ("prim::Constant", "prim::NumToTensor", "prim::Uninitialized", "prim::Print", "prim::RaiseException")
)
_FILLS = frozenset(("aten::append", "aten::extend", "aten::_set_item", "aten::update"))
_UNMARKED = frozenset(("aten::einsum", "aten::atleast_1d", "aten::broadcast_tensors", "aten::type_as"))
"""Operators that may return their input although their schema does not say so."""


def first_write(graph: Any) -> tuple[int, Any] | None:
    """Returns the position of the first argument that may be changed and the node that may change it, or None."""
    reach = {value.debugName(): frozenset([i]) for i, value in enumerate(graph.inputs())}
    flow = _Flow(reach)
    everything = list(nodes(graph))
    size = -1
    while size != flow.size():
        size = flow.size()
        for node in everything:
            flow.through(node)
    for node in everything:
        if node.kind().endswith("_") and node.kind() not in _FILLS and node.kind().startswith("aten::"):
            shared = flow.get(node.inputsAt(0))
            if shared and node.inputsAt(0).type().str() == "Tensor":
                return min(shared), node
    return None


class _Flow:
    """For each value of a graph, the arguments that it may share memory with."""

    def __init__(self, reach: dict[str, frozenset[int]]) -> None:
        self._reach = reach

    def size(self) -> int:
        """Returns the number of pairs found so far; it only grows."""
        return sum(map(len, self._reach.values()))

    def get(self, value: Any) -> frozenset[int]:
        """Returns the arguments of one value."""
        return self._reach.get(value.debugName(), frozenset())

    def _add(self, value: Any, sources: Iterable[Any]) -> None:
        more = self.get(value).union(*map(self.get, sources))
        if more:
            self._reach[value.debugName()] = more

    def through(self, node: Any) -> None:
        """Hands on what flows through one node."""
        kind, inputs, outputs = node.kind(), list(node.inputs()), list(node.outputs())
        blocks = list(node.blocks())
        if kind == "prim::If":
            for block in blocks:
                for output, value in zip(outputs, block.outputs(), strict=True):
                    self._add(output, [value])
        elif kind == "prim::Loop":
            results, inner = list(blocks[0].outputs())[1:], list(blocks[0].inputs())[1:]
            for before, inside, result, after in zip(inputs[2:], inner, results, outputs, strict=True):
                self._add(inside, [before, result])
                self._add(after, [before, result])
        elif kind in _FILLS or (kind == "aten::add_" and inputs[0].type().str() != "Tensor"):
            self._add(inputs[0], inputs[1:])
            for output in outputs:
                self._add(output, inputs[:1])
        elif kind not in _FRESH:
            sources = _sources(node, inputs)
            for output in outputs:
                self._add(output, sources)


def _sources(node: Any, inputs: list[Any]) -> list[Any]:
    """Returns the inputs whose memory the outputs of a node may share."""
    kind, schema = node.kind(), node.schema()
    results = schema.rpartition("->")[2]
    if not kind.startswith("aten::") or "->" not in schema or kind in _UNMARKED:
        return inputs
    if kind.endswith("_") or re.search(r"Tensor\([a-z|!]+\)", results):
        return inputs[:1]
    return inputs if re.search(r"\[\]|Dict|\bt\b|\*", results) else []
