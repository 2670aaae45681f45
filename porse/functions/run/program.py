"""The operator list of one function, as data, and its one canonical JSON text.

A list has registers: first the task variables that it reads, then its constants, then what each step makes. A step names an
operator and its arguments: registers, numbers, texts, types, lists of them, and whole numbers that grow with the number of
environments. There are no branches and no loops. `shapes` says whether a list is sound; here its text and its size are.
"""

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import torch
from torch import Tensor

from porse.functions.verdict import MAX_COMPONENTS, MAX_NAMES, CodeError, Kind, plain_name, words
from porse.identity import canonical_json

MAX_TEXT = 1_000_000
"""Characters of a list."""
MAX_STEPS = 4_000
MAX_NUMBERS = 20_000
"""Numbers in all constants together."""
MAX_DEPTH = 6
"""Lists within an argument, or within a constant."""
MAX_WHOLE = 10_000_000
"""Largest whole number that is written in a list."""
_NO_END = 2**63 - 1
"""What torch writes for the end of a slice that has none."""
TYPES = {name: getattr(torch, name) for name in ("float32", "float64", "float16", "int64", "int32", "uint8", "bool")}
_NAMES_OF_TYPES = {dtype: name for name, dtype in TYPES.items()}
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
    constants: tuple[Tensor, ...]
    steps: tuple[Step, ...]
    results: tuple[int, ...]
    names: tuple[str, ...]
    rises: tuple[bool, ...]

    @property
    def starts(self) -> list[int]:
        """The register that each step fills, or the first of those that it does; at last the number of all."""
        given = len(self.variables) + len(self.constants)
        return [*accumulate((step.makes for step in self.steps), initial=given)]

    @property
    def text(self) -> str:
        """The canonical JSON text: equal lists have equal texts."""
        return canonical_json({name: mapped(value, _written) for name, value in vars(self).items()})


def mapped(value: Any, change: Callable[[Any], Any]) -> Any:
    """Returns an argument with what `change` makes of each part in its place, however deep in lists, which are tuples."""
    return tuple(mapped(part, change) for part in value) if isinstance(value, tuple | list) else change(value)


def leaves(value: Any) -> Iterator[Any]:
    """Yields the parts of an argument, or the numbers of a constant, however deep in lists."""
    if isinstance(value, tuple | list):
        for part in value:
            yield from leaves(part)
    else:
        yield value


def grown(found: Sequence[Any], counts: Sequence[int]) -> Rows | Share | None:
    """Returns the number that is what was found for each number of environments, None where there is none."""
    candidates: list[Rows | Share] = []
    if all(type(value) is int for value in found):
        times = (found[-1] - found[0]) // (counts[-1] - counts[0])
        candidates = [Rows(times, found[0] - times * counts[0])]
    elif all(type(value) is float and math.isfinite(value * counts[-1]) for value in found):
        of = found[0] * counts[0]
        candidates = [Share(of), Share(float(round(of)))]
    return next((number for number in candidates if [*map(number.at, counts)] == [*found]), None)


def registers(value: Any) -> Iterator[int]:
    """Yields the registers in an argument, with repetitions."""
    return (leaf.index for leaf in leaves(value) if isinstance(leaf, Register))


def at(value: Any, num_envs: int) -> Any:
    """Returns an argument for so many environments; registers stay."""
    return mapped(value, lambda leaf: leaf.at(num_envs) if isinstance(leaf, Rows | Share) else leaf)


def filled(value: Any, values: Sequence[Any]) -> Any:
    """Returns an argument with what registers hold in place of them."""
    return mapped(value, lambda leaf: values[leaf.index] if isinstance(leaf, Register) else leaf)


def _written(value: Any) -> Any:
    """Returns a part of a list as JSON."""
    match value:
        case Step():
            keywords = {name: mapped(held, _written) for name, held in value.keywords}
            return value.operator, mapped(value.arguments, _written), keywords, value.makes
        case Tensor():
            return _NAMES_OF_TYPES[value.dtype], mapped(value.tolist(), _written)
        case Register():
            return {"r": value.index}
        case Rows():
            return {"n": (value.times, value.plus)}
        case Share():
            return {"share": value.of}
        case torch.dtype():
            return {"t": _NAMES_OF_TYPES[value]}
        case float() if not math.isfinite(value):
            return {"f": str(value)}
    return value


