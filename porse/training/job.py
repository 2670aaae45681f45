"""What goes into the training of one candidate and what comes out of it: plain data between processes."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Job:
    """One candidate's training.

    Attributes:
        name: what progress reports call it: the candidate id.
        reward_program: its goal reward, an operator list.
        mapping_program: its mapping, an operator list.
        beta: its weight of the bonus.
        start: the policy or checkpoint to go on from.
        finish: where the checkpoint is written.
        until: the epoch to train to.
        seed: names the training's draws.
    """

    name: str
    reward_program: str
    mapping_program: str
    beta: float
    start: Path
    finish: Path
    until: int
    seed: int


@dataclass(frozen=True)
class Outcome:
    """What a training left: rows (epoch, series, value), and why it ended early, else an empty text."""

    rows: list[tuple[int, str, float]]
    failure: str


@dataclass(frozen=True)
class Report:
    """One epoch of one candidate is done."""

    name: str
    epoch: int
    fitness: float
