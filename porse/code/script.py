"""From stored source to a checked graph of operators, and TorchScript's errors as ours.

Everything is checked again on every compilation, since the source may come from elsewhere. Python never runs the source.
"""

import math
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import torch

from porse.code.alias import first_write
from porse.code.alike import give_numbers_one_type
from porse.code.bounds import check_bounds
from porse.code.calls import FUNCTIONAL
from porse.code.check import check_program
from porse.code.emit import Emitted, emit
from porse.code.graph import flatten, line_of
from porse.code.names import hold_plain_names
from porse.code.numbers import hold_tensors
from porse.code.one_type import Local, text_before, types_of_names
from porse.code.program import parse_program
from porse.functions.verdict import Check, CodeError
from porse.variables import Variable

_NAMESPACE: dict[str, Any] = {
    "torch": torch, "math": math, FUNCTIONAL: torch.nn.functional, "RuntimeError": RuntimeError,
    # torch.cdist itself is compiled from its source, which a confined process may not read.
    "porse_cdist_kernel": torch._VF.cdist,  # type: ignore[attr-defined]
}  # fmt: skip
_ROUNDS = 24
"""How often a text is written anew for names whose first value told the wrong type."""


@dataclass(frozen=True)
class Script:
    """A checked function as a graph.

    Attributes:
        graph: the flat graph of its operators.
        lines: for each line of the text that was compiled, the line of the source, 0 for lines of our own.
        arguments: the task variable of each argument, in order.
        unit: what the graph was compiled in. Inlined operators point into it when they fail, so it must live as long.
    """

    graph: Any
    lines: tuple[int, ...]
    arguments: tuple[str, ...]
    unit: Any

    def callable(self) -> Any:
        """Returns a function that runs the graph."""
        return torch._C._create_function_from_graph("generated", self.graph)


def script(source: str, variables: Mapping[str, Variable]) -> Script:
    """Returns the checked graph of a stored source.

    Raises:
        CodeError: the source breaks the contract.
    """
    program = parse_program(source)
    give_numbers_one_type(program, variables)
    reads = check_program(program, variables)
    types: dict[Local, str] = {}
    tries = [_compile(emit(program, reads, variables, types))]
    for _ in range(_ROUNDS):
        last = tries[-1]
        found = types_of_names(last.functions, str(last.error or ""), last.emitted.text, types)
        if not found:
            break
        types |= found
        tries.append(_compile(emit(program, reads, variables, types)))
    if types:
        try:
            return _checked(tries[-1])
        except CodeError:
            pass  # then as it was written
    return _checked(tries[0])


@dataclass(frozen=True)
class _Compiled:
    """What TorchScript made of a text: its functions, those before the error where there was one."""

    emitted: Emitted
    unit: Any
    functions: list[Any]
    error: Exception | None


def _compile(emitted: Emitted) -> _Compiled:
    unit, error = _unit(emitted.text)
    before, failed = (unit, None) if error is None else _unit(text_before(str(error), emitted.text))
    return _Compiled(emitted, unit, before.get_functions() if failed is None else [], error)


def _unit(text: str) -> tuple[Any, Exception | None]:
    """Returns what TorchScript made of a text, and why not all of it."""
    unit = torch._C.CompilationUnit()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            unit.define(text, lambda name: cast(Any, _NAMESPACE.get(name)))
    except Exception as error:  # whatever TorchScript raises, it does not take the text
        return unit, error
    return unit, None


def _checked(compiled: _Compiled) -> Script:
    """Returns the graph of what was compiled, held against the rules for graphs."""
    emitted = compiled.emitted
    try:
        if compiled.error is not None:
            raise compiled.error
        graph = flatten(compiled.unit.find_function(emitted.name))
        check_bounds(graph)
    except CodeError as error:
        raise CodeError(error.check, str(error), _source_line(emitted.lines, error.line)) from None
    except Exception as error:
        raise translate(error, emitted.lines, "compile") from None
    write = first_write(graph)
    if write is not None:
        name = emitted.arguments[write[0]]
        line = _source_line(emitted.lines, line_of(write[1]))
        raise CodeError("inplace", f"the function may change its input {name} in place; work on {name}.clone()", line)
    hold_plain_names(graph)
    hold_tensors(graph)
    return Script(graph, emitted.lines, emitted.arguments, compiled.unit)


def _source_line(lines: Sequence[int], line: int) -> int:
    return lines[line - 1] if 0 < line <= len(lines) else 0


def translate(error: Exception, lines: Sequence[int], check: Check) -> CodeError:
    """Returns TorchScript's error as one of ours: its core, without paths, at the line of the source."""
    text = str(error)
    numbers = [int(n) for n in re.findall(r'File "<string>", line (\d+)', text)]
    positions = [lines[n - 1] for n in numbers if 0 < n <= len(lines) and lines[n - 1]]
    core = text.rpartition("RuntimeError: ")[2] if "RuntimeError: " in text else text.split('File "', 1)[0]
    if isinstance(error, MemoryError) or "DefaultCPUAllocator" in text or "bad_alloc" in text:
        return CodeError("memory", "the function needs more memory than it may use", positions[-1] if positions else 0)
    core = re.sub(r"\s+", " ", re.sub(r"\bporse_(f_)?(?=\w)", "", core)).strip(" :")[:600]
    if core.endswith("as a scalar argument"):
        core += "; functions of math and numpy take numbers, those of torch take tensors"
    if check == "compile" and re.search(r"type|argument|Expected", core):
        check = "type"
    line = (positions[-1] if check == "run" else positions[0]) if positions else 0
    return CodeError(check, f"TorchScript says: {core}", line)
