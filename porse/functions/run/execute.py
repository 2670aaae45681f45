"""Operator lists that can be called: rewards and mappings as training sees them.

A list is made ready for one number of environments when it is first called for it: judged, given portable forms, its
numbers made tensors once, results written over what nobody reads any more, and each step a Python closure that calls one
operator. A call then runs the closures in order. It runs on the device of the variables.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from operator import itemgetter
from typing import Any, Generic, TypeVar

import torch
from torch import Tensor

from porse.functions.run.operators import Operator, Watch, base_of, operator
from porse.functions.run.portable import portable, with_norms
from porse.functions.run.program import Program, Register, Step, at, read_program, reads
from porse.functions.run.shapes import FEW, Shapes, check_results, check_sizes, shapes_of
from porse.functions.verdict import CodeError, words

Results = TypeVar("Results")
Run = Callable[[list[Any]], None]
"""One step: reads slots, fills slots."""

_HELD = words("add div eq ge gt le lt mul ne rsub sub")
"""Operators of two tensors that take a number as the second one: torch makes a tensor of it in every call."""
_IN_PLACE = words("""
    abs add clamp clamp_max clamp_min cos div exp log mul neg reciprocal relu rsqrt sigmoid sin sqrt square sub tanh
    """)
"""Operators that keep shape and type, and that exist in a form that writes over the first argument."""


class _Function(ABC, Generic[Results]):
    """A list and the variables that it takes.

    Attributes:
        program: the list.
    """

    def __init__(self, program: Program, is_portable: bool) -> None:
        """Takes a list, which is judged when it is first called."""
        self.program = program
        self._is_portable = is_portable
        picked = program.variables
        self._pick: Callable[[Mapping[str, Any]], Any] = itemgetter(*picked) if picked else lambda variables: ()
        self._takes_one = len(picked) == 1
        self._ready: tuple[int, list[Any], list[Run], Callable[[list[Any]], Any]] = (-1, [], [], itemgetter(0))

    def __call__(self, variables: Mapping[str, Any]) -> Results:
        """Returns what the function returns.

        Args:
            variables: the task's variables by name; those that the list reads are read.

        Raises:
            CodeError: the list is not sound, or an operator fails on these values.
        """
        given = [self._pick(variables)] if self._takes_one else [*self._pick(variables)]
        num_envs = given[0].shape[0] if given else 0
        if num_envs != self._ready[0]:
            self._ready = (
                num_envs,
                *_prepared(self.program, dict(zip(self.program.variables, given, strict=True)), self._is_portable),
            )
        _, held, steps, take = self._ready
        slots = given + held
        try:
            for step in steps:
                step(slots)
        except Exception as error:  # whatever torch raises, the function has failed
            raise CodeError(*_failure(error)) from None
        return self._assembled(take(slots))

    @abstractmethod
    def _assembled(self, results: Any) -> Results:
        """Returns the list's results in the function's form."""


class RewardFunction(_Function[tuple[Tensor, dict[str, Tensor]]]):
    """A goal reward: the total, (num_envs,), and each component, (num_envs,), by name, all float32."""

    def _assembled(self, results: Any) -> tuple[Tensor, dict[str, Tensor]]:
        return results[0], dict(zip(self.program.names, results[1:], strict=True))


class MappingFunction(_Function[tuple[list[Tensor], list[bool], list[str]]]):
    """A mapping: the progress variables, (num_envs,) each and float32, their directions and their names."""

    def _assembled(self, results: Any) -> tuple[list[Tensor], list[bool], list[str]]:
        progress = list(results) if isinstance(results, tuple) else [results]
        return progress, list(self.program.rises), list(self.program.names)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the progress variables."""
        return self.program.names

    @property
    def rises(self) -> tuple[bool, ...]:
        """For each progress variable, whether the task needs it to rise."""
        return self.program.rises


def load_reward(text: str, portable: bool) -> RewardFunction:
    """Returns the goal reward of a list's text.

    Args:
        text: the list, from a candidate.
        portable: replace the operators whose bits depend on the CPU's vendor.

    Raises:
        CodeError: the text is no such list.
    """
    return RewardFunction(_of_kind("reward", text), portable)


def load_mapping(text: str, portable: bool) -> MappingFunction:
    """Returns the mapping of a list's text; arguments and errors as for `load_reward`."""
    return MappingFunction(_of_kind("mapping", text), portable)


def _of_kind(kind: str, text: str) -> Program:
    program = read_program(text)
    if program.kind != kind:
        raise CodeError("static", f"expected the operator list of a {kind}, found that of a {program.kind}")
    return program


