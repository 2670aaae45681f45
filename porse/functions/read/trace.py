"""A function run as Python, and what it asked of torch written down: the operator list. In a confined process only.

The function runs on real states of three numbers of environments, which share no divisor. Whole numbers that differ between
the runs must be multiples of that number plus a constant; all else must be the same, so that the list holds for any number.
"""

import functools
import re
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import CodeType
from typing import Any

import torch
from torch import Tensor

from porse.functions.read.runnable import FILE, compiled, main_function
from porse.functions.read.source import Source
from porse.functions.read.tidy import tidied
from porse.functions.run.operators import Watch, decides_by_data, operator
from porse.functions.run.program import MAX_CONSTANTS, MAX_STEPS, TYPES, Constant, Program, Register, Rows, Share, Step
from porse.functions.run.shapes import BY_MASK, check_call
from porse.functions.verdict import MAX_COMPONENTS, MAX_NAMES, Check, CodeError, Kind, plain_name

_LEFT_OUT = frozenset(("device", "pin_memory", "layout", "non_blocking", "copy"))
"""Keywords that a list does not keep: it runs on the device of the variables, and all its tensors are dense."""
_SAME = frozenset(("lift_fresh", "detach", "detach_", "alias"))
"""Operators that return what they are given."""
_TO_MODULES = ("to.dtype_layout", "to.device")
_MANY = 4099
"""Environments of the third run: more than trainings have, so that a branch on their number shows."""
_GROWS = (
    "what the function computes depends on the number of environments in a way that is not allowed (a loop over"
    " environments, a branch on num_envs, a size that is no multiple of it); use tensor operations over all environments"
)


@dataclass
class _Run:
    """What one run left: steps with registers by kind, and the results."""

    variables: list[str] = field(default_factory=list)
    constants: list[tuple[str, Any]] = field(default_factory=list)
    steps: list[tuple[str, Any, Any, int]] = field(default_factory=list)
    results: list[Any] = field(default_factory=list)
    names: tuple[str, ...] = ()
    rises: tuple[bool, ...] = ()
    made: int = 0


@dataclass(frozen=True)
class _At:
    """A register of a run: of a variable ("v"), a constant ("c") or a step ("s")."""

    kind: str
    number: int


