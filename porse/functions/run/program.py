"""The operator list of one function, as data, and its one canonical JSON text.

A list has registers: first the task variables that it reads, then its constants, then what each step makes. A step names an
operator and its arguments: registers, numbers, texts, types, lists of them, and whole numbers that grow with the number of
environments. There are no branches and no loops. `shapes` says whether a list is sound; here its text and its size are.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, Literal, NoReturn

import torch

from porse.functions.verdict import MAX_COMPONENTS, MAX_NAMES, CodeError, Kind, plain_name, words
from porse.identity import canonical_json, content_id

MAX_TEXT = 1_000_000
"""Characters of a list."""
MAX_STEPS = 4_000
MAX_CONSTANTS = 20_000
"""Numbers in all constants together."""
MAX_WHOLE = 10_000_000
"""Largest whole number that is written in a list."""
MAX_DEPTH = 6
TYPES = {name: getattr(torch, name) for name in ("float32", "float64", "float16", "int64", "int32", "uint8", "bool")}
_NAMES_OF_TYPES = {dtype: name for name, dtype in TYPES.items()}
_SPECIAL = {"inf": math.inf, "-inf": -math.inf, "nan": math.nan}
_KEYWORDS = words("""
    alpha approximate correction descending dtype keepdim largest memory_format output_dtype reduction rounding_mode
    sorted stable unbiased value beta step ord dim indexing
    """)


@dataclass(frozen=True)
class Register:
    """The value that a variable, a constant or a step has put somewhere."""

    index: int


@dataclass(frozen=True)
class Rows:
    """A whole number that depends on the number of environments: `times * num_envs + plus`."""

    times: int
    plus: int

    def at(self, num_envs: int) -> int:
        """Returns the number for so many environments."""
        return self.times * num_envs + self.plus


@dataclass(frozen=True)
class Share:
    """A number that shrinks with the number of environments: `of / num_envs`."""

    of: float

    def at(self, num_envs: int) -> float:
        """Returns the number for so many environments."""
        return self.of / num_envs


@dataclass(frozen=True)
class Step:
    """One operator.

    Attributes:
        operator: its name and overload, `mul.Tensor`.
        arguments: what stands in its places.
        keywords: what is given by name, sorted.
        makes: how many registers it fills.
    """

    operator: str
    arguments: tuple[Any, ...]
    keywords: tuple[tuple[str, Any], ...]
    makes: int = 1


@dataclass(frozen=True)
class Constant:
    """A tensor of numbers that are written out."""

    dtype: torch.dtype
    values: Any


@dataclass(frozen=True)
class Program:
    """The operator list of one function.

    Attributes:
        kind: "reward" or "mapping".
        variables: the task variables that it reads, all tensors.
        constants: tensors that are written out.
        steps: the operators in order.
        results: for a reward the total and its components, for a mapping the progress variables; all `(num_envs,)`.
        names: of the components, or of the progress variables.
        rises: for a mapping, whether the task needs each to rise.
    """

    kind: Kind
    variables: tuple[str, ...]
    constants: tuple[Constant, ...]
    steps: tuple[Step, ...]
    results: tuple[int, ...]
    names: tuple[str, ...]
    rises: tuple[bool, ...]

    @property
    def first_made(self) -> int:
        """The register that the first step fills."""
        return len(self.variables) + len(self.constants)

    @property
    def starts(self) -> list[int]:
        """The register that each step fills, or the first of those that it does."""
        makes = [step.makes for step in self.steps]
        return [*accumulate(makes[:-1], initial=self.first_made)] if makes else []

    @property
    def text(self) -> str:
        """The canonical JSON text: equal lists have equal texts."""
        return canonical_json(
            {
                "kind": self.kind,
                "variables": self.variables,
                "constants": [[_NAMES_OF_TYPES[c.dtype], _written(c.values)] for c in self.constants],
                "steps": [
                    [s.operator, [_written(a) for a in s.arguments], {k: _written(v) for k, v in s.keywords}, s.makes]
                    for s in self.steps
                ],
                "results": self.results,
                "names": self.names,
                "rises": self.rises,
            }
        )

    @property
    def identity(self) -> str:
        """The hash of the content."""
        return content_id("program", self.text)


def leaves(value: Any) -> Iterator[Any]:
    """Yields what stands in an argument, or in the numbers of a constant, however deep in lists."""
    if isinstance(value, tuple | list):
        for part in value:
            yield from leaves(part)
    else:
        yield value


def registers(value: Any) -> Iterator[int]:
    """Yields the registers in an argument."""
    return (leaf.index for leaf in leaves(value) if isinstance(leaf, Register))


def reads(step: Step) -> Iterator[int]:
    """Yields the registers that a step reads, with repetitions."""
    return registers(step.arguments)


def replaced(value: Any, registers: Mapping[int, int]) -> Any:
    """Returns an argument with other registers in place of some."""
    if isinstance(value, Register):
        return Register(registers.get(value.index, value.index))
    return tuple(replaced(part, registers) for part in value) if isinstance(value, tuple) else value


def at(value: Any, num_envs: int) -> Any:
    """Returns an argument for so many environments; registers stay, and lists are lists."""
    if isinstance(value, Rows | Share):
        return value.at(num_envs)
    return [at(part, num_envs) for part in value] if isinstance(value, tuple | list) else value


def filled(value: Any, values: Sequence[Any]) -> Any:
    """Returns an argument, its lists as lists, with what registers hold in place of them."""
    if isinstance(value, tuple | list):
        return [filled(part, values) for part in value]
    return values[value.index] if isinstance(value, Register) else value


def _written(value: Any) -> Any:
    """Returns an argument as JSON."""
    if isinstance(value, tuple | list):
        return [_written(part) for part in value]
    if isinstance(value, Register):
        return {"r": value.index}
    if isinstance(value, Rows):
        return {"n": [value.times, value.plus]}
    if isinstance(value, Share):
        return {"share": value.of}
    if isinstance(value, torch.dtype):
        return {"t": _NAMES_OF_TYPES[value]}
    if isinstance(value, float) and not math.isfinite(value):
        return {"f": str(value)}
    return value


def read_program(text: str) -> Program:
    """Returns the list that a text holds. `shapes.check` says whether it may run.

    Raises:
        CodeError: the text is no canonical list, or too large; check "static".
    """
    if len(text) > MAX_TEXT:
        _refuse(f"at most {MAX_TEXT} characters", f"{len(text)}")
    try:
        held = json.loads(text)
        program = _program(held)
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, RecursionError) as error:
        _refuse("JSON of its own form", f"{type(error).__name__}: {error}")
    if program.text != text:
        _refuse("its canonical text", "another spelling of it")
    return program


def _refuse(expected: str, found: str) -> NoReturn:
    message = f"expected an operator list as {expected}, found {found[:300]}; validate the function again"
    raise CodeError("static", message)


def _program(held: Any) -> Program:
    constants = tuple(Constant(TYPES[dtype], _numbers(values, 0)) for dtype, values in held["constants"])
    if sum(_count(constant.values) for constant in constants) > MAX_CONSTANTS:
        _refuse(f"at most {MAX_CONSTANTS} numbers in its constants", "more")
    if len(held["steps"]) > MAX_STEPS:
        _refuse(f"at most {MAX_STEPS} steps", str(len(held["steps"])))
    steps = tuple(_step(*step) for step in held["steps"])
    names, rises = tuple(held["names"]), tuple(held["rises"])
    kind: Literal["reward", "mapping"] = "reward" if held["kind"] == "reward" else "mapping"
    if held["kind"] not in ("reward", "mapping"):
        _refuse("a reward or a mapping", repr(held["kind"]))
    program = Program(
        kind, tuple(map(_word, held["variables"])), constants, steps, tuple(map(_index, held["results"])), names, rises
    )
    made = program.first_made
    for step in steps:
        if any(not index < made for index in reads(step)):
            _refuse("steps that read what is there", f"{step.operator}, which reads what is not there yet")
        made += step.makes
    most = MAX_COMPONENTS if kind == "reward" else MAX_NAMES
    is_paired = len(program.results) == len(names) + (kind == "reward")
    is_paired = is_paired and len(rises) == (len(names) if kind == "mapping" else 0)
    if not is_paired or not 0 < len(names) <= most or len(set(names)) != len(names):
        _refuse(f"1 to {most} results with distinct names", ", ".join(map(str, names)))
    if any(not isinstance(n, str) or plain_name(n) != n for n in names) or not all(isinstance(r, bool) for r in rises):
        _refuse("plain names and directions", f"{names} and {rises}")
    if any(index >= made for index in program.results) or len(set(program.variables)) != len(program.variables):
        _refuse("results that are there, and each variable once", f"{program.results} of {made}, {program.variables}")
    return program


def _step(operator: Any, arguments: Any, keywords: Any, makes: Any) -> Step:
    if not set(keywords) <= _KEYWORDS or not 0 < _index(makes) <= 1000:
        _refuse("known keywords", f"{sorted(keywords)} in {operator}")
    given = tuple((name, _argument(value, 0)) for name, value in sorted(keywords.items()))
    return Step(_word(operator), tuple(_argument(value, 0) for value in arguments), given, makes)


def _argument(held: Any, depth: int) -> Any:
    """Returns the argument that JSON holds."""
    if depth > MAX_DEPTH:
        _refuse("arguments of little depth", "deeper ones")
    if isinstance(held, list):
        return tuple(_argument(part, depth + 1) for part in held)
    if isinstance(held, dict):
        ((key, value),) = held.items()
        if key == "r":
            return Register(_index(value))
        if key == "n":
            return Rows(*map(_whole, value))
        if key == "share":
            return Share(float(value))
        return TYPES[value] if key == "t" else _SPECIAL[{"f": value}[key]]
    if isinstance(held, str):
        return _word(held)
    return held if held is None or isinstance(held, bool | float) else _whole(held)


def _numbers(held: Any, depth: int) -> Any:
    """Returns the numbers of a constant, in nested tuples."""
    if isinstance(held, list) and depth < MAX_DEPTH:
        return tuple(_numbers(part, depth + 1) for part in held)
    if isinstance(held, dict):
        return _SPECIAL[held["f"]]
    return held if isinstance(held, float | bool) else _whole(held, 2**63)


def _count(values: Any) -> int:
    return sum(map(_count, values)) if isinstance(values, tuple) else 1


def _whole(value: Any, most: int = MAX_WHOLE) -> int:
    """A number without bounds is one of slices, which torch writes as the largest there is."""
    if not isinstance(value, int) or isinstance(value, bool) or (abs(value) > most and value != 2**63 - 1):
        _refuse(f"whole numbers up to {most}", repr(value)[:50])
    return value


def _index(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < MAX_TEXT:
        _refuse("places of registers", repr(value)[:50])
    return value


def _word(value: Any) -> str:
    if not isinstance(value, str) or not value.isascii() or len(value) > 200:
        _refuse("short words", repr(value)[:50])
    return value