def _failure(error: Exception) -> tuple[Any, str]:
    text = str(error)
    if isinstance(error, MemoryError) or "DefaultCPUAllocator" in text or "bad_alloc" in text:
        return "memory", "the function needs more memory than it may use"
    return "run", f"torch says: {text.splitlines()[0][:600] if text else type(error).__name__}"


def _prepared(
    program: Program, given: Mapping[str, Tensor], is_portable: bool
) -> tuple[list[Any], list[Run], Callable[[list[Any]], Any]]:
    """Returns what stands behind the variables in the slots, the steps, and what takes the results from the slots."""
    num_envs = next(iter(given.values())).shape[0] if given else 0
    device = next((value.device for value in given.values()), torch.device("cpu"))
    small = [shapes_of(program, given, count) for count in FEW]
    for shapes, count in zip(small, FEW, strict=True):
        check_results(program, shapes, count)
    check_sizes(small[0], small[1], num_envs)
    shapes = small[0]
    single = shapes.is_single
    if is_portable and single:
        program = with_norms(program)
        shapes = shapes_of(program, given, FEW[0])
    return _Builder(program, shapes, num_envs, device, is_portable, single).built()


class _Builder:
    """Makes closures of a list's steps, and gives registers slots: one that nobody reads any more is used again."""

    def __init__(
        self, program: Program, shapes: Shapes, num_envs: int, device: torch.device, is_portable: bool, single: bool
    ) -> None:
        self._program, self._shapes, self._num_envs, self._device = program, shapes, num_envs, device
        self._is_portable, self._single = is_portable, single
        self._slots = list(range(program.first_made))
        self._free: list[int] = []
        self._held: list[Any] = [torch.tensor(c.values, dtype=c.dtype, device=device) for c in program.constants]
        self._first = len(program.variables)
        self._numbers: dict[float, int] = {}
        self._last = {index: number for number, step in enumerate(program.steps) for index in reads(step)}
        self._last |= dict.fromkeys(program.results, len(program.steps))

    def built(self) -> tuple[list[Any], list[Run], Callable[[list[Any]], Any]]:
        """Returns constants and empty slots, the steps, and what takes the results."""
        steps = []
        # Numbers come first, so that their slots are known before those of the steps.
        operators = [operator(step.operator) for step in self._program.steps]
        given = [self._given(step, op) for step, op in zip(self._program.steps, operators, strict=True)]
        self._next = self._first + len(self._held)
        made = self._program.first_made
        for number, (step, op) in enumerate(zip(self._program.steps, operators, strict=True)):
            steps.append(self._closed(number, step, op, given[number], made))
            made += step.makes
        empty = [None] * (self._next - self._first - len(self._held))
        return [*self._held, *empty], steps, itemgetter(*(self._slots[index] for index in self._program.results))

    def _given(self, step: Step, op: Operator) -> list[Any]:
        """Returns a step's arguments, numbers that meet a float32 tensor as registers below 0: places among the held."""
        values = [at(value, self._num_envs) for value in step.arguments]
        if op.base not in _HELD or len(values) != 2 or step.keywords or not isinstance(values[0], Register):
            return values
        number, tensor = values[1], self._shapes.values[values[0].index]
        if type(number) not in (int, float) or tensor.dtype is not torch.float32 or tensor.dim() == 0:
            return values
        key = float(number)
        if key not in self._numbers or key == 0.0:
            self._numbers[key] = len(self._held)
            self._held.append(
                torch.tensor(key, dtype=torch.float32, device=self._device if self._device.type != "cuda" else "cpu")
            )
        return [values[0], Register(-1 - self._numbers[key])]

    def _closed(self, number: int, step: Step, op: Operator, given: list[Any], made: int) -> Run:
        """Returns one step as a closure, after giving what it makes slots."""
        keywords = {name: self._placed(at(value, self._num_envs)) for name, value in step.keywords}
        if op.makes:
            keywords["device"] = self._device
        call = portable(op.name, step.arguments, self._single) if self._is_portable else None
        if call is None:
            call = self._call(number, step, op, given, keywords, made)
        places = [self._placed(value) for value in given]
        kept = set(self._program.results)
        ended = {i for i in reads(step) if i >= self._program.first_made and self._last[i] == number and i not in kept}
        # What a step writes over, or returns again, keeps its slot while what shares its memory is read.
        out = []
        for index in range(made, made + step.makes):
            slot = self._free.pop() if self._free else self._next
            self._next += slot == self._next
            out.append(slot)
            self._slots.append(slot)
            if index not in self._last:
                self._free.append(slot)
        self._free += [self._slots[index] for index in sorted(ended)]
        if op.returns != 1 or keywords:
            return _any_closure(call, places, keywords, out)
        return _closure(call, places, out[0])

    def _placed(self, value: Any) -> Any:
        """Returns an argument with slots for registers."""
        if isinstance(value, Register):
            index = value.index
            return Register(self._slots[index] if index >= 0 else self._first - 1 - index)
        return [self._placed(part) for part in value] if isinstance(value, list) else value

    def _call(
        self, number: int, step: Step, op: Operator, given: list[Any], keywords: dict[str, Any], made: int
    ) -> Callable[..., Any]:
        """Returns what computes a step: torch's public function where it leads to the same operator, which is quicker."""
        arguments = [self._example(value) for value in given]
        writing = self._over(number, step, op, made)
        name = f"{op.name.partition('.')[0]}{'_' if writing else ''}"
        public = getattr(torch, name, None) or getattr(torch.Tensor, name, None)
        if name.startswith("linalg_"):
            public = getattr(torch.linalg, name.removeprefix("linalg_"), None)
        wanted = name if writing else op.name
        if public is not None and not op.makes and not any(isinstance(v, list) for v in keywords.values()):
            seen = _Seen()
            try:
                with torch.inference_mode(), seen:
                    public(*arguments, **{k: self._example(v) for k, v in keywords.items()})
            except Exception:
                pass
            if len(seen.names) == 1 and _is_same(seen.names[0], wanted, given):
                return public
        return op.call

    def _example(self, value: Any) -> Any:
        """Returns an argument with the small run's tensors for registers."""
        if isinstance(value, Register):
            if value.index < 0:
                return self._held[-1 - value.index]
            return self._shapes.values[value.index].clone()
        return [self._example(part) for part in value] if isinstance(value, list) else value

    def _over(self, number: int, step: Step, op: Operator, made: int) -> bool:
        """Whether a step may write over its first argument, which nobody else reads any more."""
        if op.base not in _IN_PLACE or op.writes or step.makes != 1 or not isinstance(step.arguments[0], Register):
            return False
        index = step.arguments[0].index
        own, other = self._shapes.values[index], self._shapes.values[made]
        if own.dtype != other.dtype or own.shape != other.shape or not own.is_contiguous():
            return False
        related = [i for i, shared in enumerate(self._shapes.shared) if self._shapes.shared[index] & shared]
        if related != [index] or index < self._program.first_made or self._last[index] != number:
            return False
        return sum(i == index for i in reads(step)) == 1