class _Recorder(Watch):
    """Writes down every operator that is called, and refuses those that a list cannot hold."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        super().__init__()
        self.run = _Run()
        self._kept: list[Tensor] = []
        self._places: dict[int, _At] = {}
        self._fixed: dict[int, str] = {}
        self._inputs = {id(v): name for name, v in values.items() if isinstance(v, Tensor)}
        for name, value in values.items():
            if isinstance(value, Tensor):
                self._fixed[_memory(value)] = f"its input {name}"

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Runs one operator and writes it down."""
        name, given = func.__name__, list(args)
        base = name.partition(".")[0]
        if base == "cross" and len(given) < 3:
            given = [*given, -1]  # torch would take the first dimension of size 3, the wrong one for three environments
        if func.namespace != "aten":
            raise CodeError("static", f"the operator {func} is not on the list of allowed operators")
        if decides_by_data(name):
            raise CodeError("static", _reason(base))
        if base in _SAME:
            return self._same(base, func(*given), given[0])
        op = operator(name)
        check_call(op, given)
        if op.writes:
            self._check_written(given[0])
        if len(self.run.steps) >= MAX_STEPS:
            raise CodeError(
                "static", f"the function takes more than {MAX_STEPS} operators; use tensor operations, not loops"
            )
        made = func(*given, **(kwargs or {}))
        if not op.writes and any(made is value for value in given):
            return made
        parts = [made] if isinstance(made, Tensor) else list(made)
        keywords = {k: self._noted(v) for k, v in (kwargs or {}).items() if k not in _LEFT_OUT and v is not None}
        if name in _TO_MODULES:
            name, given = ("to.dtype", [given[0], keywords.pop("dtype", parts[0].dtype)])
        step = (name, tuple(self._noted(v) for v in given), tuple(sorted(keywords.items())), len(parts))
        self.run.steps.append(step)
        for part in parts:
            if op.writes or id(part) not in self._places:  # a list of results may hold what was given
                self._put(part, _At("s", self.run.made))
            self.run.made += 1
        return made

    def close_module(self) -> None:
        """Says that what was made so far are the constants beside the functions, which nothing may change."""
        self._fixed |= {_memory(value): "a constant beside the function" for value in self._kept}

    def place(self, value: Tensor) -> _At:
        """Returns the register of a tensor."""
        found = self._places.get(id(value))
        if found is None:
            name = self._inputs.get(id(value))
            if name is not None:
                found = _At("v", len(self.run.variables))
                self.run.variables.append(name)
            else:
                found = self._constant(value)
            self._put(value, found)
        return found

    def _constant(self, value: Tensor) -> _At:
        """Notes a tensor that Python made of numbers; a copy of it is what the function has, and may change."""
        if value.numel() > MAX_CONSTANTS or value.dtype not in TYPES.values():
            raise CodeError(
                "static", f"a tensor of more than {MAX_CONSTANTS} written numbers, or of complex ones, is not allowed"
            )
        dtype = next(name for name, dtype in TYPES.items() if dtype is value.dtype)
        self.run.constants.append((dtype, _tuples(value.tolist())))
        self.run.steps.append(("clone.default", (_At("c", len(self.run.constants) - 1),), (), 1))
        self.run.made += 1
        return _At("s", self.run.made - 1)

    def _put(self, value: Tensor, place: _At) -> None:
        self._kept.append(value)  # so that nothing else gets its id
        self._places[id(value)] = place

    def _same(self, base: str, made: Any, given: Tensor) -> Any:
        self._put(made, self.place(given))
        return made

    def _noted(self, value: Any) -> Any:
        """Returns an argument with registers for tensors."""
        if isinstance(value, Tensor):
            return self.place(value)
        if isinstance(value, list | tuple):
            return tuple(self._noted(part) for part in value)
        if isinstance(value, torch.memory_format):
            return None
        if isinstance(value, torch.device | torch.layout):
            return None
        if isinstance(value, torch.dtype) and value not in TYPES.values():
            raise CodeError("static", f"the type {value} is not allowed; use float32")
        return value

    def _check_written(self, target: Tensor) -> None:
        what = self._fixed.get(_memory(target)) if target.untyped_storage().nbytes() else None
        if what is not None and what.startswith("its input "):
            name = what.removeprefix("its input ")
            message = f"the function may change its input {name} in place; work on {name}.clone()"
            raise CodeError("inplace", message)
        if what is not None:
            raise CodeError(
                "inplace", f"the function changes {what}, which is 1 call's state in the next; work on a clone of it"
            )


def _memory(value: Tensor) -> int:
    return value.untyped_storage().data_ptr()


def _tuples(values: Any) -> Any:
    return tuple(map(_tuples, values)) if isinstance(values, list) else values


def _reason(base: str) -> str:
    if base == "is_nonzero":
        return (
            "a branch on the values of a tensor (if, and, or, not, max, min) is not allowed, since each environment has its"
            " own; use torch.where, torch.maximum, torch.minimum or torch.logical_and"
        )
    if base in ("item", "_local_scalar_dense"):
        return (
            "a number is taken out of a tensor (.item(), float, int, round, math, an f-string or a tensor of tensors),"
            " which is not allowed; keep tensors, with functions of torch, and torch.stack for tensors of them"
        )
    return (
        BY_MASK
        if base.startswith("masked")
        else f"{base} makes a size from the values of a tensor, which is not allowed; use torch.where"
    )


def trace(source: Source, kind: Kind, values: Mapping[str, Any]) -> Program:
    """Returns the operator list of a checked source.

    Args:
        source: the source.
        kind: what it should be.
        values: the variables in real states; tensors have a row for each environment.

    Raises:
        CodeError: it fails, returns something else, or cannot be written down; with the line of the source.
    """
    line = source.last_line
    code = compiled(source)
    rows = values["num_envs"]
    counts = (rows, rows - 1, _MANY)
    runs = []
    for count in counts:
        given = _first(values, count, rows)
        runs.append(_traced(functools.partial(_run, source, code, kind, given, is_first=count == rows), line))
        if not runs[0].variables:
            raise CodeError("constant", "the function reads no state of the task, so its output never changes", line)
    try:
        return tidied(_unified(kind, runs, counts))
    except CodeError as error:
        raise CodeError(error.check, str(error), error.line or line) from None


def _first(values: Mapping[str, Any], count: int, rows: int) -> dict[str, Any]:
    """Returns the variables of so many environments, the real states again and again."""
    index = torch.arange(count) % rows
    return {n: v[index] if isinstance(v, Tensor) else v for n, v in values.items()} | {"num_envs": count}


