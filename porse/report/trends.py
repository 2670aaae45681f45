"""How the weights of winners move over the iterations (table 18 of the paper), and fitness along their trainings (figure 6)."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from porse import tables
from porse.config import Params
from porse.outdated import params_of_run
from porse.report.agreement import check_epochs
from porse.report.figures import mean_and_deviation
from porse.search.schedule import DRAW, is_searched, mutants, varied
from porse.tables import Row

GROUPED = ("task", "method", "ablation", "variant")
"""What runs that differ by their seeds alone have in common."""


@dataclass(frozen=True)
class Finished:
    """One finished run.

    Attributes:
        params: what it was made with.
        variant: names what its parameters differ in beside task, method, ablation and seed; empty for nothing.
        iterations: rows of its iterations table.
        curves: rows of its curves table.
    """

    params: Params
    variant: str
    iterations: Sequence[Row]
    curves: Sequence[Row]


def read_finished(folder: Path, variant: str = "") -> Finished:
    """Returns the finished run in `folder`.

    Raises:
        ParamsError: there are no parameters, or they are wrong.
        TableError: a table is missing or is not as declared, or the two do not agree.
    """
    results = folder / "results"
    params = params_of_run(folder)
    iterations = tables.read(results / "iterations.parquet", tables.ITERATIONS)
    curves = tables.read(results / "curves.parquet", tables.CURVES)
    check_epochs(iterations, curves, str(results))
    return Finished(params, variant, iterations, curves)


def trend(run: Finished) -> list[dict[str, Any]]:
    """Returns, for each iteration whose mutants vary beta or alpha, which of them, and its value in the winner."""
    found = []
    for row in run.iterations:
        n = row["iteration"]
        kind = varied(run.params, n)
        if is_searched(run.params, n) and mutants(run.params, n) and kind != DRAW:
            found.append({"iteration": n, "varied": kind, "value": row[kind]})
    return found


def trends(runs: Iterable[Finished]) -> list[dict[str, Any]]:
    """Returns the trends of runs, averaged over those of one task, method, ablation and variant.

    Returns:
        One row for each of these and each iteration, in the order of the runs: how many runs it is of, mean and sample
        deviation of the value (None for one run).
    """
    groups: dict[tuple[Any, ...], list[float]] = {}
    for run in runs:
        params = run.params
        for step in trend(run):
            group = (params.task, params.method, params.ablation, run.variant, step["iteration"], step["varied"])
            groups.setdefault(group, []).append(step["value"])
    names = (*GROUPED, "iteration", "varied")
    return [{**dict(zip(names, group, strict=True)), **_spread(values)} for group, values in groups.items()]


def trends_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Returns rows of `trends` as Markdown: a line for each group of runs, the iterations from left to right."""
    shown = GROUPED if any(row["variant"] for row in rows) else GROUPED[:-1]
    steps = sorted({(row["iteration"], row["varied"]) for row in rows})
    head = [*shown, "runs", *(f"{n}: {kind}" for n, kind in steps)]
    lines = [f"| {' | '.join(head)} |", f"|{' --- |' * len(head)}"]
    for group in dict.fromkeys(tuple(row[name] for name in shown) for row in rows):
        own = [row for row in rows if tuple(row[name] for name in shown) == group]
        cells = {(row["iteration"], row["varied"]): _cell(row) for row in own}
        values = [cells.get(step, "") for step in steps]
        lines.append(f"| {' | '.join([*group, str(max(row['runs'] for row in own)), *values])} |")
    return "\n".join(lines)


def winners_fitness(run: Finished) -> list[tuple[int, float]]:
    """Returns the fitness of each iteration's winner, one after the other, with the epoch counted over all of them."""
    found: list[tuple[int, float]] = []
    for row in run.iterations:
        own = [
            (point["epoch"], point["value"])
            for point in run.curves
            if point["series"] == "fitness"
            and (point["iteration"], point["candidate_id"]) == (row["iteration"], row["winner_id"])
        ]
        found += [(len(found) + number, value) for number, (_, value) in enumerate(sorted(own), 1)]
    return found


def _spread(values: Sequence[float]) -> dict[str, Any]:
    mean, deviation = mean_and_deviation(values)
    return {"runs": len(values), "mean": mean, "std": deviation}


def _cell(row: Mapping[str, Any]) -> str:
    return f"{row['mean']:.3f}" if row["std"] is None else f"{row['mean']:.3f} +- {row['std']:.3f}"
