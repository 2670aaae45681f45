"""Generated functions that can be called: thin typed wrappers that say what came back wrong."""

import copy
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from operator import itemgetter
from typing import Any, Self

import torch
from torch import Tensor

from porse.code.bounds import forced_graphs
from porse.code.contract import MAX_COMPONENTS, MAX_NAME_CHARACTERS, MAX_NAMES
from porse.code.numbers import hold_numbers
from porse.code.portable import make_portable
from porse.code.script import Script, script, translate
from porse.code.verdict import CodeError
from porse.variables import Variable

# Attributes of modules, looked up once: a call of a function takes some ten microseconds.
_FLOAT32 = torch.float32
_set_optimiser = torch._C._set_graph_executor_optimize


class _Function:
    """A compiled function and the task variables that it takes.

    Attributes:
        arguments: the task variable of each argument, in order; one may come twice.
        line: the line of the source that returns the results.
    """

    def __init__(self, compiled: Script, variables: Mapping[str, Variable]) -> None:
        """Wraps a checked graph."""
        self.arguments = compiled.arguments
        self.line = compiled.lines[-1]
        self._script = compiled
        self._variables = variables
        self._tensor = next((name for name in self.arguments if variables[name].kind == "tensor"), "")
        self._run = compiled.callable()
        self._pick = itemgetter(*self.arguments) if len(self.arguments) > 1 else None

    def portable(self) -> Self:
        """Returns the same function with the operators replaced whose bits depend on the CPU's vendor."""
        graph = self._script.graph.copy()
        make_portable(graph)
        hold_numbers(graph)
        twin = copy.copy(self)
        twin._script = replace(self._script, graph=graph)
        twin._run = twin._script.callable()
        return twin

    def _call(self, variables: Mapping[str, Any]) -> Any:
        # Without its optimiser TorchScript runs the graph as it stands, so the first call and every later one give the
        # same bits. The switch belongs to the whole process, so it is set here and not once.
        _set_optimiser(False)
        try:
            if self._pick is None:
                return self._run(*[variables[name] for name in self.arguments])
            return self._run(*self._pick(variables))
        except Exception as error:  # whatever TorchScript raises, the function has failed
            raise translate(error, self._script.lines, "run") from None

    def run_branches(self, variables: Mapping[str, Any]) -> None:
        """Runs every side of every branch once, whatever the data say: only time and memory are of interest.

        Raises:
            CodeError: a side needs more memory than there is.
        """
        values = [variables[name] for name in self.arguments]
        for graph in forced_graphs(self._script.graph):
            try:
                replace(self._script, graph=graph).callable()(*values)
            except Exception as error:  # a side that is forced may fail as it never would
                failure = translate(error, self._script.lines, "run")
                if failure.check == "memory":
                    raise failure from None

    def _zeros(self) -> dict[str, Any]:
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
        found = f"expected {what} of shape (num_envs,), found {_shape(value, num_envs)} for num_envs = {num_envs}"
        raise CodeError("shape", f"{found}; reduce the other dimensions, and take sizes from the inputs", self.line)


class RewardFunction(_Function):
    """A compiled goal reward."""

    def __init__(self, compiled: Script, variables: Mapping[str, Variable]) -> None:
        """Wraps a checked graph."""
        super().__init__(compiled, variables)
        self._names: tuple[str, ...] = ()

    def __call__(self, variables: Mapping[str, Any]) -> tuple[Tensor, dict[str, Tensor]]:
        """Returns the total reward, (num_envs,), and each component, (num_envs,), by name, all float32.

        Args:
            variables: the task's variables by name; those of `arguments` are read.

        Raises:
            CodeError: the function fails on these values, or returns something else.
        """
        result = self._call(variables)
        if self._names:  # a result like the checked one before it is plain already; finding out takes a microsecond
            total, components = result
            shape = total.shape
            if len(shape) == 1 and total.dtype is _FLOAT32 and tuple(components) == self._names:
                for value in components.values():
                    if value.shape != shape or value.dtype is not _FLOAT32:
                        break
                else:
                    return result
        return self._checked(result, variables)

    def _checked(self, result: Any, variables: Mapping[str, Any]) -> tuple[Tensor, dict[str, Tensor]]:
        """Returns a result in its plain form, or says what is wrong with it."""
        if not isinstance(result, tuple) or len(result) != 2 or not isinstance(result[1], dict):
            found = f"expected two results, the total reward and a dictionary of components, found {_kind(result)}"
            raise CodeError("return", found, self.line)
        total, components = result
        num_envs = variables[self._tensor].shape[0] if self._tensor else 0
        checked: dict[str, Tensor] = {}
        for key, value in components.items():
            if not isinstance(key, str):
                raise CodeError("return", f"expected component names to be text, found {_kind(key)}", self.line)
            if isinstance(value, Tensor) and value.dim() == 0:
                value = value.expand(num_envs)
            checked[plain_name(key)] = self._per_env(f"the component {key}", value, num_envs)
        if len(checked) != len(components) or not 0 < len(checked) <= MAX_COMPONENTS:
            found = f"expected 1 to {MAX_COMPONENTS} components with distinct names, found {', '.join(map(str, components))}"
            raise CodeError("names", found, self.line)
        total = self._per_env("the total reward", total, num_envs)
        self._names = tuple(checked)
        return total, checked


