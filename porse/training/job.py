"""What goes into the training of one candidate and what comes out of it: plain data between processes."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Job:
    """One candidate's training.

    Attributes:
        name: what reports call it, unlike any other of its pool: the candidate id.
        reward_program: its goal reward, an operator list.
        mapping_program: its mapping, an operator list.
        beta: its weight of the bonus.
        start: the policy or checkpoint to go on from.
        finish: where the checkpoint is written.
        until: the epoch to train to.
        seed: names the training's draws.
        begun: the epoch up to which an earlier part of this very training has reported; 0: this is its beginning.
    """

    name: str
    reward_program: str
    mapping_program: str
    beta: float
    start: Path
    finish: Path
    until: int
    seed: int
    begun: int = 0


@dataclass(frozen=True)
class Outcome:
    """What a training left.

    Attributes:
        rows: (epoch, series, value); none when it failed.
        failure: why it ended early, else an empty text.
        outside: whether the cause may lie outside the candidate, so that another attempt may end otherwise.
    """

    rows: list[tuple[int, str, float]]
    failure: str
    outside: bool = False


@dataclass(frozen=True)
class Report:
    """One epoch of one candidate is done."""

    name: str
    epoch: int
    fitness: float


@dataclass(frozen=True)
class Ended:
    """The training of one candidate has ended, well or not."""

    name: str
    outcome: Outcome


Tell = Callable[[Report | Ended], None]
"""Is told what happens, while it happens."""
