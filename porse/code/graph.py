"""The compiled graph: the second allow-list, over operators, and what only the graph can tell.

After inlining it holds every operator that will run, those of torch's own Python functions included. An operator that
is not on the list does not run. The graph also tells whether a size or a count depends on data, so that memory and
time could grow after the probe.
"""

import re
from collections.abc import Iterator
from typing import Any

import torch

from porse.code.contract import METHODS, TORCH_FUNCTIONS, TORCH_MODULES
from porse.code.verdict import CodeError

_INTERNAL = frozenset(
    """
    Bool Float FloatImplicit Int IntImplicit ScalarImplicit __and__ __contains__ __derive_index __getitem__ __is__
    __isnot__ __not__ __or__ __range_length __xor__ _set_item append clamp_min_ copy_ device dict embedding extend fabs
    format frobenius_norm index index_put_ items keys len linalg_matrix_norm linalg_vector_norm list log_sigmoid
    masked_fill_ ndim nuclear_norm degrees radians relu_ slice str type_as values warn is_floating_point elu celu
    copy cosine_similarity dtype layout rsub hardswish scalar_tensor floordiv mod remainder eq ne round floor ceil pow
    """.split()  # noqa: SIM905
)
_ALLOWED = (
    TORCH_FUNCTIONS
    | METHODS
    | _INTERNAL
    | {f"{module}_{name}" for module in ("linalg", "special") for name in TORCH_MODULES[module]}
    | TORCH_MODULES["nn.functional"]
)
_PRIM = frozenset(
    """
    ComprehensionScope Constant DictConstruct If ListConstruct ListUnpack Loop NumToTensor Print RaiseException
    TupleConstruct TupleIndex TupleSlice TupleUnpack Uninitialized abs data device dtype is_cuda isinstance is_nested
    layout max min requires_grad shape type unchecked_cast unchecked_unwrap_optional
    """.split()  # noqa: SIM905
)
_SIZES = frozenset(("aten::size", "aten::len", "aten::dim", "aten::ndim", "aten::numel", "prim::dtype", "prim::layout"))


def nodes(block: Any) -> Iterator[Any]:
    """Yields every node of a graph or block, nested ones too."""
    for node in block.nodes():
        yield node
        for inner in node.blocks():
            yield from nodes(inner)


def line_of(node: Any) -> int:
    """Returns the line of the compiled text that a node comes from, 0 for none."""
    found = re.findall(r'File "<string>", line (\d+)', node.sourceRange())
    return int(found[-1]) if found else 0


def flatten(function: Any) -> Any:
    """Returns a copy of a compiled function's graph, checked, with calls inlined and constants folded.

    Raises:
        CodeError: an operator is not on the list, or a size depends on data; check "static".
    """
    graph = function.graph.copy()
    torch._C._jit_pass_inline(graph)
    _check_operators(graph)
    torch._C._jit_pass_constant_propagation(graph)
    torch._C._jit_pass_peephole(graph, False)
    torch._C._jit_pass_dce(graph)
    _check_sizes(graph)
    return graph


def _check_operators(graph: Any) -> None:
    for node in nodes(graph):
        space, _, name = node.kind().partition("::")
        if not (space == "aten" and name in _ALLOWED) and not (space == "prim" and name in _PRIM):
            raise CodeError("static", f"the operator {node.kind()} is not on the list of allowed operators", line_of(node))


def _check_sizes(graph: Any) -> None:
    """Refuses integers that are made from data: only shapes, loop counts and constants may size anything."""
    for node in nodes(graph):
        kind = node.kind()
        whole = [value for value in node.outputs() if value.type().str() in ("int", "Scalar")]
        if kind == "aten::arange":
            sizes = [value for value in node.inputs() if value.type().str() in ("float", "Scalar", "number")]
            whole = [value for value in sizes if value.node().kind() != "prim::Constant"]
        elif kind in _SIZES or kind == "aten::item" or not any(_is_data(value) for value in node.inputs()):
            continue
        if whole:
            raise CodeError(
                "static",
                f"{kind.partition('::')[2]} makes a whole number or a size from the values of a tensor, which is not"
                " allowed; sizes come from shapes and num_envs, and tensors stay tensors",
                line_of(node),
            )


def _is_data(value: Any) -> bool:
    return value.type().str() in ("Tensor", "float", "Scalar", "number") and value.node().kind() != "prim::Constant"
