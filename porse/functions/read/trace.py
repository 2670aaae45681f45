"""A function run as Python, and what it asked of torch written down: the operator list. In a confined process only.

The function runs on real states of three numbers of environments, which share no divisor. Whole numbers that differ between
the runs must be multiples of that number plus a constant; all else must be the same, so that the list holds for any number.
"""

import re
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from porse.errors import without_places
from porse.functions.read.extract import Source
from porse.functions.read.runnable import FILE, RootColumns, compiled, main_function
from porse.functions.read.states import of_environments
from porse.functions.run.operators import Watch, decides_by_data, operator
from porse.functions.run.program import MAX_NUMBERS, MAX_STEPS, TYPES, Program, Register, Step, grown, mapped, registers
from porse.functions.run.shapes import BY_MASK, TOO_MUCH, check_call, is_too_much
from porse.functions.verdict import MAX_COMPONENTS, MAX_NAMES, Check, CodeError, Kind, plain_name

_LEFT_OUT = frozenset(("device", "pin_memory", "layout", "non_blocking", "copy"))
"""Keywords that a list does not keep: it runs on the device of the variables, and all its tensors are dense."""
_SAME = frozenset(("lift_fresh", "detach", "detach_", "alias"))
"""Operators that return what they are given."""
_TO_MODULES = ("to.dtype_layout", "to.device")
_KIND = 2**32
"""More registers than a call has of one kind, by which those of another are numbered."""
_MANY = 4099
"""Environments of the third run: more than trainings have, so that a branch on their number shows."""
_GROWS = (
    "what the function computes depends on the number of environments in a way that is not allowed (a loop over"
    " environments, a branch on num_envs, a size that is no multiple of it); use tensor operations over all environments"
)
_BRANCHES = (
    "a branch on the values of a tensor (if, and, or, not, max, min) is not allowed, since each environment has its"
    " own; use torch.where, torch.maximum, torch.minimum or torch.logical_and"
)
_TAKES_OUT = (
    "a number is taken out of a tensor (.item(), float, int, round, math, an f-string or a tensor of tensors),"
    " which is not allowed; keep tensors, with functions of torch, and torch.stack for tensors of them"
)
_REASONS = {"is_nonzero": _BRANCHES, "item": _TAKES_OUT, "_local_scalar_dense": _TAKES_OUT}
"""Why operators are refused whose results' shapes, or Python's own course, follow from the numbers in a tensor."""

_WANTED: dict[Kind, str] = {
    "reward": "two results, the total reward and a dictionary of components",
    "mapping": "three lists, progress variables, directions and names",
}


@dataclass
class _Call:
    """What the constants and one call of a function asked of torch, and its results.

    Registers of variables count from 0, those of constants from `_KIND` and those of steps from twice that.
    """

    variables: list[str]
    constants: list[tuple[torch.dtype, Any]]
    steps: list[Step]
    made: int = 0
    results: tuple[int, ...] = ()
    names: tuple[str, ...] = ()
    rises: tuple[bool, ...] = ()


class _Recorder(Watch):
    """Writes down every operator that is called, and refuses those that a list cannot hold."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        super().__init__()
        self.call = self._constants = _Call([], [], [])
        self._kept: list[Tensor] = []
        self._places: dict[int, int] = {}
        inputs = {name: value for name, value in values.items() if isinstance(value, Tensor)}
        self._inputs = {id(value): name for name, value in inputs.items()}
        changed = "the function may change its input {0} in place; work on {0}.clone()"
        self._fixed = {_memory(value): changed.format(name) for name, value in inputs.items()}

    def begin_call(self) -> _Call:
        """Starts a call with what the constants beside the function asked for, which nothing may change."""
        made = self._constants
        why = "a constant beside the function is changed, which is one call's state in the next; work on a clone of it"
        self._fixed = {_memory(value): why for value in self._kept} | self._fixed
        self.call = _Call(made.variables, [*made.constants], [*made.steps], made.made)
        return self.call

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Runs one operator and writes it down."""
        name, given, named = func.__name__, list(args), kwargs or {}
        base = name.partition(".")[0]
        if base == "cross" and len(given) < 3:
            given = [*given, -1]  # torch would take the first dimension of size 3, the wrong one for three environments
        if func.namespace != "aten":
            raise CodeError("static", f"the operator {func} is not on the list of allowed operators")
        if decides_by_data(name):
            by_size = f"{base} makes a size from the values of a tensor, which is not allowed; use torch.where"
            raise CodeError("static", BY_MASK if base.startswith("masked") else _REASONS.get(base, by_size))
        if base in _SAME:
            made = func(*given)
            self._put(made, self.place(given[0]))
            return made
        op = operator(name)
        check_call(op, given)
        if op.writes and given[0].untyped_storage().nbytes() and (why := self._fixed.get(_memory(given[0]))):
            raise CodeError("inplace", why)
        if len(self.call.steps) >= MAX_STEPS:
            found = f"the function takes more than {MAX_STEPS} operators; use tensor operations, not loops"
            raise CodeError("static", found)
        made = func(*given, **named)
        if not op.writes and any(made is value for value in given):
            return made
        parts = [made] if isinstance(made, Tensor) else list(made)
        keywords = {k: mapped(v, self._noted) for k, v in named.items() if k not in _LEFT_OUT and v is not None}
        if name in _TO_MODULES:
            name, given = "to.dtype", [given[0], keywords.pop("dtype", parts[0].dtype)]
        arguments = mapped(given, self._noted)
        self.call.steps.append(Step(name, arguments, tuple(sorted(keywords.items())), len(parts)))
        for part in parts:
            if op.writes or id(part) not in self._places:  # a list of results may hold what was given
                self._put(part, 2 * _KIND + self.call.made)
            self.call.made += 1
        return made

    def place(self, value: Tensor) -> int:
        """Returns the register of a tensor, a new one for a variable that was not read yet and for what Python made."""
        call, found = self.call, self._places.get(id(value))
        if found is None and (name := self._inputs.get(id(value))) is not None:
            found = len(call.variables)
            call.variables.append(name)
        if found is None:
            # Python made it of numbers; a copy of it is what the function has, and may change.
            if value.numel() > MAX_NUMBERS or value.dtype not in TYPES.values():
                message = f"a tensor of more than {MAX_NUMBERS} written numbers, or of complex ones, is not allowed"
                raise CodeError("static", message)
            call.steps.append(Step("clone.default", (Register(_KIND + len(call.constants)),), ()))
            call.constants.append((value.dtype, value.tolist()))
            found = 2 * _KIND + call.made
            call.made += 1
        self._put(value, found)
        return found

    def _put(self, value: Tensor, place: int) -> None:
        self._kept.append(value)  # so that nothing else gets its id
        self._places[id(value)] = place

    def _noted(self, value: Any) -> Any:
        """Returns a part of an argument, the register of a tensor."""
        if isinstance(value, Tensor):
            return Register(self.place(value))
        if isinstance(value, torch.dtype) and value not in TYPES.values():
            raise CodeError("static", f"the type {value} is not allowed; use float32")
        return None if isinstance(value, torch.memory_format | torch.device | torch.layout) else value


