"""A training as arrays, and back: what of PPO goes into a checkpoint."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from rsl_rl.algorithms import PPO
from torch import Tensor

from porse.checkpoint import Checkpoint
from porse.errors import CheckpointError


def arrays(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, NDArray[np.generic]]:
    """Returns tensors as arrays below `prefix.`."""
    return {f"{prefix}.{name}": value.detach().cpu().numpy() for name, value in tensors.items()}


def tensors(checkpoint: Checkpoint, part: str) -> dict[str, Tensor]:
    """Returns the arrays of a part of a checkpoint as tensors of their own."""
    return {name: torch.from_numpy(np.array(array)) for name, array in checkpoint.part(part).items()}


def policy_arrays(ppo: PPO) -> dict[str, NDArray[np.generic]]:
    """Returns actor and critic, with their observation statistics."""
    return arrays(ppo.actor.state_dict(), "actor") | arrays(ppo.critic.state_dict(), "critic")


def load_policy(ppo: PPO, checkpoint: Checkpoint, where: Path) -> None:
    """Puts a file's policy into `ppo`.

    Raises:
        CheckpointError: the networks have other names or shapes than the parameters ask for.
    """
    try:
        ppo.actor.load_state_dict(tensors(checkpoint, "actor"))
        ppo.critic.load_state_dict(tensors(checkpoint, "critic"))
    except RuntimeError as error:
        raise CheckpointError(
            f"expected the networks of params.yaml (train.hidden) and of the task, found others in {where}: {' '.join(str(error).split())}; run `porse repro`"
        ) from error


def optimizer_arrays(ppo: PPO) -> dict[str, NDArray[np.generic]]:
    """Returns Adam's state by dotted name: `optimizer.<parameter>.<step|exp_avg|exp_avg_sq>`."""
    state: dict[int, dict[str, Tensor]] = ppo.optimizer.state_dict()["state"]
    named = {f"{index}.{name}": value for index, entry in state.items() for name, value in entry.items()}
    return arrays(named, "optimizer")


def load_optimizer(ppo: PPO, checkpoint: Checkpoint) -> None:
    """Puts a checkpoint's Adam state and learning rate into `ppo`.

    Raises:
        ValueError: the state is not of these networks.
    """
    state: dict[int, dict[str, Tensor]] = {}
    for key, value in tensors(checkpoint, "optimizer").items():
        index, name = key.split(".")
        state.setdefault(int(index), {})[name] = value
    weights = [weight for group in ppo.optimizer.param_groups for weight in group["params"]]
    found = {index: {name: tuple(value.shape) for name, value in entry.items()} for index, entry in state.items()}
    for place, weight in enumerate(weights):
        shape = tuple(weight.shape)
        if found.pop(place, None) != {"step": (), "exp_avg": shape, "exp_avg_sq": shape}:
            raise ValueError(f"the optimizer's state of weight {place} is not of the shape {shape}")
    if found:
        raise ValueError(f"the optimizer's state of weight {min(found)} is of no weight")
    rate = float(checkpoint.scalars["learning_rate"])
    groups = [{**group, "lr": rate} for group in ppo.optimizer.state_dict()["param_groups"]]
    ppo.optimizer.load_state_dict({"state": state, "param_groups": groups})
    ppo.learning_rate = rate


def same_names(found: Mapping[str, Tensor], wanted: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
    """Returns `found`.

    Raises:
        ValueError: its names are not those of `wanted`.
    """
    differ = sorted(found.keys() ^ wanted.keys())
    if differ:
        raise ValueError(f"{', '.join(differ)} are in one of the two alone")
    return found
