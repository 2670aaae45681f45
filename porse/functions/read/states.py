"""Real states of a task, as a message holds them, and of as many environments as are wanted."""

from base64 import b64decode, b64encode
from collections.abc import Callable, Collection, Mapping
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
    """Returns what `packed` was given, in its order; JSON has texts and lists for devices and tuples."""
    forms: dict[type, Callable[[Any], Any]] = {str: torch.device, list: tuple}
    plain = {name: forms.get(type(value), lambda same: same)(value) for name, value in held["plain"].items()}
    return plain | load(b64decode(held["tensors"]))


def of_environments(values: Mapping[str, Any], count: int, read: Collection[str] | None = None) -> dict[str, Any]:
    """Returns the variables of so many environments: the same states again and again, of those that are `read`.

    The others are of the right sizes, and take no memory.
    """
    tensors = {n: v for n, v in values.items() if isinstance(v, Tensor)}
    index = torch.arange(count) % values["num_envs"]
    every = tensors if read is None else read
    rows = {n: v[index] if n in every else v[:1].expand(count, *v.shape[1:]) for n, v in tensors.items()}
    return {**values, **rows, "num_envs": count}