def _memory(value: Tensor) -> int:
    return value.untyped_storage().data_ptr()


def trace(source: Source, kind: Kind, values: Mapping[str, Any]) -> Program:
    """Returns the operator list of a checked source.

    Args:
        source: the source.
        kind: what it should be.
        values: the variables in real states; tensors have a row for each environment.

    Raises:
        CodeError: it fails, returns something else, or cannot be written down; with the line of the source.
    """
    code = compiled(source)
    counts = (values["num_envs"], values["num_envs"] - 1, _MANY)
    calls: list[_Call] = []
    check: Check = "run"
    try:
        for count in counts:
            given = of_environments(values, count, calls[0].variables if calls else None)
            with torch.inference_mode(), (recorder := _Recorder(given)), RootColumns():
                main = main_function(source, code, given)
                for _ in range(1 if calls else 2):
                    call = recorder.begin_call()
                    _finish(kind, main(), count, recorder)
                    calls.append(call)
        if repr(calls[0]) != repr(calls.pop(1)):  # repr tells 1 from 1.0, and one NaN is like another
            raise CodeError("static", "the function keeps something from one call to the next, which is not allowed")
        return _program(kind, calls, counts)
    except CodeError as error:
        check, text, line = error.check, str(error), error.line or _line_of(error)
    except RecursionError:
        check, text, line = "static", "the function calls itself without an end", 0
    except Exception as error:  # whatever Python raises, the function has failed
        check, line = "type" if isinstance(error, TypeError | AttributeError) else "run", _line_of(error)
        text = f"Python says: {_said(error)}"[:613]
        if is_too_much(error):
            check, text = "memory", TOO_MUCH
    raise CodeError(check, text, line or source.last_line)


def _said(error: Exception) -> str:
    """Returns what an error says, on one line and in the same words in every process."""
    if any(not isinstance(part, str | int | float | None) for part in error.args):
        return f"{type(error).__name__} of {', '.join(map(_kind, error.args))}"
    return without_places(" ".join(str(error).split()))


def _line_of(error: BaseException) -> int:
    """Returns the line of the source where an error came up, 0 where it came up outside."""
    # Frames alone: to extract a traceback reads files, which a confined process cannot.
    walked = traceback.walk_tb(error.__traceback__)
    return [0, *(line for frame, line in walked if frame.f_code.co_filename == FILE)][-1]


