"""Generated functions that can be called: thin typed wrappers that say what came back wrong."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from operator import itemgetter
from typing import Any, Generic, Self, TypeVar

import torch
from torch import Tensor

from porse.code.bounds import forced_graphs
from porse.functions.read.contract import MAX_COMPONENTS, MAX_NAMES
from porse.code.graph import has_fixed_shapes
from porse.code.names import plain_name
from porse.code.numbers import hold_numbers
from porse.code.portable import make_portable
from porse.code.results import Components, Progress, list_components, list_progress, make_vectors
from porse.code.reuse import reuse_memory
from porse.code.script import Script, script, translate
from porse.functions.verdict import CodeError
from porse.variables import Variable

Results = TypeVar("Results")

# Looked up once: a call of a function takes some ten microseconds, and to ask is a tenth of one less than to set.
_is_optimiser_on: Callable[[], bool] = torch._C._get_graph_executor_optimize
_set_optimiser = torch._C._set_graph_executor_optimize


class _Function(ABC, Generic[Results]):
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
        self._graph = compiled.graph.copy()
        """The graph that runs."""
        listed = self._list_results(self._graph)
        self._is_listed = listed is not None
        self._assemble: Callable[[Any], Any] = listed.assemble if listed else _as_it_is
        """Makes of what the graph returns what the function returned."""
        self._run = replace(compiled, graph=self._graph).callable()
        self._fixed = has_fixed_shapes(compiled.graph)
        self._pick: Callable[[Mapping[str, Any]], Any] = itemgetter(*self.arguments) if self.arguments else _nothing
        self._takes_one = len(self.arguments) == 1
        self._is_plain = False
        """Whether the function's results come in their plain form."""
        self._seen_for = -1
        """For which size of its first tensor results are known to be right: to look at each costs as much as a short function."""
        self._finish: Callable[[Any], Any] = self._assemble
        """Makes of what the graph returns, where it is known to be right, the results in their plain form."""

    def portable(self) -> Self:
        """Returns the same function with the operators replaced whose bits depend on the CPU's vendor."""
        graph = self._script.graph.copy()
        make_portable(graph)
        hold_numbers(graph)
        reuse_memory(graph)
        return type(self)(replace(self._script, graph=graph), self._variables)

    def __call__(self, variables: Mapping[str, Any]) -> Results:
        """Returns what the function returns, in its plain form.

        Args:
            variables: the task's variables by name; those of `arguments` are read.

        Raises:
            CodeError: the function fails on these values, or returns something else.
        """
        # Without its optimiser TorchScript runs the graph as it stands, so the first call and every later one give the
        # same bits. The switch belongs to the whole process, so it is set here and not once.
        if _is_optimiser_on():
            _set_optimiser(False)
        try:
            picked = self._pick(variables)
            returned = self._run(picked) if self._takes_one else self._run(*picked)
        except Exception as error:  # whatever TorchScript raises, the function has failed
            raise translate(error, self._script.lines, "run") from None
        size = variables[self._tensor].numel() if self._tensor else 0
        if size == self._seen_for:
            return self._finish(returned)
        num_envs = variables[self._tensor].shape[0] if self._tensor else 0
        looked = self._look(self._assemble([*returned] if self._is_listed else returned), num_envs)
        if self._fixed:
            self._settle(returned, size, num_envs)
        return looked

    def _settle(self, returned: Any, size: int, num_envs: int) -> None:
        """Has results for this size come without a look from now on, or has the graph make them plain before."""
        if self._is_listed and self._tensor and not self._is_plain:
            graph = self._graph.copy()
            if make_vectors(graph, returned, self.arguments.index(self._tensor)):
                self._graph = graph
                self._run = replace(self._script, graph=graph).callable()
                self._seen_for = -1
                return
        self._seen_for = size
        self._finish = self._assemble if self._is_plain else lambda later: self._plain(self._assemble(later), num_envs)

    @staticmethod
    @abstractmethod
    def _list_results(graph: Any) -> Components | Progress | None:
        """Makes a graph return one list of tensors, in place, where it can."""

    @abstractmethod
    def _look(self, result: Any, num_envs: int) -> Results:
        """Returns a result in its plain form, or says what is wrong with it; notes whether it came so."""

    @abstractmethod
    def _plain(self, result: Any, num_envs: int) -> Results:
        """Returns a result of the right kinds in its plain form."""

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

    def _check_tensor(self, value: Any, *what: str) -> None:
        if not isinstance(value, Tensor):
            raise CodeError("return", f"expected the {' '.join(what)} to be a tensor, found {_kind(value)}", self.line)

    def _check_vector(self, num_envs: int, value: Tensor, *what: str) -> None:
        if value.dim() != 1 or value.shape[0] != num_envs:
            shape = _shape(value, num_envs)
            found = f"expected the {' '.join(what)} of shape (num_envs,), found {shape} for num_envs = {num_envs}"
            raise CodeError("shape", f"{found}; reduce the other dimensions, and take sizes from the inputs", self.line)


