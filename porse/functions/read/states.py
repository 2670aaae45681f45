"""Real states of a task in a file: safetensors for the tensors, its JSON metadata for plain values.

Written once by the stage that validates, read by the probe. The same values give the same bytes.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor

from porse.errors import TaskError
from porse.identity import canonical_json
from porse.variables import Variable


def save_states(path: Path, values: Mapping[str, Tensor | int | float | torch.device]) -> None:
    """Writes the values of all variables of a task, tensors of shape (num_envs, ...)."""
    tensors = {name: value.detach().cpu().contiguous() for name, value in values.items() if isinstance(value, Tensor)}
    scalars: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, torch.device):
            scalars[name] = "cpu"
        elif not isinstance(value, Tensor):
            scalars[name] = value
    save_file(tensors, path, metadata={"scalars": canonical_json(scalars)})


def load_states(path: Path, variables: Sequence[Variable]) -> dict[str, Any]:
    """Returns the value of each variable by name, on the CPU.

    Raises:
        TaskError: a declared variable is not in the file.
    """
    import json

    with safe_open(path, framework="pt", device="cpu") as file:
        scalars = json.loads((file.metadata() or {}).get("scalars", "{}"))
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (safe_open is no mapping)
    values: dict[str, Any] = {}
    for variable in variables:
        if variable.kind == "device":
            values[variable.name] = torch.device("cpu")
        elif variable.name in tensors:
            values[variable.name] = tensors[variable.name]
        elif variable.name in scalars:
            values[variable.name] = {"int": int, "float": float}[variable.kind](scalars[variable.name])
        else:
            raise TaskError(
                f"expected the variable {variable.name} in the states file {path.name}, found"
                f" {', '.join(sorted([*tensors, *scalars]))}; write the file again with save_states"
            )
    return values


def of_environments(values: Mapping[str, Any], count: int) -> dict[str, Any]:
    """Returns the variables of so many environments: the same states again and again."""
    index = torch.arange(count) % values["num_envs"]
    return {n: v[index] if isinstance(v, Tensor) else v for n, v in values.items()} | {"num_envs": count}
