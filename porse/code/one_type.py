"""Names whose first value tells TorchScript the wrong type, found from what it made of a text or says against it.

It types a name by its first value. `total = 0.0` stays a number when a loop adds tensors to it: TorchScript makes a number
of each sum without a word, which fails for more than one environment. `names = []` is a list of tensors for ever. Both
are good Python, so such a text is written a second time with the types that are found here.
"""

import re
from collections.abc import Container, Iterator, Sequence
from typing import Any

from porse.code.graph import line_of, nodes

Local = tuple[str, str]
"""A function of the text and a name that it assigns."""

TENSOR, FLOAT = "Tensor", "float"
"""Types of a name whose numbers are to be tensors or floats. One that begins empty has the type of its elements."""

_ASSIGNED = re.compile(r" *(\w+)(?:: \w+)? [-+*/]?= ")
_FILLED = re.compile(r" *(\w+)(?:\.(?:append|extend|update)\(|\[.*\] = | \+= | = \(\1 \+ )")
_HEAD = re.compile(r"def (\w+)\(")
_PLAIN = "(int|float|bool|Tensor)"
_OF_TWO_TYPES = re.compile(
    rf"Type mismatch: (\w+) is set to type {_PLAIN} in the true branch and type {_PLAIN} in the false branch"
)
_OF_ANOTHER_TYPE = re.compile(
    rf"Variable '(\w+)' previously had type {_PLAIN} but is now being assigned to a value of type {_PLAIN}$",
    re.MULTILINE,
)
_HOLDS = re.compile(r"previously matched to type Tensor is matched to type (.+?)\.$", re.MULTILINE)


def types_of_names(functions: Sequence[Any], error: str, text: str, known: Container[Local]) -> dict[Local, str]:
    """Returns `TENSOR`, `FLOAT` or a type of elements for each name whose first value is seen to tell the wrong type.

    Args:
        functions: what was compiled of `text`, or of `text_before`, where there was an error.
        error: why `text` was not compiled, "" where it was.
        text: TorchScript text, one statement a line.
        known: names that were found before; they are left out.
    """
    lines = text.split("\n")
    found = {local: TENSOR for function in functions for local in _made_numbers(function, lines)}
    if all(local in known for local in found):  # an error may follow from those that are new
        found |= _named(error, lines)
    return {local: kind for local, kind in found.items() if local not in known}


def text_before(error: str, text: str) -> str:
    """Returns what TorchScript takes of a text: without the statement of the error and all that comes after it."""
    lines = text.split("\n")
    end = _line_of_error(error, lines) - 1
    if end < 0:
        return ""
    while re.match(r" {8}| {4}else:", lines[end]):  # inside of a statement, or its other side
        end -= 1
    return "\n".join([*lines[:end], "    pass" if lines[end].startswith(" ") else "", ""])


def _made_numbers(function: Any, lines: Sequence[str]) -> Iterator[Local]:
    """Yields the names that hold numbers which TorchScript made of tensors."""
    for node in nodes(function.graph):
        if node.kind() in ("aten::FloatImplicit", "aten::IntImplicit"):
            number = line_of(node)
            assigned = _ASSIGNED.match(lines[number - 1]) if 0 < number <= len(lines) else None
            if assigned:
                yield _function_at(lines, number), assigned[1]


def _named(error: str, lines: Sequence[str]) -> dict[Local, str]:
    """Returns the type of the name that an error is about, as far as it tells."""
    number = _line_of_error(error, lines)
    if not number:
        return {}
    function = _function_at(lines, number)
    if two := _OF_TWO_TYPES.search(error) or _OF_ANOTHER_TYPE.search(error):
        return {(function, two[1]): FLOAT if {two[2], two[3]} == {"int", "float"} else TENSOR}
    holds, filled = _HOLDS.search(error), _FILLED.match(lines[number - 1])
    return {(function, filled[1]): holds[1]} if holds and filled else {}


def _line_of_error(error: str, lines: Sequence[str]) -> int:
    """Returns the line of the text, counted from 1, that an error is about, 0 for none."""
    found = re.search(r'File "<string>", line (\d+)', error)
    return int(found[1]) if found and 0 < int(found[1]) <= len(lines) else 0


def _function_at(lines: Sequence[str], number: int) -> str:
    """Returns the name of the function that a line, counted from 1, belongs to."""
    heads = (_HEAD.match(line) for line in reversed(lines[:number]))
    return next((head[1] for head in heads if head), "")
