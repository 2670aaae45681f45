"""The stages of a run in their order, with the epochs that each trains: for progress, and for nothing that is tracked."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from porse.config import Params
from porse.search.lengths import rung_epochs
from porse.search.schedule import is_searched, work

EVALUATE = "evaluate"
"""The stage whose epochs are none of the search's."""


@dataclass(frozen=True)
class Bar:
    """Trainings that share a progress bar.

    Attributes:
        labels: what the bar is called; one of them, where only results can tell which.
        epochs: epochs over all of them, at most.
    """

    labels: tuple[str, ...]
    epochs: int


@dataclass(frozen=True)
class Planned:
    """A stage of the pipeline.

    Attributes:
        name: as `dvc repro` takes it: "resolve", "iterations/2/dvc.yaml:fuse".
        bars: what it trains, one after the other.
    """

    name: str
    bars: tuple[Bar, ...] = ()

    @property
    def epochs(self) -> int:
        """Epochs that it trains, over all its bars."""
        return sum(bar.epochs for bar in self.bars)


def planned(params: Params) -> list[Planned]:
    """Returns all stages, in the order that they run in."""
    return [*_planned(params)]


def _planned(params: Params) -> Iterator[Planned]:
    yield from (Planned("resolve"), Planned("begin"))
    for entry in params.iterations:
        where = f"iterations/{entry.n}/dvc.yaml:"
        costs = {cost.rung: cost.epochs for cost in work(params, entry.n)}
        yield Planned(f"{where}generate")
        yield Planned(f"{where}validate-code")
        if params.mutate.pool == "validate-code":
            yield Planned(f"{where}mutate")
        for rung in params.rungs:
            bar = Bar((f"iteration {entry.n} rung {rung.rung}",), costs.get(str(rung.rung), 0))
            yield Planned(f"{where}train-population-{rung.rung}", (bar,))
            yield Planned(f"{where}eliminate-{rung.rung}")
            if params.mutate.pool == f"eliminate-{rung.rung}":
                yield Planned(f"{where}mutate")
        yield Planned(f"{where}fuse")
    yield from (Planned(EVALUATE, _links(params)), Planned("summarise"))


def _links(params: Params) -> tuple[Bar, ...]:
    """Returns the bars of the evaluation, one a link of the winning lineage, which is shorter where a winner stays."""
    epochs = params.evaluate.seeds * rung_epochs(params) * max(rung.until for rung in params.rungs)
    labels = [f"evaluation, iteration {entry.n}" for entry in params.iterations if is_searched(params, entry.n)]
    if params.fuse.policy == "random":
        # Nothing is trained on top of another: the best winner of all iterations is the whole lineage.
        return (Bar(tuple(labels), epochs),)
    return tuple(Bar((label,), epochs) for label in labels)


def write_plan(path: Path, params: Params) -> None:
    """Writes what a progress bar needs to know of the rest of the run (`porse.training.bar`)."""
    stages = planned(params)
    total, before, bars = sum(stage.epochs for stage in stages), 0, dict[str, dict[str, int]]()
    for number, stage in enumerate(stages, 1):
        for bar in stage.bars:
            before += bar.epochs
            bars |= {label: {"stage": number, "epochs_after": total - before} for label in bar.labels}
    names = [stage.name for stage in stages]
    path.write_text(
        json.dumps({"names": names, "stages": len(stages), "epochs": total, "bars": bars}), encoding="utf-8"
    )
