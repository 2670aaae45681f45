"""Results written into the memory of tensors that nothing else reads: the same bits, without asking for new memory.

That makes a usual function on a thousand environments up to 8 % faster. Only operators are touched that keep shape and
type whatever they are given: one tensor of floats in, and at most constants beside it.
"""

from typing import Any

import torch

from porse.functions.read.contract import words
from porse.code.graph import Writer
from porse.code.numbers import certain_floats, is_single

ALONE = words("abs cos exp log log1p neg reciprocal rsqrt sigmoid sin square tanh")
"""Operators on one tensor that may write over it."""
WITH_NUMBERS = words("add clamp div mul sub")
"""Operators on a tensor and constants that may write over the tensor."""
_NEW = ALONE | WITH_NUMBERS | words("addcmul atan2 linalg_vector_norm mean norm pow sqrt")


def reuse_memory(graph: Any) -> None:
    """Puts, in place, operators that write where they read, outside of branches and loops; copies for that are dropped."""
    if not is_single(graph):
        return
    floats = certain_floats(graph)
    for node in list(graph.nodes()):
        space, _, name = node.kind().partition("::")
        values = list(node.inputs())
        if space != "aten" or not ((name in ALONE and len(values) == 1) or name in WITH_NUMBERS):
            continue
        others_are_constants = all(value.node().kind() == "prim::Constant" for value in values[1:])
        if others_are_constants and values[0].debugName() in floats and _is_read_once(values[0]) and _is_new(values[0]):
            if name == "mul" and _is_one(values[1]):
                node.output().replaceAllUsesWith(values[0])
            else:
                written = Writer(graph, node).op(f"{name}_", *values, type_=node.output().type())
                floats.add(written.debugName())
                node.output().replaceAllUsesWith(written)
            node.destroy()


def _is_new(value: Any) -> bool:
    """Returns whether a value has dense memory of its own: an operator made it, or wrote into such memory, alone."""
    node = value.node()
    space, _, name = node.kind().partition("::")
    if space == "aten" and name in _NEW:
        return True
    return (
        space in ("aten", "porse")
        and name.endswith("_")
        and _is_read_once(node.inputsAt(0))
        and _is_new(node.inputsAt(0))
    )


def _is_read_once(value: Any) -> bool:
    return len({use.user for use in value.uses()}) == 1


def _is_one(constant: Any) -> bool:
    number = constant.toIValue()
    return isinstance(number, torch.Tensor) and number.dim() == 0 and number.item() == 1.0