class _Seen(Watch):
    """Notes which operators a call leads to."""

    def __init__(self) -> None:
        super().__init__()
        self.names: list[str] = []

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        self.names.append(func.__name__)
        return func(*args, **(kwargs or {}))


def _is_same(found: str, wanted: str, given: Sequence[Any]) -> bool:
    """Whether an operator is the wanted one, or the same on tensors for one that takes a number held as a tensor."""
    if found == wanted:
        return True
    held = any(isinstance(value, Register) and value.index < 0 for value in given)
    return (
        ("." not in wanted or held)
        and base_of(found) == base_of(wanted)
        and found.partition(".")[0] == wanted.partition(".")[0]
    )


def _closure(call: Callable[..., Any], places: Sequence[Any], to: int) -> Run:
    """Returns a closure that calls an operator on slots and fills one slot."""
    first, rest = (places[0], places[1:]) if places else (None, [])
    if isinstance(first, Register) and not any(map(_holds_slots, rest)):
        a = first.index
        if rest:

            def one_and_more(slots: list[Any]) -> None:
                slots[to] = call(slots[a], *rest)

            return one_and_more

        def one(slots: list[Any]) -> None:
            slots[to] = call(slots[a])

        return one
    if len(places) == 2 and all(isinstance(value, Register) for value in places):
        a, b = places[0].index, places[1].index

        def two(slots: list[Any]) -> None:
            slots[to] = call(slots[a], slots[b])

        return two
    return _any_closure(call, places, {}, [to])


def _any_closure(
    call: Callable[..., Any], places: Sequence[Any], keywords: Mapping[str, Any], out: Sequence[int]
) -> Run:
    """The same for any arguments and any number of results."""

    def run(slots: list[Any]) -> None:
        made = call(*[_filled(value, slots) for value in places], **{k: _filled(v, slots) for k, v in keywords.items()})
        for slot, part in zip(out, [made] if isinstance(made, Tensor) else made, strict=True):
            slots[slot] = part

    return run


def _filled(value: Any, slots: Sequence[Any]) -> Any:
    if isinstance(value, Register):
        return slots[value.index]
    return [_filled(part, slots) for part in value] if isinstance(value, list) else value


def _holds_slots(value: Any) -> bool:
    return isinstance(value, Register) or (isinstance(value, list) and any(map(_holds_slots, value)))
