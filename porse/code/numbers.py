"""Numbers that meet tensors, held as tensors: the same bits, without making a tensor of the number in every call.

That takes half a microsecond and more, as long as the arithmetic on a thousand environments. A plain number does not
decide a result's type where a tensor might: that makes no difference while every tensor of floats is float32, since a
float makes float32 of integers too. Task variables are float32 or int64; graphs that make other floats are left alone.
"""

from typing import Any

import torch

from porse.code.contract import words
from porse.code.graph import nodes

_OPERATORS = words("add sub mul div add_ sub_ mul_ div_ lt le gt ge eq ne")
_ALWAYS_FLOATS = words("""
    acos arccos asin arcsin atan arctan atan2 atan2_ cos exp exp_ linalg_vector_norm log log1p mean norm reciprocal
    reciprocal_ rsqrt sigmoid sin sqrt tanh
    """)
_FLOATS_OF_FLOATS = words("abs add clamp div mul neg pow select slice square squeeze sub unsqueeze")
_TYPES = (None, 0, 3, 4, 6, 11)
"""TorchScript's numbers for uint8, int32, int64, float32 and bool; None is the usual type."""


def hold_numbers(graph: Any) -> None:
    """Puts, in place, float32 tensors where constants are the second argument of a plain operator on tensors.

    An integer, which leaves integers what they are, is held only beside what is certainly a float.
    """
    if not is_single(graph):
        return
    floats: set[str] = set()
    for node in list(nodes(graph)):
        space, _, name = node.kind().partition("::")
        values = list(node.inputs())
        if space != "aten" or not values or not values[0].type().isSubtypeOf(torch._C.TensorType.get()):
            continue
        beside_float = values[0].debugName() in floats
        if name in _OPERATORS and values[1].node().kind() == "prim::Constant":
            number = values[1].toIValue()
            if type(number) is float or (type(number) is int and beside_float):
                held = graph.insertConstant(torch.tensor(number, dtype=torch.float32))
                held.node().moveBefore(node)
                node.replaceInput(1, held)
        if name in _ALWAYS_FLOATS or (name in _FLOATS_OF_FLOATS and beside_float):
            floats.add(node.output().debugName())


def is_single(graph: Any) -> bool:
    """Returns whether every tensor of floats in a graph is float32, given that those among its arguments are."""
    return not any(_makes_other_floats(node) for node in nodes(graph))


def _makes_other_floats(node: Any) -> bool:
    """Returns whether a node may make floats of another type than float32."""
    if node.kind() == "prim::NumToTensor":
        return True
    if not node.kind().startswith("aten::"):
        return False
    arguments = torch._C.parse_schema(node.schema()).arguments  # fewer than the inputs for `format` alone
    types = [value for argument, value in zip(arguments, node.inputs(), strict=False) if argument.name == "dtype"]
    kinds = {value.node().kind() for value in types} - {"prim::dtype"}
    return not kinds <= {"prim::Constant"} or any(value.toIValue() not in _TYPES for value in types)
