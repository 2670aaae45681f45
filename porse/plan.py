"""The stages of a run in their order, with the epochs that each trains: for progress, and for nothing that is tracked."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from porse.config import Params
from porse.search.schedule import work


@dataclass(frozen=True)
class Planned:
    """A stage of the pipeline.

    Attributes:
        name: as `dvc repro` takes it: "resolve", "iterations/2/dvc.yaml:fuse".
        label: what its progress bar is called; empty where it trains nothing.
        epochs: epochs that it trains, over all candidates.
    """

    name: str
    label: str = ""
    epochs: int = 0


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
            label = f"iteration {entry.n} rung {rung.rung}"
            yield Planned(f"{where}train-population-{rung.rung}", label, costs.get(str(rung.rung), 0))
            yield Planned(f"{where}eliminate-{rung.rung}")
            if params.mutate.pool == f"eliminate-{rung.rung}":
                yield Planned(f"{where}mutate")
        yield Planned(f"{where}fuse")
    yield from (Planned("evaluate"), Planned("summarise"))


def write_plan(path: Path, params: Params) -> None:
    """Writes what a progress bar needs to know of the rest of the run (`porse.training.bar`)."""
    stages = planned(params)
    total, before, rungs = sum(stage.epochs for stage in stages), 0, {}
    for number, stage in enumerate(stages, 1):
        before += stage.epochs
        if stage.label:
            rungs[stage.label] = {"stage": number, "epochs_after": total - before}
    names = [stage.name for stage in stages]
    path.write_text(
        json.dumps({"names": names, "stages": len(stages), "epochs": total, "rungs": rungs}), encoding="utf-8"
    )
