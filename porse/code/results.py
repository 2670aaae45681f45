"""What a graph returns, as one list of vectors of floats: names and directions are known beforehand, and stay in Python.

To hand a tuple and a dictionary from TorchScript to Python takes half a microsecond and more, a fifth of a short function,
and to make a float of a truth value takes three times as long from Python.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch

from porse.code.graph import Writer

_FLOAT32 = 6
"""TorchScript's number for float32."""


@dataclass(frozen=True)
class Components:
    """A reward whose graph returns its components and then the total in one list; `names` are the components'."""

    names: tuple[str, ...]

    def assemble(self, tensors: list[torch.Tensor]) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """Returns the total and the components by name, of such a list."""
        total = tensors.pop()
        return total, dict(zip(self.names, tensors))  # noqa: B905 a tenth of a microsecond; they are as many


@dataclass(frozen=True)
class Progress:
    """A mapping whose graph returns its progress variables alone; their directions and names."""

    rises: list[bool]
    names: list[str]

    def assemble(self, tensors: list[torch.Tensor]) -> tuple[list[torch.Tensor], list[bool], list[str]]:
        """Returns the progress variables, their directions and their names."""
        return tensors, self.rises.copy(), self.names.copy()


def list_components(graph: Any) -> Components | None:
    """Makes a reward's graph return one list, in place; None, with the graph as it was, where names are not written out."""
    parts = _returned(graph, 2)
    if not parts or parts[1].node().kind() != "prim::DictConstruct" or len(parts[1].uses()) > 1:
        return None
    holder = parts[1].node()
    given = list(holder.inputs())
    names = tuple(_constant(value) for value in given[::2])
    tensors = [*given[1::2], parts[0]]
    are_names = all(isinstance(name, str) for name in names) and len({*names}) == len(names)
    if not are_names or not all(map(_is_tensor, tensors)):
        return None
    to = Writer(graph, next(graph.outputs()).node())
    _return(graph, to.op("prim::ListConstruct", *tensors, type_=torch._C.ListType.ofTensors()))
    holder.destroy()
    return Components(names)


def list_progress(graph: Any) -> Progress | None:
    """Makes a mapping's graph return one list, in place; None, with the graph as it was, where the rest is not written out."""
    parts = _returned(graph, 3)
    if not parts or parts[0].type().str() != "Tensor[]":
        return None
    rises, names = map(_constant, parts[1:])
    if not isinstance(rises, list) or not isinstance(names, list):
        return None
    _return(graph, parts[0])
    return Progress(rises, names)


def make_vectors(graph: Any, found: Sequence[torch.Tensor], tensor: int) -> bool:
    """Makes a graph that returns a list return vectors of floats, in place, where it returned something else.

    Args:
        graph: the graph.
        found: what it has returned in a call, whose types and dimensions those of all other calls have.
        tensor: the position of an argument that has a row for each environment.

    Returns:
        Whether anything had to be made and could be: not of a list that the function fills or reads itself.
    """
    listed = next(graph.outputs()).node()
    other = [value.dim() == 0 or value.dtype is not torch.float32 for value in found]
    is_grown = listed.kind() != "prim::ListConstruct" or listed.inputsSize() != len(found)
    if is_grown or len(listed.output().uses()) > 1 or not any(other):
        return False
    to = Writer(graph, listed)
    rows = to.op("size", list(graph.inputs())[tensor], to.constant(0), type_=torch._C.IntType.get())
    sizes = to.op("prim::ListConstruct", rows, type_=torch._C.ListType.ofInts())
    no, usual, floats = to.constant(False), to.constant(None), to.constant(_FLOAT32)
    for position, value in enumerate(found):
        made = listed.inputsAt(position)
        if value.dim() == 0:
            made = to.op("expand", made, sizes, no)
        if value.dtype is not torch.float32:
            made = to.op("to", made, floats, no, no, usual)
        listed.replaceInput(position, made)
    return True


def _returned(graph: Any, count: int) -> list[Any]:
    """Returns the parts of the tuple that a graph returns, none when they are not as many."""
    node = next(graph.outputs()).node()
    parts = list(node.inputs()) if node.kind() == "prim::TupleConstruct" else []
    return parts if len(parts) == count and len(node.output().uses()) == 1 else []


def _return(graph: Any, value: Any) -> None:
    held = next(graph.outputs()).node()
    graph.eraseOutput(0)
    graph.registerOutput(value)
    held.destroy()


def _constant(value: Any) -> Any:
    return value.toIValue() if value.node().kind() == "prim::Constant" else None


def _is_tensor(value: Any) -> bool:
    return bool(value.type().isSubtypeOf(torch._C.TensorType.get()))
