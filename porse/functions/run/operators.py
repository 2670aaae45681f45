"""The allow-list of operators, as data: what a list may name, and what is known of each.

An operator is one of torch's (`aten`) by its name and overload, `mul.Tensor`. It must be on the list, take and return
nothing but tensors, numbers, texts and their lists, and write nowhere but over its first argument.
"""

import functools
from dataclasses import dataclass
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode

from porse.functions.verdict import CodeError, words

_NAMES = words("""
    __and__ __iand__ __ior__ __ixor__ __or__ __xor__ abs absolute acos acosh add addcdiv addcmul addmm addmv alias
    all amax amin aminmax any arange arccos arccosh arcsin arcsinh arctan arctan2 arctanh argmax argmin argsort asin
    asinh atan atan2 atanh atleast_1d atleast_2d baddbmm bitwise_and bitwise_not bitwise_or bitwise_xor bmm
    broadcast_tensors broadcast_to cat cdist ceil celu chunk clamp clamp_max clamp_min clip clone column_stack
    concat concatenate conj constant_pad_nd contiguous copy copysign cos cosh cosine_similarity count_nonzero cross
    cummax cummin cumprod cumsum deg2rad diag_embed diagonal diff dist div divide dot einsum elu eq erf erfc exp
    exp2 expand expand_as expm1 eye fill fix flatten flip floor floor_divide fmax fmin fmod frac frobenius_norm full
    full_like gather ge gelu greater greater_equal gt hardshrink hardsigmoid hardswish hardtanh heaviside hstack
    huber_loss hypot index index_put index_select inner isclose isfinite isinf isnan isneginf isposinf kron l1_loss
    le leaky_relu lerp less less_equal linalg_cross linalg_matrix_norm linalg_multi_dot linalg_norm linalg_vecdot
    linalg_vector_norm linspace log log10 log1p log2 log_sigmoid log_softmax logaddexp logical_and logical_not
    logical_or logical_xor logit logsumexp lt mH mT masked_fill matmul matrix_H max maximum mean median min minimum
    mish mm moveaxis movedim mse_loss mul multiply mv nan_to_num nanmean nansum narrow ne neg negative new_full
    new_ones new_zeros norm not_equal nuclear_norm numpy_T ones ones_like outer pairwise_distance permute positive
    pow prod rad2deg ravel reciprocal relu relu6 remainder repeat reshape reshape_as resolve_conj roll round rsqrt
    rsub scalar_tensor scatter scatter_add select selu sgn sigmoid sign signbit silu sin sinc sinh slice
    smooth_l1_loss softmax softplus softshrink sort special_erf special_exp2 special_expit special_expm1
    special_log1p special_logit special_logsumexp special_sinc special_softmax special_xlogy split split_with_sizes
    sqrt square squeeze stack std std_mean sub subtract sum swapaxes swapdims t take_along_dim tan tanh tensor_split
    threshold tile to topk trace transpose tril triu true_divide trunc type_as unbind unflatten unsqueeze var
    var_mean vdot view view_as vstack where xlogy zero zeros zeros_like
    """)
"""Names of operators; an operator that writes over its first argument has the same name with an underscore after it."""

_BY_DATA = words("""
    item _local_scalar_dense is_nonzero nonzero nonzero_numpy masked_select equal allclose argwhere unique _unique2
    unique_dim unique_consecutive bincount repeat_interleave masked_scatter to_sparse where.default where.self_only
    """)
"""Operators whose results' shapes, or Python's own course, follow from the numbers in a tensor."""

_ARGUMENTS = words("Tensor number int float bool str ScalarType Layout Device MemoryFormat SymInt")
_DIVISIONS = words("div divide floor_divide fmod remainder")
_SHARING = words("atleast_1d atleast_2d broadcast_tensors einsum type_as contiguous reshape reshape_as to flatten")
"""Operators whose results may share memory with an argument where their schemas do not say so, or not always."""


class Watch(TorchDispatchMode):
    """What is told of every operator that is called while it is entered; torch's compiler, slow to import, stays out."""

    @classmethod
    def _should_skip_dynamo(cls) -> bool:
        return False


@dataclass(frozen=True)
class Operator:
    """One overload of one operator.

    Attributes:
        name: `mul.Tensor`.
        call: what computes it.
        writes: it writes over its first argument.
        shares: places of the arguments that its results may share memory with.
        makes: it makes a tensor of numbers alone, and must be told the device.
        returns: how many tensors it returns; 0 for a list of as many as there are.
    """

    name: str
    call: Any
    writes: bool
    shares: frozenset[int]
    makes: bool
    returns: int

    @property
    def base(self) -> str:
        """The name without overload, and without the underscore of one that writes."""
        return base_of(self.name)


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
    schema = found._schema if found is not None else None
    if found is None or schema is None or not _is_plain(schema):
        raise CodeError("static", f"the operator aten::{base} is not on the list of allowed operators")
    written = [a for a in schema.arguments if a.alias_info is not None and a.alias_info.is_write]
    first = schema.arguments[:1]
    if written and ([a.name for a in written] != [a.name for a in first] or schema.arguments[0].kwarg_only):
        raise CodeError("static", f"the operator aten::{base} is not on the list of allowed operators")
    kinds = [str(r.type) for r in schema.returns]
    return Operator(
        name,
        found,
        bool(written),
        _shared(base, schema),
        any(a.name == "device" for a in schema.arguments)
        and not any("Tensor" in str(a.type) for a in schema.arguments),
        0 if kinds == ["List[Tensor]"] else len(kinds),
    )


def _shared(base: str, schema: Any) -> frozenset[int]:
    """Returns the places of the arguments that results may share memory with."""
    places = range(len(schema.arguments))
    return frozenset(i for i in places if base in _SHARING or schema.arguments[i].alias_info is not None)


def _is_plain(schema: Any) -> bool:
    """Whether an operator takes plain arguments and returns tensors alone."""
    returns = {str(r.type) for r in schema.returns}
    if not schema.returns or not (returns == {"Tensor"} or (returns == {"List[Tensor]"} and len(schema.returns) == 1)):
        return False
    for argument in schema.arguments:
        words = set(str(argument.type).replace("[", " ").replace("]", " ").replace(",", " ").split())
        if argument.is_out or not words - {"Optional", "List"} <= _ARGUMENTS:
            return False
    return True


def divides(op: Operator) -> bool:
    """Whether an operator divides, and so ends the process where a whole number is divided by 0, or the lowest by -1."""
    return op.base in _DIVISIONS and (op.base not in ("div", "divide") or op.name.endswith("_mode"))
