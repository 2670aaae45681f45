"""What a list makes, for a few environments: types and shapes, from a run on few rows. Here a list is judged sound.

Shapes follow from the list, whatever the numbers are, and whole numbers in it grow evenly with the environments. So two small
runs tell the shapes for any number. Nothing is computed that could be large, end the process or change a variable.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from porse.functions.run.operators import Operator, base_of, divides, operator
from porse.functions.run.program import Program, Register, Step, at, registers
from porse.functions.verdict import CodeError, words

FEW = (7, 11)
"""Environments of the two small runs: few, and unlike the sizes of vectors and rotations."""
MANY = 2048
"""Environments for which sizes are bounded at least."""
MAX_ELEMENTS = 2**26
"""Most numbers of one tensor at so many environments."""
MAX_ALL = 2**29
"""Most numbers of all tensors together."""
_PRODUCTS = words("addmm addmv baddbmm bmm cdist einsum inner kron linalg_multi_dot matmul mm outer tile")
"""Operators that make up to as many numbers as the product of what they are given."""
MAX_SMALL = 2**24
"""Most numbers of one tensor, or of what two could make together, in a small run."""


@dataclass(frozen=True)
class Shapes:
    """What the registers of a list hold for a few environments.

    Attributes:
        values: a tensor for each register.
        shared: for each register, the registers whose memory it may share, itself included.
    """

    values: list[Tensor]
    shared: list[frozenset[int]]

    @property
    def is_single(self) -> bool:
        """Whether no register holds floats of another size than 32 bits."""
        return not any(v.is_floating_point() and v.dtype is not torch.float32 for v in self.values)


def shapes_of(program: Program, given: Mapping[str, Tensor], num_envs: int) -> Shapes:
    """Returns what a list makes of the first rows of `given`, for so few environments.

    Raises:
        CodeError: it fails, changes a variable or a constant, divides whole numbers by what may be 0 or -1, takes sizes
            from data, or makes too much; checks "run", "inplace", "static" and "memory".
    """
    values = [
        v[torch.arange(num_envs, device=v.device) % v.shape[0]] for v in map(given.__getitem__, program.variables)
    ]
    device = values[0].device if values else torch.device("cpu")
    values += [torch.tensor(c.values, dtype=c.dtype, device=device) for c in program.constants]
    shared = [frozenset([index]) for index in range(len(values))]
    for step in program.steps:
        op = operator(step.operator)
        made = _made(program, step, op, values, shared, num_envs)
        places = [step.arguments[place] for place in sorted(op.shares) if place < len(step.arguments)]
        sources = frozenset[int]().union(*(shared[index] for value in places for index in registers(value)))
        for value in made:
            shared.append(sources | {len(values)})
            values.append(value)
    return Shapes(values, shared)


def check_sizes(few: Shapes, more: Shapes, num_envs: int) -> None:
    """Refuses a list that makes too much for so many environments, or for 2 048.

    Args:
        few: its shapes for the first of `FEW`.
        more: its shapes for the second.
        num_envs: the number of environments that it will be called for.

    Raises:
        CodeError: check "memory".
    """
    count = max(num_envs, MANY)
    sizes = [_grown(a.shape, b.shape, count) for a, b in zip(few.values, more.values, strict=True)]
    if max(sizes, default=0) > MAX_ELEMENTS * count / MANY or sum(sizes) > MAX_ALL * count / MANY:
        raise CodeError("memory", "the function needs more memory than it may use")


def _grown(few: Sequence[int], more: Sequence[int], num_envs: int) -> float:
    """Returns how many numbers a tensor has for so many environments, of its shapes for two small numbers of them."""
    pairs = zip(few, more, strict=True)
    return math.prod(a + (b - a) / (FEW[1] - FEW[0]) * (num_envs - FEW[0]) for a, b in pairs)


def check_results(program: Program, shapes: Shapes, num_envs: int) -> None:
    """Refuses a list whose results are no vectors of floats.

    Raises:
        CodeError: check "shape".
    """
    for index in program.results:
        value = shapes.values[index]
        if value.shape != (num_envs,) or value.dtype is not torch.float32:
            found = f"{value.dtype} of {tuple(value.shape)}"
            raise CodeError(
                "shape", f"expected floats of shape ({num_envs},), found {found}; validate the function again"
            )


def mixing(program: Program, few: Shapes, many: Shapes) -> int | None:
    """Returns the first step that makes something for every pair of environments, None for none.

    Args:
        program: the list.
        few: its shapes for a number of environments.
        many: the same for another number.
    """
    made = program.first_made
    for number, step in enumerate(program.steps):
        for index in range(made, made + step.makes):
            sizes = zip(few.values[index].shape, many.values[index].shape, strict=True)
            if sum(a != b for a, b in sizes) > 1:
                return number
        made += step.makes
    return None


def _made(
    program: Program, step: Step, op: Operator, values: list[Tensor], shared: Sequence[frozenset[int]], num_envs: int
) -> list[Tensor]:
    """Returns what one step makes."""
    arguments = [_filled(at(value, num_envs), values) for value in step.arguments]
    keywords = {name: _filled(at(value, num_envs), values) for name, value in step.keywords}
    if op.writes:
        fixed = set(range(program.first_made))
        (target,) = registers(step.arguments[0])
        written = sorted(shared[target] & fixed)
        if written:
            names = [*program.variables, *["a constant"] * len(program.constants)]
            what = names[written[0]]
            raise CodeError("inplace", f"the function changes its input {what} in place; work on {what}.clone()")
    check_call(op, arguments)
    _check_small(step, arguments)
    if op.makes:
        keywords["device"] = values[0].device if values else torch.device("cpu")
    try:
        with torch.inference_mode():
            made = op.call(*arguments, **keywords)
    except Exception as error:  # whatever it is, the list is wrong
        raise CodeError("run", f"torch says: {str(error).splitlines()[0][:600]}") from None
    parts = [made] if isinstance(made, Tensor) else list(made)
    if len(parts) != step.makes:
        raise CodeError("static", f"expected {step.makes} results of {step.operator}, found {len(parts)}")
    if any(part.numel() > MAX_SMALL for part in parts):
        raise CodeError("memory", "the function needs more memory than it may use")
    return parts


def _check_small(step: Step, arguments: Sequence[Any]) -> None:
    """Refuses a step that could make something large of what it is given, before it does."""
    tensors = [value for value in _flat(arguments) if isinstance(value, Tensor)]
    if base_of(step.operator) in _PRODUCTS:
        size = math.prod(max(t.numel(), 1) for t in tensors)
    elif any(isinstance(value, list) for value in arguments):
        size = sum(t.numel() for t in tensors)
    else:
        rows = [[1] * (8 - t.dim()) + list(t.shape) for t in tensors]
        size = math.prod(max(sizes) for sizes in zip(*rows, strict=True)) if rows else 1
    wholes = [abs(v) for v in _flat(arguments) if isinstance(v, int) and not isinstance(v, bool) and v < 2**62]
    if any(isinstance(v, list) for v in arguments) or not tensors:
        size = max(size, 1) * math.prod(max(n, 1) for n in wholes)
    if size > MAX_SMALL:
        raise CodeError(
            "memory", f"the function needs more memory than it may use, in {step.operator.partition('.')[0]}"
        )


def _flat(values: Any) -> list[Any]:
    return [part for value in values for part in (_flat(value) if isinstance(value, list) else [value])]


def check_call(op: Operator, arguments: Sequence[Any]) -> None:
    """Refuses what may end the process, and sizes from data: whole numbers divided by what may be 0 or -1, masks as indices.

    Raises:
        CodeError: check "static".
    """
    is_float = [isinstance(v, float) or (isinstance(v, Tensor) and v.is_floating_point()) for v in arguments]
    if divides(op) and not any(is_float) and (isinstance(arguments[1], Tensor) or arguments[1] in (0, -1)):
        raise CodeError(
            "static",
            f"{op.base} divides whole numbers by what may be 0 or -1, which ends the process; make them floats first,"
            " x.float()",
        )
    if op.base in ("index", "index_put"):
        masks = [v for v in arguments[1] if isinstance(v, Tensor) and v.dtype in (torch.bool, torch.uint8)]
        if masks and not (op.base == "index_put" and arguments[2].numel() == 1):
            raise CodeError("static", BY_MASK)


BY_MASK = (
    "a mask as an index takes as many rows as the data say, which is not allowed; use torch.where(mask, x, y), or"
    " x * mask.float()"
)


def _filled(value: Any, values: Sequence[Tensor]) -> Any:
    if isinstance(value, list):
        return [_filled(part, values) for part in value]
    return values[value.index] if isinstance(value, Register) else value
