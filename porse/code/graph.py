"""The compiled graph: the second allow-list, over operators, the rule against changing inputs, and portable forms.

After inlining and constant folding the graph holds every operator that will run, those of torch's own Python functions
included. An operator that is not on the list does not run.
"""

from collections.abc import Iterator
from typing import Any

import torch

from porse.code.contract import METHODS, TORCH_FUNCTIONS, TORCH_MODULES
from porse.code.verdict import CodeError

_INTERNAL = frozenset(
    """
    __contains__ __getitem__ __is__ __isnot__ __not__ __and__ __or__ __xor__ __range_length __derive_index _set_item
    Bool Float FloatImplicit Int IntImplicit ScalarImplicit append clamp_min_ copy_ dict device dtype embedding
    expand_as extend format frobenius_norm index index_put_ items keys values len linalg_cross linalg_vector_norm
    linalg_norm linalg_matrix_norm list ndim neg norm nuclear_norm percentFormat slice special_expit str type_as unchecked_cast warn
    layout is_floating_point masked_select softmin pairwise_distance degrees radians fabs isnan isinf isfinite cdist
    add_ sub_ mul_ div_ relu_ elu leaky_relu huber_loss smooth_l1_loss mse_loss l1_loss hardtanh hardsigmoid hardswish
    log_sigmoid softplus celu selu silu mish gelu threshold relu6 softsign alias
    """.split()  # noqa: SIM905
)
_ALLOWED = (
    TORCH_FUNCTIONS
    | METHODS
    | _INTERNAL
    | {f"linalg_{name}" for name in TORCH_MODULES["linalg"]}
    | {f"special_{name}" for name in TORCH_MODULES["special"]}
)
_PRIM = frozenset(
    """
    Constant DictConstruct If ListConstruct ListUnpack Loop TupleConstruct TupleIndex TupleUnpack TupleSlice Uninitialized
    data device dtype is_cuda layout max min abs type unchecked_cast isinstance NumToTensor Print RaiseException shape
    requires_grad unchecked_unwrap_optional EnumName ComprehensionScope is_nested
    """.split()  # noqa: SIM905
)


def nodes(block: Any) -> Iterator[Any]:
    """Yields every node of a graph or block, nested ones too."""
    for node in block.nodes():
        yield node
        for inner in node.blocks():
            yield from nodes(inner)


def flatten(function: Any) -> Any:
    """Returns a copy of a compiled function's graph with all calls inlined and constant branches resolved."""
    graph = function.graph.copy()
    torch._C._jit_pass_inline(graph)
    check_operators(graph)
    torch._C._jit_pass_constant_propagation(graph)
    torch._C._jit_pass_peephole(graph, False)
    torch._C._jit_pass_dce(graph)
    return graph


def check_operators(graph: Any) -> None:
    """Refuses a graph with an operator that is not on the list.

    Raises:
        CodeError: check "static".
    """
    for node in nodes(graph):
        space, _, name = node.kind().partition("::")
        allowed = (space == "aten" and name in _ALLOWED) or (space == "prim" and name in _PRIM)
        if not allowed:
            raise CodeError("static", f"the operator {node.kind()} is not on the list of allowed operators")


def written_inputs(graph: Any) -> list[int]:
    """Returns the positions of arguments that the graph may change in place."""
    aliases = graph.alias_db()
    return [i for i, value in enumerate(graph.inputs()) if aliases.has_writers(value)]
