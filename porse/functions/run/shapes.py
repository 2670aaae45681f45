"""What a list makes, without its numbers: types and shapes, from a run on tensors that hold none. Here a list is judged sound.

Nothing of what is asked here depends on numbers: what is sound for some environments and for many is so in every call.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from porse.functions.run.operators import Operator, divides, operator
from porse.functions.run.program import Program, Register, Step, at, registers
from porse.functions.verdict import CodeError

MANY = 2048
"""Environments for which sizes are bounded."""
MAX_ELEMENTS = 2**26
"""Most numbers of one tensor at so many environments."""
MAX_ALL = 2**29
"""Most numbers of all tensors together."""


@dataclass(frozen=True)
class Shapes:
    """What the registers of a list hold for one number of environments: tensors without numbers.

    Attributes:
        values: one for each register.
        shared: for each register, the registers whose memory it may share, itself included.
    """

    values: list[Tensor]
    shared: list[frozenset[int]]

    @property
    def is_single(self) -> bool:
        """Whether no register holds floats of another size than 32 bits."""
        return not any(v.is_floating_point() and v.dtype is not torch.float32 for v in self.values)


def shapes_of(program: Program, given: Mapping[str, Tensor], num_envs: int) -> Shapes:
    """Returns what a list makes of variables of the types and shapes of `given`, for so many environments.

    Raises:
        CodeError: it fails, changes a variable or a constant, divides whole numbers by what may be 0 or -1, takes sizes
            from data, or makes too much; checks "run", "inplace", "static" and "memory".
    """
    values = [_empty((num_envs, *given[name].shape[1:]), given[name].dtype) for name in program.variables]
    values += [_empty(torch.tensor(c.values, dtype=c.dtype).shape, c.dtype) for c in program.constants]
    shared = [frozenset([index]) for index in range(len(values))]
    for step in program.steps:
        op = operator(step.operator)
        made = _made(program, step, op, values, shared, num_envs)
        given = [step.arguments[place] for place in sorted(op.shares) if place < len(step.arguments)]
        sources = frozenset[int]().union(*(shared[index] for value in given for index in registers(value)))
        for value in made:
            shared.append(sources | {len(values)})
            values.append(value)
    if sum(value.numel() for value in values) > MAX_ALL * max(1, num_envs / MANY):
        raise CodeError("memory", "the function needs more memory than it may use")
    return Shapes(values, shared)


def check_results(program: Program, shapes: Shapes, num_envs: int) -> None:
    """Refuses a list whose results are no vectors of floats.

    Raises:
        CodeError: check "shape".
    """
    for index in program.results:
        value = shapes.values[index]
        if value.shape != (num_envs,) or value.dtype is not torch.float32:
            found = f"{value.dtype} of {tuple(value.shape)}"
            raise CodeError("shape", f"expected floats of shape ({num_envs},), found {found}; validate the function again")


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
    if op.base == "index_put":
        return [arguments[0] if op.writes else torch.empty_like(arguments[0])]
    if op.makes:
        keywords["device"] = "meta"
    try:
        with torch.inference_mode():
            made = op.call(*arguments, **keywords)
    except Exception as error:  # whatever it is, the list is wrong
        raise CodeError("run", f"torch says: {str(error).splitlines()[0][:600]}") from None
    parts = [made] if isinstance(made, Tensor) else list(made)
    if len(parts) != step.makes:
        raise CodeError("static", f"expected {step.makes} results of {step.operator}, found {len(parts)}")
    if any(part.numel() > MAX_ELEMENTS * max(1, num_envs / MANY) for part in parts):
        raise CodeError("memory", "the function needs more memory than it may use")
    return parts


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


def _empty(shape: Sequence[int], dtype: torch.dtype) -> Tensor:
    return torch.empty(tuple(shape), dtype=dtype, device="meta")