def read_program(text: str) -> Program:
    """Returns the list that a text holds. `shapes` says whether it may run.

    Raises:
        CodeError: the text is no canonical list, or too large; check "static".
    """
    _expect(len(text) <= MAX_TEXT, f"at most {MAX_TEXT} characters", len(text))
    try:
        program = _program(**json.loads(text))
        is_canonical = program.text == text
    except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
        _expect(False, "JSON of its own form", f"{type(error).__name__}: {error}")
    _expect(is_canonical, "its canonical text", "another spelling of it")
    return program


def _expect(is_so: bool, expected: str, found: Any) -> None:
    """Refuses a text that is not as expected."""
    if not is_so:
        message = f"expected an operator list as {expected}, found {str(found)[:300]}; validate the function again"
        raise CodeError("static", message)


def _program(kind: Any, variables: Any, constants: Any, steps: Any, results: Any, names: Any, rises: Any) -> Program:
    """Returns the list that the parts of a JSON object hold, all of whose registers are there when they are read."""
    _expect(len(steps) <= MAX_STEPS, f"at most {MAX_STEPS} steps", len(steps))
    _expect(kind in ("reward", "mapping"), "a reward or a mapping", kind)
    program = Program(
        kind,
        tuple(map(_word, variables)),
        tuple(torch.tensor(mapped(values, _argument), dtype=TYPES[dtype]) for dtype, values in constants),
        tuple(_step(*step) for step in steps),
        tuple(_whole(index, 0) for index in results),
        tuple(names),
        tuple(rises),
    )
    count, depth = (sum(c.numel() for c in program.constants), max((c.dim() for c in program.constants), default=0))
    _expect(count <= MAX_NUMBERS, f"at most {MAX_NUMBERS} numbers in its constants", count)
    _expect(depth <= MAX_DEPTH, "constants of little depth", depth)
    _expect(len(set(program.variables)) == len(program.variables), "each variable once", program.variables)
    *starts, end = program.starts
    for step, made in zip(program.steps, starts, strict=True):
        _expect(all(i < made for i in registers(step.arguments)), "steps that read what is there", step.operator)
    _expect(all(index < end for index in results), "results that are there", results)
    most, counts = (MAX_COMPONENTS, (1, 0)) if kind == "reward" else (MAX_NAMES, (0, len(names)))
    is_paired = (len(results) - len(names), len(rises)) == counts
    are_distinct = 0 < len(names) <= most and len(set(names)) == len(names)
    _expect(is_paired and are_distinct, f"1 to {most} results with distinct names", names)
    _expect(all(plain_name(n) == n for n in names), "plain names", names)
    _expect(all(isinstance(r, bool) for r in rises), "directions that are true or false", rises)
    return program


def _step(operator: Any, arguments: Any, keywords: Any, makes: Any) -> Step:
    _expect(keywords.keys() <= _KEYWORDS, "known keywords", f"{sorted(keywords)} in {operator}")
    _expect(_depth([arguments, [*keywords.values()]]) <= MAX_DEPTH + 2, "arguments of little depth", "deeper ones")
    given = tuple((name, mapped(value, _argument)) for name, value in sorted(keywords.items()))
    are_plain = not any(isinstance(leaf, Register | Rows | Share) for leaf in leaves(given))
    _expect(are_plain, "keywords that are written out", operator)
    return Step(_word(operator), mapped(arguments, _argument), given, _whole(makes, 1, 1000))


def _depth(held: Any) -> int:
    """Returns how deep lists lie in one another; 0 for what is no list."""
    return 1 + max(map(_depth, held), default=0) if isinstance(held, list) else 0


def _argument(held: Any) -> Any:
    """Returns a part of an argument, or a number of a constant, that JSON holds."""
    match held:
        case dict():
            ((key, value),) = held.items()
            return _TAGGED[key](value)
        case str():
            return _word(held)
        case None | bool() | float():
            return held
    return held if held == _NO_END else _whole(held)


def _whole(value: Any, least: int = -MAX_WHOLE, most: int = MAX_WHOLE) -> int:
    _expect(type(value) is int and least <= value <= most, f"whole numbers from {least} to {most}", value)
    return value


def _word(value: Any) -> str:
    _expect(value.isascii() and len(value) <= 200, "short words", value)
    return value


_TAGGED: dict[str, Callable[[Any], Any]] = {
    "r": lambda value: Register(_whole(value, 0)),
    "n": lambda value: Rows(*map(_whole, value)),
    "share": lambda value: Share(float(value)),
    "t": TYPES.__getitem__,
    "f": {"inf": math.inf, "-inf": -math.inf, "nan": math.nan}.__getitem__,
}
"""What JSON has no words for, by the key of an object that holds it."""