class RewardFunction(_Function[tuple[Tensor, dict[str, Tensor]]]):
    """A compiled goal reward: the total, (num_envs,), and each component, (num_envs,), by name, all float32."""

    _list_results = staticmethod(list_components)

    def __init__(self, compiled: Script, variables: Mapping[str, Variable]) -> None:
        """Wraps a checked graph."""
        super().__init__(compiled, variables)
        self._names: tuple[str, ...] = ()

    def _look(self, result: Any, num_envs: int) -> tuple[Tensor, dict[str, Tensor]]:
        """Returns a result in its plain form, or says what is wrong with it."""
        if self._is_plain and tuple(result[1]) == self._names and _are_plain(num_envs, result[0], *result[1].values()):
            return result
        if not isinstance(result, tuple) or len(result) != 2 or not isinstance(result[1], dict):
            found = f"expected two results, the total reward and a dictionary of components, found {_kind(result)}"
            raise CodeError("return", found, self.line)
        self._check_tensor(result[0], "total reward")
        for name, value in result[1].items():
            if not isinstance(name, str):
                raise CodeError("return", f"expected component names to be text, found {_kind(name)}", self.line)
            self._check_tensor(value, "component", name)
        total, components = self._plain(result, num_envs)
        if len(components) != len(result[1]) or not 0 < len(components) <= MAX_COMPONENTS:
            found = f"expected 1 to {MAX_COMPONENTS} components with distinct names, found {', '.join(result[1])}"
            raise CodeError("names", found, self.line)
        for name, value in components.items():
            self._check_vector(num_envs, value, "component", name)
        self._check_vector(num_envs, total, "total reward")
        same = all(result[1].get(name) is value for name, value in components.items())
        self._names = tuple(components)
        self._is_plain = same and total is result[0]
        return total, components

    def _plain(self, result: Any, num_envs: int) -> tuple[Tensor, dict[str, Tensor]]:
        """Returns floats under plain names; a component that is one number stands for every environment."""
        total, components = result
        return _float(total), {
            plain_name(name): _float(value if value.dim() else value.expand(num_envs))
            for name, value in components.items()
        }


class MappingFunction(_Function[tuple[list[Tensor], list[bool], list[str]]]):
    """A compiled mapping: the progress variables, (num_envs,) each and float32, their directions and their names."""

    _list_results = staticmethod(list_progress)

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

    def _look(self, result: Any, num_envs: int) -> tuple[list[Tensor], list[bool], list[str]]:
        """Returns a result in its plain form, or says what is wrong with it."""
        if self._is_plain and result[1:] == (self._flags, self._names) and _are_plain(num_envs, *result[0]):
            return result
        if not isinstance(result, tuple) or len(result) != 3:
            found = f"expected three lists, progress variables, directions and names, found {_kind(result)}"
            raise CodeError("return", found, self.line)
        values, flags, names = map(_list, result)
        if not len(values) == len(flags) == len(names) or not 0 < len(values) <= MAX_NAMES:
            found = (
                f"expected three lists of one length, 1 to {MAX_NAMES}, found {len(values)} progress variables,"
                f" {len(flags)} directions and {len(names)} names"
            )
            raise CodeError("return", found, self.line)
        if not all(isinstance(flag, bool) for flag in flags) or not all(isinstance(name, str) for name in names):
            raise CodeError("return", "expected directions to be True or False and names to be text", self.line)
        for name, value in zip(names, values, strict=True):
            self._check_tensor(value, "progress variable", name)
        progress, self._flags, self._names = self._plain(result, num_envs)
        if len(set(self._names)) != len(names):
            found = f"expected distinct names of progress variables, found {', '.join(self._names)}"
            raise CodeError("names", found, self.line)
        for name, value in zip(self._names, progress, strict=True):
            self._check_vector(num_envs, value, "progress variable", name)
        same = all(x is y for x, y in zip(progress, values, strict=True))
        self._is_plain = same and self._names == names and all(isinstance(part, list) for part in result)
        return progress, self._flags, self._names

    def _plain(self, result: Any, num_envs: int) -> tuple[list[Tensor], list[bool], list[str]]:
        """Returns lists, also where one value stands alone, of floats and of plain names."""
        values, flags, names = map(_list, result)
        return [_float(value) for value in values], flags, [plain_name(name) for name in names]


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


def _as_it_is(result: Any) -> Any:
    return result


def _nothing(variables: Mapping[str, Any]) -> tuple[()]:
    del variables
    return ()


def _are_plain(num_envs: int, *values: Tensor) -> bool:
    """Returns whether each is (num_envs,) and float32; what came so once is of tensors ever after."""
    for value in values:  # three questions that cost less than one for the shape
        if value.dtype is not torch.float32 or value.dim() != 1 or value.numel() != num_envs:
            return False
    return True


def _float(value: Tensor) -> Tensor:
    return value if value.dtype is torch.float32 else value.to(torch.float32)


def _list(part: Any) -> list[Any]:
    return list(part) if isinstance(part, list | tuple) else [part]


def _kind(value: Any) -> str:
    if isinstance(value, tuple | list):
        return f"{len(value)} values ({', '.join(_kind(part) for part in value[:5])})"
    return {"Tensor": "one tensor"}.get(type(value).__name__, type(value).__name__)


def _shape(value: Tensor, num_envs: int) -> str:
    parts = ["num_envs" if n == num_envs else str(n) for n in value.shape]
    return f"({', '.join(parts)}{',' if len(parts) == 1 else ''})"
