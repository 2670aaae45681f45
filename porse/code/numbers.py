"""Numbers that are written out, held as tensors: the same bits, without making a tensor of them in every call.

`torch.tensor([0.0, 0.0, 1.0])` takes five microseconds. To make one of a number that meets a tensor takes half of one and
more, as long as the arithmetic on a thousand environments. A plain number does not decide a result's type where a tensor
might: that makes no difference while every tensor of floats is float32, since a float makes float32 of integers too.
Task variables are float32 or int64; graphs that make other floats are left alone.
"""

from typing import Any

import torch

from porse.functions.read.contract import words
from porse.code.graph import Writer, nodes

_OPERATORS = words("add sub mul div add_ sub_ mul_ div_ lt le gt ge eq ne")
_ALWAYS_FLOATS = words("""
    acos arccos asin arcsin atan arctan atan2 cos exp exp_ linalg_vector_norm log log1p mean norm reciprocal
    reciprocal_ rsqrt sigmoid sin sqrt tanh
    """)
_FLOATS_OF_FLOATS = words("abs add clamp div mul neg pow select slice square squeeze sub unsqueeze")
_DTYPES = {None: None, 0: torch.uint8, 3: torch.int32, 4: torch.int64, 6: torch.float32, 11: torch.bool}
"""Types by TorchScript's numbers for them; None is the usual one."""


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
                held = Writer(graph, node).constant(torch.tensor(number, dtype=torch.float32))
                node.replaceInput(1, held)


def hold_tensors(graph: Any) -> None:
    """Puts, in place, constants for tensors that are made of numbers which are written out, where nothing writes to them."""
    writes = graph.alias_db()
    for node in list(nodes(graph)):
        if node.kind() not in ("aten::tensor", "aten::as_tensor"):
            continue
        data, dtype, device = list(node.inputs())[:3]
        tensor = _tensor_of(_written_out(data), dtype)
        if tensor is None or writes.has_writers(node.output()):
            continue
        to = Writer(graph, node)
        held, no = to.constant(tensor), to.constant(False)
        if not device.node().mustBeNone():  # known in a call; where it is already there, nothing happens
            held = to.op("to", held, device, to.constant(None), no, no)
        node.output().replaceAllUsesWith(held)
        node.destroy()
    torch._C._jit_pass_dce(graph)  # the lists of those numbers


def _tensor_of(numbers: Any, dtype: Any) -> torch.Tensor | None:
    """Returns the tensor of a number or list of numbers, None where there is none or it would fail in a call."""
    if numbers is None or dtype.node().kind() != "prim::Constant" or dtype.toIValue() not in _DTYPES:
        return None
    try:
        return torch.tensor(numbers, dtype=_DTYPES[dtype.toIValue()])
    except (RuntimeError, ValueError, TypeError, OverflowError):
        return None


def _written_out(value: Any) -> Any:
    """Returns the number or list of numbers that a value is in every call, None when it may differ."""
    if value.node().kind() == "prim::Constant":
        number = value.toIValue()
        return number if isinstance(number, int | float) else None
    if value.node().kind() != "prim::ListConstruct" or len(value.uses()) > 1:  # who else has the list may fill it
        return None
    numbers = [_written_out(item) for item in value.node().inputs()]
    return numbers if numbers and not any(number is None for number in numbers) else None


def certain_floats(graph: Any) -> set[str]:
    """Returns the names of those values of a graph that are tensors of floats whatever its arguments are."""
    floats: set[str] = set()
    for node in nodes(graph):
        space, _, name = node.kind().partition("::")
        if space not in ("aten", "porse") or not _reads_tensor_first(node):
            continue
        if (
            space == "porse"
            or name in _ALWAYS_FLOATS
            or (name in _FLOATS_OF_FLOATS and node.inputsAt(0).debugName() in floats)
        ):
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
    return not kinds <= {"prim::Constant"} or any(value.toIValue() not in _DTYPES for value in types)