def _run(source: Source, code: CodeType, kind: Kind, values: Mapping[str, Any], is_first: bool) -> _Run:
    """Runs a source once, from its constants to the results in their plain form; the first time twice: nothing is kept."""
    with torch.inference_mode(), (recorder := _Recorder(values)):
        main = main_function(source, code, values)
        recorder.close_module()
        before = len(recorder.run.steps), recorder.run.made, len(recorder.run.constants)
        finish = _reward if kind == "reward" else _mapping
        finish(main(), values["num_envs"], recorder)
        if not is_first:
            return recorder.run
        first = _Run(**vars(recorder.run))
        own = recorder.run.steps[before[0] :]
        recorder.run = _Run(first.variables, first.constants[: before[2]], first.steps[: before[0]], made=before[1])
        finish(main(), values["num_envs"], recorder)
        if not _alike(own, recorder.run.steps[before[0] :]) or (first.names, first.rises) != (
            recorder.run.names,
            recorder.run.rises,
        ):
            raise CodeError("static", "the function keeps something from one call to the next, which is not allowed")
    return first


def _alike(first: Sequence[Any], second: Sequence[Any]) -> bool:
    """Whether two calls asked the same of torch; repr tells 1 from 1.0 and one NaN from none."""
    return repr(first) == repr(second)


def _traced(run: Callable[[], _Run], line: int) -> _Run:
    """Returns a run, or its failure as one of ours, at the line of the source where it came up."""
    try:
        return run()
    except CodeError as error:
        raise CodeError(error.check, str(error), error.line or _line_of(error) or line) from None
    except RecursionError:
        raise CodeError("static", "the function calls itself without an end", line) from None
    except Exception as error:  # whatever Python raises, the function has failed
        text = re.sub(r"\s+", " ", str(error))[:600]
        if isinstance(error, MemoryError) or "DefaultCPUAllocator" in text or "bad_alloc" in text:
            raise CodeError("memory", "the function needs more memory than it may use", _line_of(error)) from None
        check: Check = "type" if isinstance(error, TypeError | AttributeError) else "run"
        raise CodeError(check, f"Python says: {text}", _line_of(error) or line) from None


def _line_of(error: BaseException) -> int:
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == FILE]
    return lines[-1] or 0 if lines else 0


def _reward(returned: Any, num_envs: int, recorder: _Recorder) -> None:
    """Has the results of a reward written down in their plain form."""
    if not isinstance(returned, tuple | list) or len(returned) != 2 or not isinstance(returned[1], dict):
        found = f"expected two results, the total reward and a dictionary of components, found {_kind(returned)}"
        raise CodeError("return", found)
    total, components = returned
    _check_tensor(total, "total reward")
    for name in components:
        if not isinstance(name, str):
            raise CodeError("return", f"expected component names to be text, found {_kind(name)}")
    values = {name: _as_tensor(value) for name, value in components.items()}
    for name, value in values.items():
        _check_tensor(value, "component", name)
    names = tuple(map(plain_name, values))
    if len(set(names)) != len(names) or not 0 < len(names) <= MAX_COMPONENTS:
        found = f"expected 1 to {MAX_COMPONENTS} components with distinct names, found {', '.join(values)}"
        raise CodeError("names", found[:2000])
    vectors = [_vector(v.expand(num_envs) if v.dim() == 0 else v, num_envs, "component", n) for n, v in values.items()]
    results = [_vector(total, num_envs, "total reward"), *vectors]
    recorder.run.results, recorder.run.names = [recorder.place(value) for value in results], names


def _mapping(returned: Any, num_envs: int, recorder: _Recorder) -> None:
    """Has the results of a mapping written down in their plain form."""
    if not isinstance(returned, tuple | list) or len(returned) != 3:
        found = f"expected three lists, progress variables, directions and names, found {_kind(returned)}"
        raise CodeError("return", found)
    values, flags, names = (list(part) if isinstance(part, list | tuple) else [part] for part in returned)
    if not len(values) == len(flags) == len(names) or not 0 < len(values) <= MAX_NAMES:
        found = (
            f"expected three lists of one length, 1 to {MAX_NAMES}, found {len(values)} progress variables,"
            f" {len(flags)} directions and {len(names)} names"
        )
        raise CodeError("return", found)
    if not all(isinstance(flag, bool) for flag in flags) or not all(isinstance(name, str) for name in names):
        raise CodeError("return", "expected directions to be True or False and names to be text")
    for name, value in zip(names, values, strict=True):
        _check_tensor(value, "progress variable", name)
    plain = tuple(map(plain_name, names))
    if len(set(plain)) != len(plain):
        raise CodeError("names", f"expected distinct names of progress variables, found {', '.join(plain)}")
    results = [_vector(value, num_envs, "progress variable", n) for n, value in zip(plain, values, strict=True)]
    recorder.run.results = [recorder.place(value) for value in results]
    recorder.run.names, recorder.run.rises = plain, tuple(flags)


