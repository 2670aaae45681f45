"""Operator lists that can be called: rewards and mappings as training sees them.

A list is judged when it is first called, and made ready once: given portable forms, and its numbers made tensors. For another number of environments only its numbers change. A call goes through the
operators in order, each of which takes its arguments from slots and fills one. It runs on the device of the variables.
"""

import contextlib
import functools
from collections.abc import Callable, Mapping, Sequence
from operator import itemgetter
from typing import Any

import torch
from torch import Tensor

from porse.functions.run.operators import Operator, Watch, operator
from porse.functions.run.portable import portable, with_norms
from porse.functions.run.program import Program, Register, at, filled, read_program, registers
from porse.functions.run.shapes import FEW, TOO_MUCH, called, check_shapes, is_too_much, shapes_of
from porse.functions.verdict import CodeError, Kind, words

Run = tuple[Callable[..., Any], Callable[[list[Any]], Any], Any]
"""What computes a step, what takes its arguments from the slots, and the slot, or the slots, that it fills."""

_HELD = words("add div eq ge gt le lt mul ne rsub sub")
"""Operators of two tensors that take a number as the second one: torch makes a tensor of it in every call."""


class Function:
    """A goal reward or a mapping: a list and what it is ready for.

    Args:
        text: the list, from a candidate.
        kind: what it has to be.
        portable: replace the operators whose bits depend on the CPU's vendor.

    Attributes:
        program: the list.
        shapes: what its registers hold for each number of environments in `FEW`, once it was called.
        names: of the components, or of the progress variables.
        rises: for each progress variable, whether the task needs it to rise.

    Raises:
        CodeError: the text is no list of this kind.
    """

    def __init__(self, text: str, kind: Kind, portable: bool) -> None:
        self.program = program = read_program(text)
        self.names, self.rises = program.names, program.rises
        self.shapes: list[list[Tensor]] = []
        self._is_portable, self._num_envs = portable, -1
        if program.kind != kind:
            raise CodeError("static", f"expected the operator list of a {kind}, found that of a {program.kind}")

    def __call__(self, variables: Mapping[str, Any]) -> list[Tensor]:
        """Returns the results, (num_envs,) and float32 each: a reward's total and components, or progress variables.

        Args:
            variables: the task's, by name.

        Raises:
            CodeError: the list is not sound, or an operator fails on these values.
        """
        given = [variables[name] for name in self.program.variables]
        num_envs = len(given[0]) if given else 0
        try:
            if num_envs != self._num_envs:
                if not self.shapes:
                    self.shapes = [shapes_of(self.program, variables, count) for count in FEW]
                    self._held, self._runs = _prepared(self.program, self.shapes[0], self._is_portable)
                check_shapes(self.program, self.shapes, num_envs)
                self._held_now, self._num_envs = at(self._held, num_envs), num_envs
            slots = [*given, *self._held_now]
            for call, take, to in self._runs:
                slots[to] = call(*take(slots))
        except CodeError:
            raise
        except Exception as error:  # whatever torch raises, the function has failed
            if is_too_much(error):
                raise CodeError("memory", TOO_MUCH) from None
            text = (str(error) or type(error).__name__).splitlines()[0][:600]
            raise CodeError("run", f"torch says: {text}") from None
        return [slots[index] for index in self.program.results]


def _prepared(program: Program, few: Sequence[Tensor], portably: bool) -> tuple[tuple[Any, ...], list[Run]]:
    """Returns what stands in the slots behind the variables, first of registers, then of written arguments, and the runs."""
    if portably and all(v.dtype is torch.float32 for v in few if v.is_floating_point()):
        program = with_norms(program)
        few = shapes_of(program, dict(zip(program.variables, few, strict=False)), FEW[0])
    read = {*program.results, *registers([step.arguments for step in program.steps])}
    slots: list[Any] = [*few]
    runs: list[Run] = []

    def place(value: Any) -> int:
        """Returns the slot of an argument; a list of registers is made anew in every call."""
        if isinstance(value, Register):
            return value.index
        slots.append(value)
        slot = len(slots) - 1
        if [*registers(value)]:
            runs.append((lambda *parts: parts, _taking([place(part) for part in value]), slot))
        return slot

    for step, made in zip(program.steps, program.starts, strict=False):
        op, example, keywords = called(step, FEW[0], few[0].device if few else None)
        if not op.writes and read.isdisjoint(range(made, made + step.makes)):
            continue  # nobody reads it
        arguments = [*step.arguments]
        call = portable(op, step.arguments) if portably else None
        if call is None:
            if op.base in _HELD and not keywords and _is_held(few, *arguments):
                op, arguments[1] = operator(f"{op.base}.Tensor"), torch.tensor(float(arguments[1]))
            call = _quickest(op, filled(example, few), keywords)
        if keywords:
            call = functools.partial(call, **keywords)
        if op.returns != 1:
            call = functools.partial(_parted, step.makes, call)
        taking = _taking([place(value) for value in arguments])
        runs.append((call, taking, made if op.returns == 1 else slice(made, made + step.makes)))
    return tuple(slots[len(program.variables) :]), runs


def _is_held(few: Sequence[Tensor], first: Any, second: Any) -> bool:
    """Whether a number meets a tensor of floats, and may as well be one."""
    tensor = few[first.index] if isinstance(first, Register) else torch.tensor(0)
    return type(second) in (int, float) and tensor.dtype is torch.float32 and tensor.dim() > 0


def _quickest(op: Operator, arguments: Sequence[Any], keywords: Mapping[str, Any]) -> Callable[..., Any]:
    """Returns torch's public function where it leads to the same operator: it parses its arguments quicker."""
    base = op.name.partition(".")[0]
    places = (torch, base), (torch.Tensor, base), (torch.linalg, base.removeprefix("linalg_"))
    public = next((getattr(place, name) for place, name in places if hasattr(place, name)), op.call)
    with contextlib.suppress(Exception), torch.inference_mode(), Watch() as seen:
        public(*arguments, **keywords)
    return public if seen.names == [op.name] else op.call


def _taking(places: Sequence[int]) -> Callable[[list[Any]], Any]:
    """Returns what takes arguments from the slots, always as a sequence, which itemgetter alone does for several."""
    few = slice(places[0], places[0] + 1) if places else slice(0)
    return itemgetter(*places) if len(places) > 1 else itemgetter(few)


def _parted(count: int, call: Callable[..., Any], *arguments: Any) -> Sequence[Tensor]:
    """Returns the results of an operator that has several, as many as were counted."""
    made = call(*arguments)
    if len(made) != count:
        raise ValueError(f"expected {count} results, found {len(made)}")
    return made
