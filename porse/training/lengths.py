"""How long episodes last: the series `episode_length`."""

import torch
from torch import Tensor


class EpisodeLengths:
    """Mean length of the episodes that end in one epoch."""

    def __init__(self) -> None:
        self._steps: int | Tensor = 0
        self._episodes: int | Tensor = 0

    def add(self, lengths: Tensor, ends: Tensor) -> None:
        """Adds the episodes that ended.

        Args:
            lengths: steps of the running episodes, int64 `(num_envs,)`.
            ends: which of them ended, bool `(num_envs,)`.
        """
        self._steps = self._steps + torch.where(ends, lengths, 0).sum()
        self._episodes = self._episodes + ends.sum()

    def take(self) -> dict[str, float]:
        """Returns {"episode_length": mean} and starts a new epoch; nothing where no episode ended."""
        steps, episodes = int(self._steps), int(self._episodes)
        self._steps = self._episodes = 0
        return {"episode_length": steps / episodes} if episodes else {}
