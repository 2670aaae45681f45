"""Variables, states and small sources that the tests of generated code share."""

import ast
from collections.abc import Mapping, Sequence
from typing import Any

import torch

from porse.functions.read.check import check_source
from porse.functions.read.extract import Source, extract
from porse.functions.read.trace import trace
from porse.functions.run.execute import Function
from porse.functions.run.program import Program
from porse.functions.verdict import Kind
from porse.variables import Variable


def variable(name: str, *shape: int, kind: str = "tensor") -> Variable:
    """Returns a variable of which only name, kind and shape matter."""
    return Variable(name, kind, shape, "1", "world", "for a test")  # type: ignore[arg-type]


VARIABLES = [
    variable("a", 3),
    variable("b", 3),
    variable("q", 4),
    variable("bodies", 5, 13),
    variable("steps"),
    variable("scale", kind="float"),
    variable("handle", kind="int"),
    variable("num_envs", kind="int"),
    variable("device", kind="device"),
]
"""Small names for tests that are about the language and not about a task."""


def lines_of(source: Source) -> list[int]:
    """Returns the line of the reply of every statement of a source."""
    return sorted(node.lineno for node in ast.walk(source.tree) if isinstance(node, ast.stmt))


def values(rows: int = 16, variables: Sequence[Variable] = VARIABLES, seed: int = 0) -> dict[str, Any]:
    """Returns states drawn at random: uniform in (-1, 1), unit quaternions for shape (4,), counts for `steps`."""
    generator = torch.Generator().manual_seed(seed)
    plain: dict[str, Any] = {"int": 2, "float": 0.5, "device": torch.device("cpu")}
    drawn: dict[str, Any] = {}
    for v in variables:
        tensor = 2.0 * torch.rand(rows, *v.shape, generator=generator) - 1.0
        unit = tensor / torch.linalg.vector_norm(tensor, dim=-1, keepdim=True) if v.shape == (4,) else tensor
        drawn[v.name] = tuple(range(v.shape[0])) if v.kind == "tuple" else plain.get(v.kind, unit)
    for name in ("steps", "progress_buf"):
        if name in drawn:
            drawn[name] = torch.arange(rows)
    return drawn | {"num_envs": rows}


def reward(*body: str, arguments: str = "a, b", result: str = 'x, {"x": x}') -> str:
    """Returns the source of a reward with these lines as its body."""
    lines = "".join(f"    {line}\n" for text in body for line in text.split("\n"))
    return f"def compute_reward({arguments}):\n{lines}    return {result}\n"


def traced(source: str, kind: Kind, variables: Sequence[Variable], states: Mapping[str, Any] | None = None) -> Program:
    """Returns the operator list of a source, checked and traced in this process, on drawn states or on some given."""
    parsed = extract(source, kind)
    check_source(parsed, {v.name for v in variables})
    return trace(parsed, kind, states if states is not None else values(16, variables))


class RewardFunction(Function):
    """A reward that returns its total, and its components by name."""

    def __init__(self, text: str, portable: bool) -> None:
        super().__init__(text, "reward", portable)

    def __call__(self, variables: Mapping[str, Any]) -> Any:
        total, *components = super().__call__(variables)
        return total, dict(zip(self.names, components, strict=True))


class MappingFunction(Function):
    """A mapping that returns its progress variables, their directions and their names."""

    def __init__(self, text: str, portable: bool) -> None:
        super().__init__(text, "mapping", portable)

    def __call__(self, variables: Mapping[str, Any]) -> Any:
        return super().__call__(variables), list(self.rises), list(self.names)


def compile_reward(
    source: str, variables: Sequence[Variable], portable: bool, states: Mapping[str, Any] | None = None
) -> RewardFunction:
    """Returns the reward of a source, traced in this process."""
    return RewardFunction(traced(source, "reward", variables, states).text, portable)


def compile_mapping(
    source: str, variables: Sequence[Variable], portable: bool, states: Mapping[str, Any] | None = None
) -> MappingFunction:
    """Returns the mapping of a source, traced in this process."""
    return MappingFunction(traced(source, "mapping", variables, states).text, portable)
