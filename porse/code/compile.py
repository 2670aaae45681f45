"""From stored source to a function that can be called: check, TorchScript, graph, and a thin typed wrapper.

Everything is checked again on every compilation, since the source may come from elsewhere. Python never runs the source.
"""

import math
import re
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from porse.code.check import check_program
from porse.code.contract import MAX_COMPONENTS, MAX_NAME_CHARACTERS, MAX_NAMES
from porse.code.emit import Emitted, emit
from porse.code.alias import first_write
from porse.code.graph import flatten, line_of
from porse.code.portable import make_portable
from porse.code.program import parse_program
from porse.code.verdict import Check, CodeError
from porse.variables import Variable

_NAMESPACE = {"torch": torch, "math": math, "F": torch.nn.functional}


class _Function:
    """A compiled function and the task variables that it takes.

    Attributes:
        arguments: the task variable of each argument, in order; one may come twice.
        line: the line of the source that returns the results.
    """

    def __init__(self, source: str, variables: Sequence[Variable], portable: bool) -> None:
        """Checks and compiles `source`; see `compile_reward`."""
        table = {variable.name: variable for variable in variables}
        program = parse_program(source)
        emitted = emit(program, check_program(program, table), table)
        self.arguments = emitted.arguments
        self.line = emitted.lines[-1]
        self._lines = emitted.lines
        self._variables = table
        self._tensor = next((name for name in self.arguments if table[name].kind == "tensor"), "")
        self._run = _script(emitted, portable)

    def _call(self, variables: Mapping[str, Any]) -> Any:
        # Without its optimiser TorchScript runs the graph as it stands, so the first call and every later one give the
        # same bits. The switch belongs to the whole process, so it is set here and not once.
        torch._C._set_graph_executor_optimize(False)
        try:
            return self._run(*[variables[name] for name in self.arguments])
        except Exception as error:  # whatever TorchScript raises, the function has failed
            raise _translate(error, self._lines, "run") from None

    def _dummies(self) -> dict[str, Any]:
        """Returns a value of the right kind for each argument, for three environments."""
        plain = {"int": 0, "float": 1.0, "device": torch.device("cpu")}
        return {
            name: plain[v.kind] if v.kind in plain else torch.zeros(3, *v.shape)
            for name, v in self._variables.items()
            if name in self.arguments
        }

    def _per_env(self, what: str, value: Any, num_envs: int) -> Tensor:
        """Returns `value` as float32 of shape (num_envs,)."""
        if not isinstance(value, Tensor):
            raise CodeError("return", f"expected {what} to be a tensor, found {_kind(value)}", self.line)
        if value.dtype != torch.float32:
            value = value.to(torch.float32)
        if value.dim() == 1 and value.shape[0] == num_envs:
            return value
        found = f"expected {what} of shape (num_envs,), found {_shape(value, num_envs)}"
        raise CodeError("shape", f"{found}; reduce the last dimension, or squeeze it", self.line)


class RewardFunction(_Function):
    """A compiled goal reward."""

    def __call__(self, variables: Mapping[str, Any]) -> tuple[Tensor, dict[str, Tensor]]:
        """Returns the total reward, (num_envs,), and each component, (num_envs,), by name.

        Args:
            variables: the task's variables by name; those of `arguments` are read.

        Raises:
            CodeError: the function fails on these values, or returns something else.
        """
        result = self._call(variables)
        if not isinstance(result, tuple) or len(result) != 2 or not isinstance(result[1], dict):
            raise CodeError(
                "return",
                f"expected two results, the total reward and a dictionary of components, found {_kind(result)}",
                self.line,
            )
        total, components = result
        num_envs = variables[self._tensor].shape[0] if self._tensor else 0
        checked: dict[str, Tensor] = {}
        for key, value in components.items():
            if not isinstance(key, str):
                raise CodeError("return", f"expected component names to be text, found {_kind(key)}")
            if isinstance(value, Tensor) and value.dim() == 0:
                value = value.expand(num_envs)
            checked[plain_name(key)] = self._per_env(f"the component {key}", value, num_envs)
        if len(checked) != len(components) or not 0 < len(checked) <= MAX_COMPONENTS:
            raise CodeError(
                "names", f"expected 1 to {MAX_COMPONENTS} components with distinct names, found {sorted(components)}"
            )
        return self._per_env("the total reward", total, num_envs), checked


