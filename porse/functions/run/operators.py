"""The allow-list of operators, as data: what a list may name, and what is known of each.

An operator is one of torch's (`aten`) by its name and overload, `mul.Tensor`. It must be on the list, take and return
nothing but tensors, numbers, texts and their lists, and write nowhere but over its first argument.
"""

import functools
import re
from dataclasses import dataclass
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode

from porse.functions.verdict import TENSOR_FUNCTIONS, CodeError, words

_NAMES = TENSOR_FUNCTIONS | words("""
        __and__ __iand__ __ior__ __ixor__ __or__ __xor__ addmm addmv alias aminmax arange atleast_1d atleast_2d
    bitwise_xor broadcast_tensors cat cdist celu column_stack concat concatenate constant_pad_nd contiguous copy
    cosine_similarity diag_embed einsum elu erfc expand expand_as eye fill frobenius_norm full full_like gelu
    hardshrink hardsigmoid hardswish hardtanh hstack huber_loss index index_put kron l1_loss leaky_relu linalg_cross
    linalg_matrix_norm linalg_multi_dot linalg_norm linalg_vecdot linalg_vector_norm linspace log_sigmoid mH mT
    matrix_H mish mse_loss new_full new_ones new_zeros nuclear_norm numpy_T ones ones_like pairwise_distance relu6
    repeat reshape_as resolve_conj rsub scalar_tensor scatter scatter_add selu silu slice smooth_l1_loss softplus
    softshrink special_erf special_exp2 special_expit special_expm1 special_log1p special_logit special_logsumexp
    special_sinc special_softmax special_xlogy split_with_sizes stack std_mean tensor_split threshold to type_as
    var_mean vdot view view_as vstack zero zeros zeros_like
    """)
"""Names of operators; an operator that writes over its first argument has the same name with an underscore after it."""

_BY_DATA = words("""
    item _local_scalar_dense is_nonzero nonzero nonzero_numpy masked_select equal allclose argwhere unique _unique2
    unique_dim unique_consecutive bincount repeat_interleave masked_scatter to_sparse where.default where.self_only
    tensor_split.tensor_indices_or_sections
    """)
"""Operators whose results' shapes, or Python's own course, follow from the numbers in a tensor."""

_ARGUMENTS = words("Optional List Tensor number int float bool str ScalarType Layout Device MemoryFormat SymInt")
_SHARING = words("atleast_1d atleast_2d broadcast_tensors einsum type_as contiguous reshape reshape_as to flatten")
"""Operators whose results may share memory with an argument where their schemas do not say so, or not always."""


class Watch(TorchDispatchMode):
    """Notes the operators that are called while it is entered; torch's compiler, slow to import, stays out.

    Attributes:
        names: of the operators, in order.
    """

    def __init__(self) -> None:
        super().__init__()
        self.names: list[str] = []

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Notes an operator and calls it."""
        self.names.append(func.__name__)
        return func(*args, **(kwargs or {}))

    @classmethod
    def _should_skip_dynamo(cls) -> bool:
        return False


@dataclass(frozen=True)
class Operator:
    """One overload of one operator.

    Attributes:
        name: `mul.Tensor`.
        base: the name without overload, and without the underscore of one that writes.
        call: what computes it.
        writes: it writes over its first argument.
        shares: places of the arguments that its results may share memory with.
        makes: it makes a tensor of numbers alone, and must be told the device.
        returns: how many tensors it returns; 0 for a list of as many as there are.
    """

    name: str
    base: str
    call: Any
    writes: bool
    shares: frozenset[int]
    makes: bool
    returns: int


def base_of(name: str) -> str:
    """Returns an operator's name without overload, and without the underscore of one that writes."""
    base = name.partition(".")[0]
    return base if base.startswith("__") else base.removesuffix("_")


def decides_by_data(name: str) -> bool:
    """Whether an operator's result has a shape that follows from numbers in a tensor, or is no tensor at all."""
    return name in _BY_DATA or name.partition(".")[0] in _BY_DATA


@functools.cache
def operator(name: str) -> Operator:
    """Returns the operator of a name.

    Raises:
        CodeError: it is not on the list; check "static".
    """
    base, _, overload = name.partition(".")
    packet = getattr(torch.ops.aten, base, None) if base_of(name) in _NAMES and not decides_by_data(name) else None
    found = getattr(packet, overload, None) if packet is not None and overload in packet.overloads() else None
    if found is None or not _is_plain(found._schema):
        raise CodeError("static", f"the operator aten::{base} is not on the list of allowed operators")
    arguments, returns = found._schema.arguments, found._schema.returns
    return Operator(
        name,
        base_of(name),
        found,
        writes=any(a.is_write for a in arguments),
        shares=frozenset(i for i, a in enumerate(arguments) if base in _SHARING or a.alias_info is not None),
        makes="device" in [a.name for a in arguments] and not any("Tensor" in str(a.type) for a in arguments),
        returns=0 if str(returns[0].type) == "List[Tensor]" else len(returns),
    )


def _is_plain(schema: Any) -> bool:
    """Whether an operator takes plain arguments, writes over the first at most, and returns tensors alone."""
    returns = [str(r.type) for r in schema.returns]
    kinds = {kind for argument in schema.arguments for kind in re.findall(r"\w+", str(argument.type))}
    writes_elsewhere = any(a.is_write and (place > 0 or a.kwarg_only) for place, a in enumerate(schema.arguments))
    return (returns == ["List[Tensor]"] or set(returns) == {"Tensor"}) and kinds <= _ARGUMENTS and not writes_elsewhere
