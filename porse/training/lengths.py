"""How long episodes last: the series `episode_length`."""

from torch import Tensor


class EpisodeLengths:
    """Mean length of the episodes that end in one epoch."""

    def __init__(self) -> None:
        self._steps = self._episodes = 0

    def add(self, lengths: Tensor) -> None:
        """Adds the lengths, in steps, of episodes that ended: `(episodes,)`, whole numbers."""
        self._steps += int(lengths.sum())
        self._episodes += len(lengths)

    def take(self) -> dict[str, float]:
        """Returns {"episode_length": mean} and starts a new epoch; nothing where no episode ended."""
        steps, episodes = self._steps, self._episodes
        self._steps = self._episodes = 0
        return {"episode_length": steps / episodes} if episodes else {}