def _finish(kind: Kind, returned: Any, num_envs: int, recorder: _Recorder) -> None:
    """Has the results written down in their plain form: float32 of shape (num_envs,), a reward's total first."""
    names, values, recorder.call.rises = _parts(kind, returned)
    most, what = (MAX_COMPONENTS, "component") if kind == "reward" else (MAX_NAMES, "progress variable")
    if not all(isinstance(name, str) for name in names):
        raise CodeError("return", f"expected the names of {what}s to be text, found {_kind(names)}")
    titles = [f"{what} {name}" for name in names] + ["total reward"] * (kind == "reward")
    for title, value in zip(titles, values, strict=True):
        if not isinstance(value, Tensor):
            raise CodeError("return", f"expected the {title} to be a tensor, found {_kind(value)}")
    plain = recorder.call.names = tuple(map(plain_name, names))
    if len(set(plain)) != len(plain) or not 0 < len(plain) <= most:
        found = f"expected 1 to {most} {what}s with distinct names, found {', '.join(names) or 'none'}"
        raise CodeError("names", found[:2000])
    vectors = []
    for title, value in zip(titles, values, strict=True):
        is_number = value.dim() == 0 and title.startswith("component")
        vector = value.expand(num_envs) if is_number else value
        if vector.shape != (num_envs,):
            shape = re.sub(rf"\b{num_envs}\b", "num_envs", str(tuple(value.shape)))
            found = f"expected the {title} of shape (num_envs,), found {shape} for num_envs = {num_envs}"
            raise CodeError("shape", f"{found}; reduce the other dimensions, and take sizes from the inputs")
        vectors.append(vector.to(torch.float32))
    recorder.call.results = tuple(map(recorder.place, vectors[len(names) :] + vectors[: len(names)]))


def _parts(kind: Kind, returned: Any) -> tuple[list[Any], list[Any], tuple[bool, ...]]:
    """Returns the names of components or progress variables, their values with a reward's total last, and directions."""
    match kind, returned:
        case "reward", [total, dict() as components]:
            # A component may be one number, which stands for every environment.
            values = [torch.tensor(float(v)) if isinstance(v, int | float) else v for v in components.values()]
            return list(components), [*values, total], ()
        case "mapping", [_, _, _]:
            values, flags, names = (list(part) if isinstance(part, list | tuple) else [part] for part in returned)
            if not len(values) == len(flags) == len(names):
                found = f"{len(values)} progress variables, {len(flags)} directions and {len(names)} names"
                raise CodeError("return", f"expected three lists of one length, found {found}")
            if not all(isinstance(flag, bool) for flag in flags):
                found = ", ".join(map(_kind, flags))
                raise CodeError("return", f"expected directions to be True or False, found {found}")
            return names, values, tuple(flags)
    raise CodeError("return", f"expected {_WANTED[kind]}, found {_kind(returned)}")


def _kind(value: Any) -> str:
    if isinstance(value, tuple | list):
        return f"{len(value)} values ({', '.join(_kind(part) for part in value[:5])})"
    return {"Tensor": "one tensor"}.get(type(value).__name__, type(value).__name__)


def _program(kind: Kind, calls: Sequence[_Call], counts: Sequence[int]) -> Program:
    """Returns the one list that all calls are instances of, with as few steps as are needed.

    Where nothing is written over, equal steps are equal, and copies of constants are the constants. What no result and no
    writing step hangs on is left out.
    """
    first = calls[0]
    forms = {repr(replace(call, steps=[replace(step, arguments=()) for step in call.steps])) for call in calls}
    if len(forms) > 1:
        raise CodeError("static", _GROWS)

    def one(found: Sequence[Any]) -> Any:
        if all(isinstance(value, tuple) and len(value) == len(found[0]) for value in found):
            return tuple(one(parts) for parts in zip(*found, strict=True))
        number = found[0] if all(repr(value) == repr(found[0]) for value in found) else grown(found, counts)
        if number is None and found[0] is not None:
            raise CodeError("static", _GROWS)
        return number

    writes = {step.operator for step in first.steps if operator(step.operator).writes}
    same: dict[int, int] = {}
    seen: dict[str, int] = {}
    steps: dict[int, Step] = {}
    start = 2 * _KIND
    for found in zip(*(call.steps for call in calls), strict=True):
        step = _moved(replace(found[0], arguments=one([step.arguments for step in found])), same)
        is_copy = step.operator == "clone.default" and step.arguments[0].index < 2 * _KIND
        equal = step.arguments[0].index if is_copy else seen.setdefault(repr(step), start)
        if writes or equal == start:
            steps[start] = step
        else:
            same |= {start + index: equal + index for index in range(step.makes)}
        start += step.makes
    results = [same.get(result, result) for result in first.results]
    live = set(results)
    for start, step in reversed([*steps.items()]):
        if step.operator not in writes and live.isdisjoint(range(start, start + step.makes)):
            del steps[start]
        else:
            live.update(registers(step.arguments))
    given = [index for index in sorted(live) if index < 2 * _KIND]
    made = [start + index for start, step in steps.items() for index in range(step.makes)]
    new = {old: place for place, old in enumerate([*given, *made])}
    constants = (torch.tensor(values, dtype=dtype) for dtype, values in first.constants)
    return Program(
        kind,
        tuple(name for index, name in enumerate(first.variables) if index in live),
        tuple(value for index, value in enumerate(constants, start=_KIND) if index in live),
        tuple(_moved(step, new) for step in steps.values()),
        tuple(new[result] for result in results),
        first.names,
        first.rises,
    )


def _moved(step: Step, to: Mapping[int, int]) -> Step:
    """Returns a step that reads other registers in place of some."""

    def changed(leaf: Any) -> Any:
        return Register(to.get(leaf.index, leaf.index)) if isinstance(leaf, Register) else leaf

    return replace(step, arguments=mapped(step.arguments, changed))
