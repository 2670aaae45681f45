"""The rules that give a task of one's own its numbers. The presets of the package keep those about lengths, too.

cpu:

- An epoch is 4096 steps: 16 in each of 256 environments; 32 in 128 where an episode is longer than 320 steps, 64 in 64
  where it is longer than 1280.
- A rung holds at least one whole episode, and at least 12 epochs.
- A short training in the search of alpha holds a whole episode, too.
- Candidates are ranked over the epochs that hold a whole episode, at least 10. The model is shown all that was trained at
  half time: three rungs.
- Returns look 100 steps ahead (gamma 0.99); 25 where an episode is shorter than 100 (gamma 0.96).
- The networks grow with what they read and write, observations and actions together: 64-64 up to 40 numbers, 128-128 up to
  160, 256-256-128 above.

paper: the same lengths in terms of the paper's: rungs of 500 epochs, as the original learners have them: 16 steps in each of
4096 environments in batches of 16 384, and networks of 256-128-64 up to 160 numbers, 512-256-128 above.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

FEWEST_RANKED = 10
"""Epochs that a mean fitness is taken over at least."""

RUNGS_TO_HALF_TIME = 3


@dataclass(frozen=True)
class Sizes:
    """What the rules go by.

    Attributes:
        episode: control steps of the longest episode.
        observations: width of an observation.
        actions: width of an action.
    """

    episode: int
    observations: int
    actions: int


def values_by_rule(size: str, sizes: Sizes) -> Mapping[str, Mapping[str, Any]]:
    """Returns the values of a preset, by section and key."""
    train = _cpu(sizes) if size == "cpu" else _paper(sizes)
    train["gamma"] = 0.96 if sizes.episode < 100 else 0.99
    held = math.ceil(sizes.episode / train["steps_per_epoch"])
    train["rung_epochs"] = max(train["rung_epochs"], held)
    return {
        "train": train,
        "probe": {"least_epochs": held},
        "eliminate": {"window": max(FEWEST_RANKED, held)},
        "mutate": {"window": RUNGS_TO_HALF_TIME * train["rung_epochs"]},
    }


def _cpu(sizes: Sizes) -> dict[str, Any]:
    numbers = sizes.observations + sizes.actions
    steps = 16 if sizes.episode <= 320 else 32 if sizes.episode <= 1280 else 64
    return {
        "rung_epochs": 12,
        "num_envs": 4096 // steps,
        "steps_per_epoch": steps,
        "hidden": [64, 64] if numbers <= 40 else [128, 128] if numbers <= 160 else [256, 256, 128],
        "init_std": 1.0,
        "normalise_observations": True,
        "learning_rate": 0.001,
        "desired_kl": 0.016,
        "value_coefficient": 1.0,
        "passes": 4,
        "minibatches": 4,
    }


def _paper(sizes: Sizes) -> dict[str, Any]:
    return {
        "rung_epochs": 500,
        "num_envs": 4096,
        "steps_per_epoch": 16,
        "hidden": [256, 128, 64] if sizes.observations + sizes.actions <= 160 else [512, 256, 128],
        "init_std": 1.0,
        "normalise_observations": True,
        "learning_rate": 0.0005,
        "desired_kl": 0.016,
        "value_coefficient": 1.0,
        "passes": 5,
        "minibatches": 4,
    }
