"""What the paper reports, as data: `mts.csv` and `weights.csv`, each value with the table that it stands in.

A value stands under our names of method and ablation. The paper's tables do not all agree: PushBlock is 0.318 in table 2 and
0.378 in table 6, DoorOpenInward 0.250 in tables 3 and 8 and 0.283 in table 6.
"""

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from porse.report.figures import human_normalised_score

SEEDS = 5
"""Each value is a mean over so many."""
EPOCHS = 90_000
"""Of a whole run, by any method."""
POLICY_EPOCHS = 3000
"""The longest training of one policy in one iteration."""
MODEL = "DeepSeek-V3"
SIMULATOR = "Isaac Gym (PhysX)"

_MAIN = (5, 6)
"""The tables that compare methods over all tasks: moderate and hard ones."""


@dataclass(frozen=True)
class Value:
    """One value of the paper.

    Attributes:
        table: the number of the table that it stands in.
        mean: over five seeds.
        std: the deviation over them; None where the paper gives none.
    """

    table: int
    mean: float
    std: float | None


@cache
def maximum_training_success() -> Mapping[tuple[int, str, str, str], Value]:
    """Returns MTS by table, task, method and ablation, in the order of the tables."""
    found = {}
    for row in _rows("mts.csv"):
        table = int(row["table"])
        std = float(row["std"]) if row["std"] else None
        found[table, row["task"], row["method"], row["ablation"]] = Value(table, float(row["mean"]), std)
    return found


@cache
def winners_weights() -> Mapping[tuple[str, int, str], float]:
    """Returns beta or alpha by task, iteration (from 1) and which of the two it is (table 18)."""
    return {(row["task"], int(row["iteration"]), row["varied"]): float(row["value"]) for row in _rows("weights.csv")}


def find_mts(task: str, method: str, ablation: str) -> Value | None:
    """Returns the MTS of a task: that of the tables over all tasks, else of the first that has one; None for none."""
    own = [value for key, value in maximum_training_success().items() if key[1:] == (task, method, ablation)]
    return next((value for value in own if value.table in _MAIN), own[0] if own else None)


def find_score(task: str, method: str, ablation: str) -> float | None:
    """Returns the human normalised score that follows from the paper's means (eq. 8); None where it is undefined."""
    own, human, sparse = (find_mts(task, *name) for name in ((method, ablation), ("human", "none"), ("sparse", "none")))
    if own is None or human is None or sparse is None:
        return None
    return human_normalised_score(own.mean, human.mean, sparse.mean)


def _rows(name: str) -> list[dict[str, str]]:
    with (Path(__file__).parent / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))
