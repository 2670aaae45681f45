"""The compiled graph: the second allow-list, over operators, and what only the graph can tell.

After inlining it holds every operator that will run, those of torch's own Python functions included. An operator that
is not on the list does not run.
"""

import re
from collections.abc import Iterator
from typing import Any

import torch

from porse.functions.read.contract import METHODS, TORCH_FUNCTIONS, TORCH_MODULES, words
from porse.functions.verdict import CodeError

_INTERNAL = words("""
    Bool Float FloatImplicit Int IntImplicit ScalarImplicit __and__ __contains__ __derive_index __getitem__ __is__
    __isnot__ __not__ __or__ __range_length __xor__ _set_item append clamp_min_ copy_ device dict embedding extend fabs
    format frobenius_norm index index_put_ items keys len linalg_matrix_norm linalg_vector_norm list log_sigmoid
    masked_fill_ ndim nuclear_norm degrees radians relu_ slice str type_as values warn is_floating_point elu celu
    copy cosine_similarity dtype layout mT numpy_T rsub hardswish scalar_tensor sorted floordiv mod remainder eq ne round floor ceil pow
    """)
_ALLOWED = (
    TORCH_FUNCTIONS
    | METHODS
    | _INTERNAL
    | {f"{module}_{name}" for module in ("linalg", "special") for name in TORCH_MODULES[module]}
    | TORCH_MODULES["nn.functional"]
    | {f"{name}_" for name in TORCH_MODULES["nn.functional"]}  # behind inplace=True
)
_PRIM = words("""
    ComprehensionScope Constant DictConstruct If ListConstruct ListUnpack Loop NumToTensor Print RaiseException
    TupleConstruct TupleIndex TupleSlice TupleUnpack Uninitialized abs data device dtype is_cuda isinstance is_nested
    layout max min requires_grad shape type unchecked_cast unchecked_unwrap_optional
    """)
_TAKES_NO_NUMBERS = words("""
    If Loop TupleIndex TupleUnpack __is__ __isnot__ device dim dtype is_cuda is_floating_point is_nested isinstance layout
    len ndim numel requires_grad shape size type
    """)
_MAX_CALL_DEPTH = 64
_FOLDING_ROUNDS = 3
_LAST = 2**63 - 1
"""The end of a slice that goes to the end, where TorchScript writes it out."""

_fold_numbers: Any = torch._C._jit_pass_constant_propagation_immutable_types  # type: ignore[attr-defined]


def nodes(block: Any) -> Iterator[Any]:
    """Yields every node of a graph or block, nested ones too."""
    for node in block.nodes():
        yield node
        for inner in node.blocks():
            yield from nodes(inner)


class Writer:
    """Writes nodes in front of one node, which is `node`."""

    def __init__(self, graph: Any, node: Any) -> None:
        self.node = node
        self._graph = graph

    def op(self, name: str, *inputs: Any, type_: Any = None) -> Any:
        """Returns the output of a new operator, one of torch's and a tensor where nothing else is said."""
        new = self._graph.create(name if "::" in name else f"aten::{name}", list(inputs), 1)
        new.insertBefore(self.node)
        new.copyMetadata(self.node)
        new.output().setType(type_ or torch._C.TensorType.get())
        return new.output()

    def constant(self, value: Any) -> Any:
        """Returns a constant."""
        constant = self._graph.insertConstant(value)
        constant.node().moveBefore(self.node)
        return constant


def has_fixed_shapes(graph: Any) -> bool:
    """Returns whether the shapes and types of results follow from those of the arguments, whatever numbers are in them."""
    return not any(_follows_numbers(node) for node in nodes(graph))


def _follows_numbers(node: Any) -> bool:
    """Returns whether a node may decide by the numbers in a tensor: by a truth value or number that it takes out, or rows."""
    space, _, name = node.kind().partition("::")
    if space == "aten" and name == "index":
        return not all(map(_is_fixed_index, node.inputsAt(1).node().inputs()))
    if space == "aten" and name == "where" and node.inputsSize() == 1:
        return True
    reads_tensor = any("Tensor" in value.type().str() for value in node.inputs())
    gives_number = any("Tensor" not in value.type().str() for value in node.outputs())
    return reads_tensor and gives_number and name not in _TAKES_NO_NUMBERS


def _is_fixed_index(value: Any) -> bool:
    """Returns whether an index takes as many rows whatever the arguments are: nothing, or whole numbers written out."""
    index = value.toIValue() if value.node().kind() == "prim::Constant" else False
    return index is None or (isinstance(index, torch.Tensor) and index.dtype is torch.int64)


def line_of(node: Any) -> int:
    """Returns the line of the compiled text that a node comes from, 0 for none."""
    found = re.findall(r'File "<string>", line (\d+)', node.sourceRange())
    return int(found[-1]) if found else 0


def flatten(function: Any) -> Any:
    """Returns a copy of a compiled function's graph, checked, with calls inlined and numbers folded.

    What nothing needs is gone, and what is written twice stands there once.

    Raises:
        CodeError: an operator is not on the list; check "static".
    """
    # One pass inlines what callees call only while the optimiser is on; without it, one level a pass, always the same.
    torch._C._set_graph_executor_optimize(False)
    graph = function.graph.copy()
    for _ in range(_MAX_CALL_DEPTH):
        if not any(node.kind() == "prim::CallFunction" for node in nodes(graph)):
            break
        torch._C._jit_pass_inline(graph)
    _check_operators(graph)
    for _ in range(_FOLDING_ROUNDS):
        # Numbers, texts and their lists only: folding tensors would run operators before anything has limited them.
        _fold_numbers(graph)
        torch._C._jit_pass_peephole(graph, False)
    _drop_whole_slices(graph)
    torch._C._jit_pass_cse(graph)  # what is written twice is computed once: the same bits
    return graph


def _drop_whole_slices(graph: Any) -> None:
    """Takes `x` for `x[:]`, so that a column, `x[:, 3]`, is one operator and not two: nearly every function has some.

    Along the first dimension only, which every tensor that is sliced has; a colon too many elsewhere stays an error.
    """
    for node in list(nodes(graph)):
        if node.kind() != "aten::slice" or node.outputsSize() != 1:
            continue
        whole, *bounds = list(node.inputs())
        if not whole.type().isSubtypeOf(torch._C.TensorType.get()):
            continue
        if all(value.node().kind() == "prim::Constant" for value in bounds):
            dim, start, end, step = (value.toIValue() for value in bounds)
            if dim == 0 and start in (None, 0) and end in (None, _LAST) and step == 1:
                node.output().replaceAllUsesWith(whole)
                node.destroy()


def _check_operators(graph: Any) -> None:
    for node in nodes(graph):
        space, _, name = node.kind().partition("::")
        allowed = name in _ALLOWED if space == "aten" else space == "prim" and name in _PRIM
        if not allowed:
            raise CodeError(
                "static", f"the operator {node.kind()} is not on the list of allowed operators", line_of(node)
            )
