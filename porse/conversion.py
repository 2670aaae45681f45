"""A parsed YAML document as frozen dataclasses, by pydantic: types and ranges checked, and no default anywhere.

A missing, unknown, mistyped or out-of-range value is a `ParamsError` that names it.
"""

import dataclasses
import difflib
import functools
import json
import math
import operator
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from annotated_types import MinLen

from porse.errors import ParamsError

if TYPE_CHECKING:
    from pydantic import ConfigDict, TypeAdapter

_SHOWN = 200
"""Characters of a wrong value that an error repeats."""

LARGEST = 1e9
"""No parameter is larger, so that a slip of the keyboard is found before it becomes an overflow."""

CONFIG: "ConfigDict" = {
    "strict": True,
    "extra": "forbid",
    "allow_inf_nan": False,
    # `lambda` is a word of Python's; in params.yaml it is the paper's letter.
    "alias_generator": lambda name: name.rstrip("_"),
}
"""How pydantic reads a document's dataclass, and those in it."""

_UNKNOWN, _MISSING = "unexpected_keyword_argument", "missing"

_EXPECTED = {
    "bool_type": "a value of type bool",
    "int_type": "a value of type int",
    "float_type": "a value of type float",
    "string_type": "a value of type str",
    "finite_number": f"a finite number of at most {LARGEST:g}",
    "tuple_type": "a list",
    "list_type": "a list",
    "too_short": "a list with at least one entry",
    "dict_type": "a value of type dict",
    "dataclass_type": "a mapping",
    "literal_error": "one of {expected}",
    "value_error": "{error}",
}
"""What is expected, by the type of pydantic's error, of which the words in braces are."""


@dataclass(frozen=True)
class Range:
    """Bounds of a number, both included."""

    low: float
    high: float = LARGEST

    def __get_pydantic_core_schema__(self, kind: Any, handler: Any) -> Any:
        """Returns the check; an error of pydantic's own names one bound."""
        # Imported here and below: a command that reads no parameters does without it.
        from pydantic_core import core_schema

        return core_schema.no_info_after_validator_function(self._check, handler(kind))

    def __get_pydantic_json_schema__(self, kind: Any, handler: Any) -> dict[str, Any]:
        """Returns a number's JSON Schema with the bounds."""
        return {**handler(kind), "minimum": self.low, "maximum": self.high}

    def _check(self, number: float) -> float:
        if not self.low <= number <= self.high:
            raise ValueError(f"a number in [{self.low:g}, {self.high:g}]")
        return number


Positive = Annotated[int, Range(1)]
Fraction = Annotated[float, Range(0.0, 1.0)]
NonNegative = Annotated[float, Range(0.0)]

_Item = typing.TypeVar("_Item")
Some = Annotated[tuple[_Item, ...], MinLen(1)]


def convert(value: Any, kind: Any, name: str, where: str) -> Any:
    """Returns `value` as the annotated type `kind`.

    Args:
        value: what the document holds.
        kind: a dataclass with `CONFIG`, or another type that pydantic knows.
        name: the value's dotted name; empty for the document.
        where: names the document in errors.

    Raises:
        ParamsError: a value is missing, unknown, mistyped or out of range.
    """
    from pydantic import ValidationError

    _check_json(value, name, where)
    try:
        # As JSON: of Python's values, a strict type reads no list as a tuple, and no mapping as a dataclass.
        return _reader(kind).validate_json(json.dumps(value))
    except ValidationError as error:
        raise ParamsError(_sentence(error.errors(), value, name, where)) from None


@functools.cache
def _reader(kind: Any) -> "TypeAdapter":
    from pydantic import TypeAdapter

    return TypeAdapter(kind, config=None if dataclasses.is_dataclass(kind) else CONFIG)


def _check_json(value: Any, name: str, where: str) -> None:
    """Raises a ParamsError for what JSON cannot hold: a date, a key that is not a text, a number that is not finite."""
    expected = ""
    if isinstance(value, dict) and not all(isinstance(key, str) for key in value):
        expected = "a mapping with texts as keys"
    elif isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            _check_json(item, _dotted(name, [key]), where)
    elif isinstance(value, float) and not math.isfinite(value):
        expected = _EXPECTED["finite_number"]
    elif not isinstance(value, bool | int | float | str | None):
        expected = "a value of a type that JSON has"
    if expected:
        raise ParamsError(wrong(name or "the document", expected, value, where))


def _sentence(errors: Sequence[Any], value: Any, name: str, where: str) -> str:
    """Returns the text of that one of pydantic's errors which is to be corrected first: an unknown key, then a missing one."""
    error = min(errors, key=lambda error: (error["type"] != _UNKNOWN, error["type"] != _MISSING))
    *path, last = error["loc"] or ("",)
    beside = {other["loc"][-1]: other["type"] for other in errors if other["loc"] and [*other["loc"][:-1]] == path}
    prefix = _dotted(name, [*path, ""]).lstrip(".")
    if error["type"] == _MISSING:
        return f"expected the parameter {prefix}{last} in {where}, found none; add it, Python has no defaults"
    if error["type"] == _UNKNOWN:
        # No field has a default: each is there, or missed.
        known = [key for key in functools.reduce(operator.getitem, path, value) if beside.get(key) != _UNKNOWN]
        known += [key for key, kind in beside.items() if kind == _MISSING]
        near = difflib.get_close_matches(last, known, n=1)
        hint = f"did you mean {prefix}{near[0]}?" if near else f"known here: {', '.join(known)}"
        return f"expected only known parameters in {where}, found {prefix}{last}; {hint}"
    if last in ("int", "str"):
        # The kinds of a union have an error each, below the place of the value.
        expected = f"a value of type {' or '.join(beside)}"
    else:
        path = [*error["loc"]]
        expected = _EXPECTED.get(error["type"], error["msg"]).format(**error.get("ctx", {}))
    return wrong(_dotted(name, path) or "the document", expected, error["input"], where)


def _dotted(name: str, path: Sequence[str | int]) -> str:
    """Returns the dotted name of what is at a path below a name."""
    dotted = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return f"{name}{dotted}" if name else dotted.removeprefix(".")


def convert_part(value: Mapping[str, Any], section: type, name: str, where: str, open_class: type) -> Any:
    """Returns an incomplete dataclass from a mapping that has some of its fields; the others are left unset.

    Args:
        value: what the document holds.
        section: the dataclass.
        name: the value's dotted name; empty for the document.
        where: names the document in errors.
        open_class: dataclasses below `section` may be incomplete, too, where they are derived from this class.

    Raises:
        ParamsError: a value is unknown, mistyped or out of range.
    """
    fields = {field.name.rstrip("_"): field for field in dataclasses.fields(section)}
    hints = typing.get_type_hints(section, include_extras=True)
    part: Any = object.__new__(section)
    for key, item in value.items():
        if key not in fields:
            raise ParamsError(wrong(f"{name}{key}", f"one of {', '.join(fields)}", item, where))
        kind = hints[fields[key].name]
        is_open = isinstance(kind, type) and issubclass(kind, open_class)
        converted = (
            convert_part(item, kind, f"{name}{key}.", where, open_class)
            if is_open
            else convert(item, kind, f"{name}{key}", where)
        )
        # The dataclass is frozen, and nobody has seen this one yet.
        object.__setattr__(part, fields[key].name, converted)
    return part


def wrong(name: str, expected: str, found: Any, where: str) -> str:
    """Returns the text of an error about one value."""
    text = repr(found)
    if len(text) > _SHOWN:
        text = f"{text[:_SHOWN]}..."
    return f"expected {name} to be {expected}, found {text} in {where}; change it there"
