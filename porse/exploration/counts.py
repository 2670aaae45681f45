"""What counts over progress variables have in common: bins that grow with the values, and the bonus for what is rare."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

from torch import Tensor

from porse.exploration.bins import Growth, ProgressBins
from porse.exploration.bonus import pay_finite, rarity


class ProgressCounts(ABC):
    """Counts the visits of one candidate's states by the bins of their progress variables, and pays the bonus.

    Args:
        rises: for each progress variable, whether it rises as the task is done; a falling one is turned round.
        bins: bins of each variable.
        scale: lambda of eq. 3, the bonus of a first visit.

    Raises:
        ValueError: the joint cells are too many for an int64.
    """

    def __init__(self, rises: Sequence[bool], bins: int, scale: float) -> None:
        self.space = ProgressBins(rises, bins)
        self._scale = scale

    def bonus(self, progress: Tensor) -> Tensor:
        """Counts one step of all environments and returns their bonus.

        Args:
            progress: (num_envs, variables), the progress variables after the step. An environment with a value that is
                not finite is not counted.

        Returns:
            (num_envs,) float32, in (0, lambda]; 0 where a value is not finite.
        """
        return pay_finite(self.space.turn(progress), self._pay)

    def _pay(self, turned: Tensor) -> Tensor:
        for growth in self.space.include(turned):
            self._merge(growth)
        return rarity(self._count(self.space.indices(turned)), self._scale)

    @abstractmethod
    def _merge(self, growth: Growth) -> None:
        """Keeps the counts right after a variable's range has grown."""

    @abstractmethod
    def _count(self, indices: Tensor) -> Tensor:
        """Counts the states with these bins, (n, variables) int64, and returns each one's visits, this one included."""

    @abstractmethod
    def state(self) -> dict[str, Tensor]:
        """Returns all that a continuation needs."""

    @abstractmethod
    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes on from `state()` of another object with the same variables."""