class MappingFunction(_Function):
    """A compiled mapping."""

    def __init__(self, source: str, variables: Sequence[Variable], portable: bool) -> None:
        """Checks and compiles `source`; see `compile_mapping`."""
        super().__init__(source, variables, portable)
        self._known: tuple[tuple[str, ...], tuple[bool, ...]] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the progress variables."""
        return self._signature()[0]

    @property
    def rises(self) -> tuple[bool, ...]:
        """For each progress variable, whether the task needs it to rise."""
        return self._signature()[1]

    def _signature(self) -> tuple[tuple[str, ...], tuple[bool, ...]]:
        if self._known is None:
            _, rises, names = self(self._dummies())
            self._known = tuple(names), tuple(rises)
        return self._known

    def __call__(self, variables: Mapping[str, Any]) -> tuple[list[Tensor], list[bool], list[str]]:
        """Returns the progress variables, (num_envs,) each, their directions and their names.

        Args:
            variables: the task's variables by name; those of `arguments` are read.

        Raises:
            CodeError: the function fails on these values, or returns something else.
        """
        result = self._call(variables)
        if not isinstance(result, tuple) or len(result) != 3:
            raise CodeError(
                "return",
                f"expected three lists, progress variables, directions and names, found {_kind(result)}",
                self.line,
            )
        values, rises, names = (list(part) if isinstance(part, list | tuple) else [part] for part in result)
        if not len(values) == len(rises) == len(names) or not 0 < len(values) <= MAX_NAMES:
            raise CodeError(
                "return",
                f"expected three lists of one length, 1 to {MAX_NAMES}, found {len(values)} progress variables,"
                f" {len(rises)} directions and {len(names)} names",
                self.line,
            )
        if not all(isinstance(rise, bool) for rise in rises) or not all(isinstance(name, str) for name in names):
            raise CodeError("return", "expected directions to be True or False and names to be text", self.line)
        plain = [plain_name(name) for name in names]
        if len(set(plain)) != len(plain):
            raise CodeError("names", f"expected distinct names of progress variables, found {names}", self.line)
        num_envs = variables[self._tensor].shape[0] if self._tensor else 0
        checked = [self._per_env(f"the progress variable {n}", v, num_envs) for n, v in zip(plain, values, strict=True)]
        return checked, rises, plain


def compile_reward(source: str, variables: Sequence[Variable], portable: bool) -> RewardFunction:
    """Returns the compiled goal reward of a stored source.

    Args:
        source: the source of a candidate.
        variables: what the task offers.
        portable: replace the operators whose bits depend on the CPU's vendor.

    Raises:
        CodeError: the source breaks the contract.
    """
    return RewardFunction(source, variables, portable)


def compile_mapping(source: str, variables: Sequence[Variable], portable: bool) -> MappingFunction:
    """Returns the compiled mapping of a stored source; arguments and errors as for `compile_reward`."""
    return MappingFunction(source, variables, portable)


def plain_name(name: str) -> str:
    """Returns a name of at most 64 letters, digits and underscores, "unnamed" when nothing is left."""
    return re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")[:MAX_NAME_CHARACTERS] or "unnamed"


def _script(emitted: Emitted, portable: bool) -> Any:
    """Returns the TorchScript function of an emitted text, checked again as a graph."""
    unit = torch._C.CompilationUnit()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            unit.define(emitted.text, _NAMESPACE.get)
            graph = flatten(unit.find_function(emitted.name))
    except RuntimeError as error:
        raise _translate(error, emitted.lines, "compile") from None
    except CodeError as error:
        raise CodeError(error.check, str(error), _source_line(emitted.lines, error.line)) from None
    write = first_write(graph)
    if write is not None:
        name = emitted.arguments[write[0]]
        line = _source_line(emitted.lines, line_of(write[1]))
        raise CodeError("inplace", f"the function may change its input {name} in place; work on {name}.clone()", line)
    if portable:
        make_portable(graph)
    return torch._C._create_function_from_graph(emitted.name, graph)


def _source_line(lines: Sequence[int], line: int) -> int:
    return lines[line - 1] if 0 < line <= len(lines) else 0


def _translate(error: Exception, lines: Sequence[int], check: Check) -> CodeError:
    """Returns TorchScript's error as one of ours: its core, without paths, at the line of the source."""
    text = str(error)
    numbers = [int(n) for n in re.findall(r'File "<string>", line (\d+)', text)]
    positions = [lines[n - 1] for n in numbers if 0 < n <= len(lines) and lines[n - 1]]
    core = text.rpartition("RuntimeError: ")[2] if "RuntimeError: " in text else text.split('File "', 1)[0]
    if isinstance(error, MemoryError) or "DefaultCPUAllocator" in text or "bad_alloc" in text:
        return CodeError("memory", "the function needs more memory than it may use", positions[-1] if positions else 0)
    core = re.sub(r"\s+", " ", re.sub(r"\b(porse|f)_(?=\w)", "", core)).strip(" :")[:600]
    if check == "compile" and re.search(r"type|argument|Expected", core):
        check = "type"
    line = (positions[-1] if check == "run" else positions[0]) if positions else 0
    return CodeError(check, f"TorchScript says: {core}", line)


def _kind(value: Any) -> str:
    if isinstance(value, tuple | list):
        return f"{len(value)} values ({', '.join(_kind(part) for part in value[:5])})"
    return {"Tensor": "one tensor"}.get(type(value).__name__, type(value).__name__)


def _shape(value: Tensor, num_envs: int) -> str:
    parts = ["num_envs" if n == num_envs else str(n) for n in value.shape]
    return f"({', '.join(parts)}{',' if len(parts) == 1 else ''})"
