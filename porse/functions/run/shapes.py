"""What a list makes, for a few environments: types and shapes, from a run on few rows. Here a list is judged sound.

Shapes follow from the list, whatever the numbers are, and whole numbers in it grow evenly with the environments. So two small
runs tell the shapes for any number; a third one says whether sizes grow as evenly. Nothing is computed that could be large, end
the process or change a variable.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import zip_longest
from typing import Any

import torch
from torch import Tensor

from porse.functions.run.operators import Operator, operator
from porse.functions.run.program import Program, Rows, Share, Step, at, filled, leaves, registers
from porse.functions.verdict import CodeError, words

FEW = (7, 11, 19)
"""Environments of the three small runs: few, and unlike the sizes of vectors and rotations."""
MANY = 2048
"""Environments for which sizes are bounded at least."""
MAX_ELEMENTS = 2**26
"""Most numbers of one tensor at so many environments."""
MAX_ALL = 2**29
"""Most numbers of all tensors together."""
_PRODUCTS = words("addmm addmv baddbmm bmm cdist einsum inner kron linalg_multi_dot matmul mm outer tile")
"""Operators that make up to as many numbers as the product of what they are given."""
_DIVISIONS = words("div divide floor_divide fmod remainder")
"""Operators that end the process where a whole number is divided by 0, or the lowest by -1."""
TOO_MUCH = "the function needs more memory than it may use"
UNEVEN = "a tensor of the function grows faster than the number of environments; keep a row for each environment"
MAX_SMALL = 2**24
"""Most numbers of one tensor, or of what two could make together, in a small run."""


def is_too_much(error: Exception) -> bool:
    """Whether an error says that there is no more memory."""
    said = [part for part in error.args if isinstance(part, str)]  # a tensor's text cannot be had in a confined process
    return isinstance(error, MemoryError) or any(w in s for s in said for w in ("DefaultCPUAllocator", "bad_alloc"))


def shapes_of(program: Program, given: Mapping[str, Tensor], num_envs: int) -> list[Tensor]:
    """Returns what each register of a list holds, made of the first rows of `given`, for so few environments.

    Raises:
        CodeError: it changes a variable or a constant, divides whole numbers by what may be 0 or -1, takes sizes from
            data, or makes too much; checks "inplace", "static" and "memory".
        Exception: it fails, with whatever torch raises.
    """
    tensors = [given[name] for name in program.variables]
    values = [v[torch.arange(num_envs, device=v.device) % v.shape[0]] for v in tensors]
    device = values[0].device if values else None
    values += [constant.to(device) for constant in program.constants]
    shared = [frozenset([index]) for index in range(len(values))]  # whose memory each register may share
    fixed = [*program.variables, *["a constant"] * len(program.constants)]
    for step in program.steps:
        op, arguments, keywords = called(step, num_envs, device)
        if op.writes:
            for index in sorted(i for place in registers(arguments[:1]) for i in shared[place] if i < len(fixed)):
                message = f"the function changes its input {fixed[index]} in place; work on {fixed[index]}.clone()"
                raise CodeError("inplace", message)
        now = filled(arguments, values)
        check_call(op, filled(step.arguments, values))
        if _size(op, now) > MAX_SMALL:
            raise CodeError("memory", f"{TOO_MUCH}, in {op.name.partition('.')[0]}")
        with torch.inference_mode():
            made = op.call(*now, **keywords)
        parts = [made] if isinstance(made, Tensor) else list(made)
        if any(part.numel() > MAX_SMALL for part in parts):
            raise CodeError("memory", TOO_MUCH)
        if len(parts) != step.makes:
            raise CodeError("static", f"expected {step.makes} results of {step.operator}, found {len(parts)}")
        sharing = [arguments[place] for place in op.shares if place < len(arguments)]
        sources = frozenset[int]().union(*(shared[index] for index in registers(sharing)))
        for value in parts:
            shared.append(sources | {len(values)})
            values.append(value)
    return values


def called(step: Step, num_envs: int, device: torch.device | None) -> tuple[Operator, list[Any], dict[str, Any]]:
    """Returns the operator, the arguments and the keywords of a step, for so many environments."""
    op = operator(step.operator)
    return op, [*at(step.arguments, num_envs)], dict(step.keywords) | ({"device": device} if op.makes else {})


def _size(op: Operator, arguments: Sequence[Any]) -> int:
    """Returns how many numbers a step could make at most of what it is given."""
    tensors = [value for value in leaves(arguments) if isinstance(value, Tensor)]
    has_lists = any(isinstance(value, tuple) for value in arguments)
    if op.base in _PRODUCTS:
        size = math.prod(max(t.numel(), 1) for t in tensors)
    elif has_lists:
        size = sum(t.numel() for t in tensors)
    else:
        size = math.prod(map(max, zip_longest(*(t.shape[::-1] for t in tensors), fillvalue=1)))
    if has_lists or not tensors:
        size = max(size, 1) * math.prod(max(abs(v), 1) for v in leaves(arguments) if type(v) is int and v < 2**62)
    return size


def check_shapes(program: Program, few: Sequence[Sequence[Tensor]], num_envs: int) -> None:
    """Refuses a list whose results are no vectors of floats, or that makes too much for so many environments, or 2 048.

    Its shapes for the first two numbers of `FEW`, which are given, tell those for any number, if they tell those for the third.

    Raises:
        CodeError: checks "shape" and "memory".
    """
    for values, rows in zip(few, FEW, strict=True):
        for value in (values[index] for index in program.results):
            if value.shape != (rows,) or value.dtype is not torch.float32:
                found = f"{value.dtype} of {tuple(value.shape)}; validate the function again"
                raise CodeError("shape", f"expected floats of shape ({rows},), found {found}")
    count = max(num_envs, MANY)
    first, second, third = FEW
    rounds, check = ((n - first) / (second - first) for n in (count, third))
    sizes = []
    for sides in _sides(few):
        if any(c != a + (b - a) * check for a, b, c in sides):
            raise CodeError("memory", UNEVEN)
        sizes.append(math.prod(a + (b - a) * rounds for a, b, _ in sides))
    if max(sizes, default=0) > MAX_ELEMENTS * count / MANY or sum(sizes) > MAX_ALL * count / MANY:
        raise CodeError("memory", TOO_MUCH)


def makes_pairs(few: Sequence[Sequence[Tensor]]) -> bool:
    """Whether a list makes something for every pair of environments, by its shapes for the numbers of `FEW`."""
    return any(sum(one != other for one, other, _ in sides) > 1 for sides in _sides(few))


def _sides(few: Sequence[Sequence[Tensor]]) -> Iterator[list[tuple[int, ...]]]:
    """Yields the sizes of each register, dimension by dimension, each in all small runs side by side."""
    return (list(zip(*(v.shape for v in values), strict=True)) for values in zip(*few, strict=True))


def check_call(op: Operator, arguments: Sequence[Any]) -> None:
    """Refuses what may end the process, and sizes from data: whole numbers divided by what may be 0 or -1, masks as indices.

    Numbers of environments may stand in the arguments as they are in a list.

    Raises:
        CodeError: check "static".
    """
    is_float = [isinstance(v, float | Share) or (isinstance(v, Tensor) and v.is_floating_point()) for v in arguments]
    may_trap = op.base in _DIVISIONS and (op.base not in ("div", "divide") or op.name.endswith("_mode"))
    if may_trap and not any(is_float) and _may_be_odd(arguments[1]):
        reason = "divides whole numbers by what may be 0 or -1, which ends the process"
        raise CodeError("static", f"{op.base} {reason}; make them floats first, x.float()")
    if op.base in ("index", "index_put"):
        masks = [v for v in arguments[1] if isinstance(v, Tensor) and v.dtype in (torch.bool, torch.uint8)]
        if masks and not (op.base == "index_put" and arguments[2].numel() == 1):
            raise CodeError("static", BY_MASK)


def _may_be_odd(divisor: Any) -> bool:
    """Whether a divisor may be 0 or -1, for some number of environments or for some data."""
    if isinstance(divisor, Rows):
        return divisor.plus in (0, -1) if not divisor.times else divisor.times < 0 or divisor.plus < 0
    return isinstance(divisor, Tensor) or divisor in (0, -1)


BY_MASK = (
    "a mask as an index takes as many rows as the data say, which is not allowed; use torch.where(mask, x, y), or"
    " x * mask.float()"
)