class MappingFunction(_Function):
    """A compiled mapping."""

    def __init__(self, compiled: Script, variables: Mapping[str, Variable]) -> None:
        """Wraps a checked graph."""
        super().__init__(compiled, variables)
        self._flags: list[bool] = []
        self._names: list[str] = []

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the progress variables."""
        self._learn()
        return tuple(self._names)

    @property
    def rises(self) -> tuple[bool, ...]:
        """For each progress variable, whether the task needs it to rise."""
        self._learn()
        return tuple(self._flags)

    def _learn(self) -> None:
        """Runs the function once on zeros, for the names and directions that it returns with every call."""
        if not self._names:
            self(self._zeros())

    def __call__(self, variables: Mapping[str, Any]) -> tuple[list[Tensor], list[bool], list[str]]:
        """Returns the progress variables, (num_envs,) each and float32, their directions and their names.

        Args:
            variables: the task's variables by name; those of `arguments` are read.

        Raises:
            CodeError: the function fails on these values, or returns something else.
        """
        result = self._call(variables)
        if not isinstance(result, tuple) or len(result) != 3:
            found = f"expected three lists, progress variables, directions and names, found {_kind(result)}"
            raise CodeError("return", found, self.line)
        values, flags, names = (list(part) if isinstance(part, list | tuple) else [part] for part in result)
        if not len(values) == len(flags) == len(names) or not 0 < len(values) <= MAX_NAMES:
            found = (
                f"expected three lists of one length, 1 to {MAX_NAMES}, found {len(values)} progress variables,"
                f" {len(flags)} directions and {len(names)} names"
            )
            raise CodeError("return", found, self.line)
        if not all(isinstance(flag, bool) for flag in flags) or not all(isinstance(name, str) for name in names):
            raise CodeError("return", "expected directions to be True or False and names to be text", self.line)
        plain = [plain_name(name) for name in names]
        if len(set(plain)) != len(plain):
            found = f"expected distinct names of progress variables, found {', '.join(plain)}"
            raise CodeError("names", found, self.line)
        num_envs = variables[self._tensor].shape[0] if self._tensor else 0
        checked = [self._per_env(f"the progress variable {n}", v, num_envs) for n, v in zip(plain, values, strict=True)]
        self._flags, self._names = flags, plain
        return checked, flags, plain


def compile_reward(source: str, variables: Sequence[Variable], portable: bool) -> RewardFunction:
    """Returns the compiled goal reward of a stored source.

    Args:
        source: the source of a candidate.
        variables: what the task offers.
        portable: replace the operators whose bits depend on the CPU's vendor.

    Raises:
        CodeError: the source breaks the contract.
    """
    table = {variable.name: variable for variable in variables}
    function = RewardFunction(script(source, table), table)
    return function.portable() if portable else function


def compile_mapping(source: str, variables: Sequence[Variable], portable: bool) -> MappingFunction:
    """Returns the compiled mapping of a stored source; arguments and errors as for `compile_reward`."""
    table = {variable.name: variable for variable in variables}
    function = MappingFunction(script(source, table), table)
    return function.portable() if portable else function


@lru_cache(maxsize=1024)
def plain_name(name: str) -> str:
    """Returns a name of at most 64 letters, digits and underscores, "unnamed" when nothing is left."""
    return re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")[:MAX_NAME_CHARACTERS] or "unnamed"


def _kind(value: Any) -> str:
    if isinstance(value, tuple | list):
        return f"{len(value)} values ({', '.join(_kind(part) for part in value[:5])})"
    return {"Tensor": "one tensor"}.get(type(value).__name__, type(value).__name__)


def _shape(value: Tensor, num_envs: int) -> str:
    parts = ["num_envs" if n == num_envs else str(n) for n in value.shape]
    return f"({', '.join(parts)}{',' if len(parts) == 1 else ''})"
