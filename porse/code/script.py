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
from porse.code.bounds import check_bounds
from porse.code.calls import FUNCTIONAL
from porse.code.check import check_program
from porse.code.emit import Emitted, emit
from porse.code.graph import flatten, line_of
from porse.code.names import hold_plain_names
from porse.code.numbers import hold_tensors
from porse.code.program import parse_program
from porse.code.verdict import Check, CodeError
from porse.variables import Variable

_NAMESPACE: dict[str, Any] = {"torch": torch, "math": math, FUNCTIONAL: torch.nn.functional}


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
    emitted = emit(program, check_program(program, variables), variables)
    unit = torch._C.CompilationUnit()
    return Script(_graph(unit, emitted), emitted.lines, emitted.arguments, unit)


def _graph(unit: Any, emitted: Emitted) -> Any:
    """Returns the graph of an emitted text, held against the rules for graphs."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            unit.define(emitted.text, lambda name: cast(Any, _NAMESPACE.get(name)))
            graph = flatten(unit.find_function(emitted.name))
            check_bounds(graph)
    except CodeError as error:
        raise CodeError(error.check, str(error), _source_line(emitted.lines, error.line)) from None
    except Exception as error:  # whatever TorchScript raises, it does not take the text
        raise translate(error, emitted.lines, "compile") from None
    write = first_write(graph)
    if write is not None:
        name = emitted.arguments[write[0]]
        line = _source_line(emitted.lines, line_of(write[1]))
        raise CodeError("inplace", f"the function may change its input {name} in place; work on {name}.clone()", line)
    hold_plain_names(graph)
    hold_tensors(graph)
    return graph


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
    if check == "compile" and re.search(r"type|argument|Expected", core):
        check = "type"
    line = (positions[-1] if check == "run" else positions[0]) if positions else 0
    return CodeError(check, f"TorchScript says: {core}", line)
