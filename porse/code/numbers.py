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
    floats = certain_floats(graph)
    for node in list(nodes(graph)):
        space, _, name = node.kind().partition("::")
        if space != "aten" or name not in _OPERATORS or not _reads_tensor_first(node):
            continue
        first, second = list(node.inputs())[:2]
        if second.node().kind() == "prim::Constant":
            number = second.toIValue()
            if type(number) is float or (type(number) is int and first.debugName() in floats):
                held = graph.insertConstant(torch.tensor(number, dtype=torch.float32))
                held.node().moveBefore(node)
                node.replaceInput(1, held)


def certain_floats(graph: Any) -> set[str]:
    """Returns the names of those values of a graph that are tensors of floats whatever its arguments are."""
    floats: set[str] = set()
    for node in nodes(graph):
        space, _, name = node.kind().partition("::")
        if space != "aten" or not _reads_tensor_first(node):
            continue
        if name in _ALWAYS_FLOATS or (name in _FLOATS_OF_FLOATS and node.inputsAt(0).debugName() in floats):
            floats.add(node.output().debugName())
    return floats


def _reads_tensor_first(node: Any) -> bool:
    return node.inputsSize() > 0 and node.inputsAt(0).type().isSubtypeOf(torch._C.TensorType.get())


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
