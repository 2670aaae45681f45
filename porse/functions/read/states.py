"""Real states of a task, as a message holds them, and of as many environments as are wanted."""

from base64 import b64decode, b64encode
from collections.abc import Mapping
from typing import Any

import torch
from safetensors.torch import load, save
from torch import Tensor


def packed(values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the values of all variables of a task as JSON: plain values by name, and safetensors for the tensors."""
    tensors = {name: value.contiguous() for name, value in values.items() if isinstance(value, Tensor)}
    plain = {name: str(value) if isinstance(value, torch.device) else value for name, value in values.items()}
    return {"plain": plain | dict.fromkeys(tensors), "tensors": b64encode(save(tensors)).decode()}


def unpacked(held: Mapping[str, Any]) -> dict[str, Any]:
    """Returns what `packed` was given, in its order."""
    plain = {name: _plain(value) for name, value in held["plain"].items()}
    return plain | load(b64decode(held["tensors"]))


def _plain(value: Any) -> Any:
    """Returns a plain value as it was before it was JSON, which has neither devices nor tuples."""
    if isinstance(value, str):
        return torch.device(value)
    return tuple(value) if isinstance(value, list) else value


def of_environments(values: Mapping[str, Any], count: int) -> dict[str, Any]:
    """Returns the variables of so many environments: the same states again and again."""
    index = torch.arange(count) % values["num_envs"]
    return {n: v[index] if isinstance(v, Tensor) else v for n, v in values.items()} | {"num_envs": count}
