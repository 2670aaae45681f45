"""Real states of a task in a file: safetensors for the tensors, its JSON metadata for plain values.

Written once by the stage that validates, read by the probe. The same values give the same bytes.
"""

import json
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


def save_states(path: Path, values: Mapping[str, Tensor | int | float | tuple[int, ...] | torch.device]) -> None:
    """Writes the values of all variables of a task, tensors of shape (num_envs, ...); the device is always the CPU."""
    tensors = {name: value.detach().cpu().contiguous() for name, value in values.items() if isinstance(value, Tensor)}
    scalars = {name: value for name, value in values.items() if isinstance(value, int | float | tuple)}
    save_file(tensors, path, metadata={"scalars": canonical_json(scalars)})


def load_states(path: Path, variables: Sequence[Variable]) -> dict[str, Any]:
    """Returns the value of each variable by name, on the CPU.

    Raises:
        TaskError: a declared variable is not in the file.
    """
    with safe_open(path, framework="pt", device="cpu") as file:
        found: dict[str, Any] = json.loads((file.metadata() or {}).get("scalars", "{}"))
        found = {name: tuple(value) if isinstance(value, list) else value for name, value in found.items()}
        found |= {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (safe_open is no mapping)
    devices = {v.name: torch.device("cpu") for v in variables if v.kind == "device"}
    for variable in variables:
        if variable.name not in found and variable.name not in devices:
            raise TaskError(
                f"expected the variable {variable.name} in the states file {path.name}, found"
                f" {', '.join(sorted(found))}; write the file again with save_states"
            )
    return {v.name: devices[v.name] if v.name in devices else found[v.name] for v in variables}


def of_environments(values: Mapping[str, Any], count: int) -> dict[str, Any]:
    """Returns the variables of so many environments: the same states again and again."""
    index = torch.arange(count) % values["num_envs"]
    return {n: v[index] if isinstance(v, Tensor) else v for n, v in values.items()} | {"num_envs": count}