def _as_tensor(value: Any) -> Any:
    """A component may be one number, which stands for every environment."""
    return torch.tensor(float(value)) if isinstance(value, int | float) else value


def _check_tensor(value: Any, *what: str) -> None:
    if not isinstance(value, Tensor):
        raise CodeError("return", f"expected the {' '.join(what)} to be a tensor, found {_kind(value)}")


def _vector(value: Tensor, num_envs: int, *what: str) -> Tensor:
    if value.dim() != 1 or value.shape[0] != num_envs:
        parts = ["num_envs" if n == num_envs else str(n) for n in value.shape]
        shape = f"({', '.join(parts)}{',' if len(parts) == 1 else ''})"
        found = f"expected the {' '.join(what)} of shape (num_envs,), found {shape} for num_envs = {num_envs}"
        raise CodeError("shape", f"{found}; reduce the other dimensions, and take sizes from the inputs")
    return value.to(torch.float32)


def _kind(value: Any) -> str:
    if isinstance(value, tuple | list):
        return f"{len(value)} values ({', '.join(_kind(part) for part in value[:5])})"
    return {"Tensor": "one tensor"}.get(type(value).__name__, type(value).__name__)


def _unified(kind: Kind, runs: Sequence[_Run], counts: Sequence[int]) -> Program:
    """Returns the one list that all runs are instances of."""
    first = runs[0]
    shape = [(s[0], s[3]) for s in first.steps], first.names, first.rises, first.variables, first.results
    if any(([(s[0], s[3]) for s in r.steps], r.names, r.rises, r.variables, r.results) != shape for r in runs):
        raise CodeError("static", _GROWS)
    starts = {"v": 0, "c": len(first.variables), "s": len(first.variables) + len(first.constants)}

    def one(found: Sequence[Any]) -> Any:
        if isinstance(found[0], _At):
            if any(value != found[0] for value in found):
                raise CodeError("static", _GROWS)
            return Register(starts[found[0].kind] + found[0].number)
        if isinstance(found[0], tuple):
            if any(not isinstance(value, tuple) or len(value) != len(found[0]) for value in found):
                raise CodeError("static", _GROWS)
            return tuple(one(parts) for parts in zip(*found, strict=True))
        return _number(found, counts)

    constants = tuple(
        Constant(TYPES[pair[0][0]], one([values for _, values in pair]))
        for pair in zip(*(run.constants for run in runs), strict=True)
    )
    if any(isinstance(number, Rows | Share) for constant in constants for number in _flat(constant.values)):
        raise CodeError("static", _GROWS)
    steps = []
    for same in zip(*(run.steps for run in runs), strict=True):
        keywords = [dict(step[2]) for step in same]
        given = tuple((name, one([k[name] for k in keywords])) for name in keywords[0])
        steps.append(Step(same[0][0], one([step[1] for step in same]), given, same[0][3]))
    results = tuple(starts[place.kind] + place.number for place in first.results)
    return Program(kind, tuple(first.variables), constants, tuple(steps), results, first.names, first.rises)


def _flat(values: Any) -> Iterator[Any]:
    if isinstance(values, tuple):
        for value in values:
            yield from _flat(value)
    else:
        yield values


def _number(found: Sequence[Any], counts: Sequence[int]) -> Any:
    """Returns what is the same in all runs, or grows or shrinks with the number of environments.

    Raises:
        CodeError: it does neither; check "static".
    """
    if all(repr(value) == repr(found[0]) for value in found):
        return found[0]
    if all(type(value) is int for value in found):
        times, rest = divmod(found[2] - found[0], counts[2] - counts[0])
        rows = Rows(times, found[0] - times * counts[0])
        if not rest and all(rows.at(count) == value for count, value in zip(counts, found, strict=True)):
            return rows
    if all(type(value) is float for value in found):
        for of in (found[0] * counts[0], float(round(found[0] * counts[0]))):
            if all(Share(of).at(count) == value for count, value in zip(counts, found, strict=True)):
                return Share(of)
    raise CodeError("static", _GROWS)
