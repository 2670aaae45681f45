"""The verdict on one generated function, and the error of a caller who runs a function that has none."""

from dataclasses import dataclass
from typing import Literal

from porse.errors import PorseError

Check = Literal[
    "ok",
    "extract",
    "syntax",
    "static",
    "variable",
    "device",
    "compile",
    "type",
    "return",
    "inplace",
    "names",
    "shape",
    "finite",
    "constant",
    "run",
    "time",
    "memory",
    "crash",
]
"""Which check decided; `docs/generated-code.md` says what each one asks for."""


@dataclass(frozen=True)
class Verdict:
    """What the checks say about one submitted function.

    Attributes:
        passed: the function may be used.
        check: the check that decided, "ok" when passed.
        message: one paragraph for a person and for a repair prompt, empty when passed.
        line: line of the reply, counted from 1, that the message is about; 0 when it is about no one line.
        names: the reward components, or the progress variables; empty unless passed.
        rises: one flag for each progress variable, true when the task needs it to rise; empty for rewards.
    """

    passed: bool
    check: Check
    message: str
    line: int
    names: tuple[str, ...] = ()
    rises: tuple[bool, ...] = ()


class CodeError(PorseError):
    """A generated function was refused or failed.

    Attributes:
        check: the check that refused it.
        line: line of the function's source, counted from 1; 0 when the error is about no one line.
    """

    def __init__(self, check: Check, message: str, line: int = 0) -> None:
        """Keeps what a verdict needs."""
        super().__init__(message)
        self.check: Check = check
        self.line = line
