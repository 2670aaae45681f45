"""A parsed YAML document as frozen dataclasses: types and ranges checked, and no default anywhere.

A missing, unknown, mistyped or out-of-range value is a `ParamsError` that names it.
"""

import dataclasses
import difflib
import math
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from porse.errors import ParamsError

_SHOWN = 200
"""Characters of a wrong value that an error repeats."""

LARGEST = 1e9
"""No parameter is larger, so that a slip of the keyboard is found before it becomes an overflow."""


@dataclass(frozen=True)
class Range:
    """Bounds of a number, both included."""

    low: float
    high: float = LARGEST


Positive = Annotated[int, Range(1)]
Fraction = Annotated[float, Range(0.0, 1.0)]
NonNegative = Annotated[float, Range(0.0)]


def convert(value: Any, kind: Any, name: str, where: str) -> Any:
    """Returns `value` as the annotated type `kind`.

    Args:
        value: what the document holds.
        kind: a dataclass, `Annotated` number, `Literal`, `Sequence` (at least one entry), `tuple` (any number of entries),
            `Mapping`, `Any` (whatever JSON can hold), or plain type; or one of these `| None`.
        name: the value's dotted name; empty for the document.
        where: names the document in errors.

    Raises:
        ParamsError: a value is missing, unknown, mistyped or out of range.
    """
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if type(None) in arguments and origin is not Literal:
        kinds = [other for other in arguments if other is not type(None)]
        return None if value is None else convert(value, kinds[0], name, where)
    if origin is Annotated:
        number, bounds = convert(value, arguments[0], name, where), arguments[1]
        if not bounds.low <= number <= bounds.high:
            raise ParamsError(wrong(name, f"a number in [{bounds.low:g}, {bounds.high:g}]", value, where))
        return number
    if dataclasses.is_dataclass(kind):
        return _convert_section(value, typing.cast(type, kind), name, where)
    if origin is Literal:
        if value not in arguments:
            raise ParamsError(wrong(name, f"one of {', '.join(map(str, arguments))}", value, where))
        return value
    if origin in (Sequence, tuple):
        if not isinstance(value, list) or (origin is Sequence and not value):
            expected = "a list with at least one entry" if origin is Sequence else "a list"
            raise ParamsError(wrong(name, expected, value, where))
        return tuple(convert(item, arguments[0], f"{name}[{index}]", where) for index, item in enumerate(value))
    if origin is Mapping:
        if not isinstance(value, dict):
            raise ParamsError(wrong(name, "a mapping", value, where))
        return {str(key): convert(item, arguments[1], f"{name}.{key}", where) for key, item in value.items()}
    return _convert_json(value, name, where) if kind is Any else _convert_scalar(value, kind, name, where)


def _convert_json(value: Any, name: str, where: str) -> Any:
    """Returns a value of any form that JSON can hold; a date is none, nor is a key that is no text."""
    if isinstance(value, list):
        return [_convert_json(item, f"{name}[{index}]", where) for index, item in enumerate(value)]
    if isinstance(value, dict):
        if not all(isinstance(key, str) for key in value):
            raise ParamsError(wrong(name, "a mapping with texts as keys", value, where))
        return {key: _convert_json(item, f"{name}.{key}", where) for key, item in value.items()}
    if value is None:
        return None
    return _convert_scalar(value, bool | int | float | str, name, where)


def _convert_scalar(value: Any, kind: Any, name: str, where: str) -> Any:
    """Returns a bool, int, float or str of the wanted type; an int is a fine float, a bool is no int."""
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        try:
            value = float(value)
        except OverflowError:
            raise ParamsError(wrong(name, f"a number of at most {LARGEST:g}", value, where)) from None
    allowed = typing.get_args(kind) or (kind,)
    if not isinstance(value, allowed) or (isinstance(value, bool) and bool not in allowed):
        expected = " or ".join(option.__name__ for option in allowed)
        raise ParamsError(wrong(name, f"a value of type {expected}", value, where))
    if isinstance(value, float) and not math.isfinite(value):
        raise ParamsError(wrong(name, "a finite number", value, where))
    return value


def _convert_section(value: Any, section: type, name: str, where: str) -> Any:
    """Returns a dataclass from a mapping that has exactly its fields."""
    if not isinstance(value, dict):
        raise ParamsError(wrong(name or "the document", "a mapping", value, where))
    # `lambda` is a word of Python's; in params.yaml it is the paper's letter.
    fields = {field.name.rstrip("_"): field for field in dataclasses.fields(section)}
    prefix = f"{name}." if name else ""
    for key in value:
        if key not in fields:
            near = difflib.get_close_matches(str(key), list(fields), n=1)
            hint = f"did you mean {prefix}{near[0]}?" if near else f"known here: {', '.join(fields)}"
            raise ParamsError(f"expected only known parameters in {where}, found {prefix}{key}; {hint}")
    for key in fields:
        if key not in value:
            raise ParamsError(
                f"expected the parameter {prefix}{key} in {where}, found none; add it, Python has no defaults"
            )
    hints = typing.get_type_hints(section, include_extras=True)
    converted = {
        field.name: convert(value[key], hints[field.name], f"{prefix}{key}", where) for key, field in fields.items()
    }
    return section(**converted)


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
