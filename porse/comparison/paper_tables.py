"""Our runs in the form of the paper's tables, its values beside them, as Markdown: pure functions over the rows of evidence."""

from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from statistics import fmean

from porse.comparison.evidence import Evidence
from porse.comparison.evidence import Line as Row
from porse.comparison.forms import mean_text
from porse.report import paper
from porse.report.answer import figure
from porse.report.figures import method_label, spread

AUTHORS = {"model": "a language model", "grammar": "the grammar", "files": "people", "nobody": "nobody"}
"""Who writes a run's functions, in words."""

Name = tuple[str, str]
"""A method and an ablation."""

Published = Mapping[Name, paper.Value]
"""One task's values in a table of the paper."""

Ours = Mapping[tuple[str, ...], Sequence[Row]]
"""Runs by method and ablation."""

_PORSE = ("porse", "none")
_ABLATIONS = (1, 2)
"""The tables that the performance drops of table 16 follow from."""
_DROPS, _WEIGHTS = 16, 18
_NOT_RUN = "not run"


def paper_tables(found: Evidence) -> Iterator[tuple[int, str]]:
    """Yields the number and the lines of each table of the paper that has a task and a method of ours, in its order.

    A task has a row for each author of functions. Runs without functions stand in all of them.
    """
    plain = [row for row in found.runs if not row["variant"]]
    tables = _published()
    drops = {task: names for number in _ABLATIONS for task, names in tables.get(number, {}).items()}
    made = {number: _table(tasks, plain, _beside) for number, tasks in tables.items()}
    made[_DROPS] = _table(drops, plain, _drop_beside)
    made[_WEIGHTS] = _weights(plain, found.winners)
    yield from ((number, lines) for number, lines in sorted(made.items()) if lines)


def tables_without_a_task(found: Evidence) -> Mapping[int, Sequence[str]]:
    """Returns the tasks of each table of MTS that has none on which a run of the evidence is, by the table's number."""
    ours = {row["task"] for row in found.runs}
    return {number: [*tasks] for number, tasks in sorted(_published().items()) if not ours & {*tasks}}


def mean_of(name: str, rows: Sequence[Row]) -> str:
    """Returns the mean of a column, with its deviation where there are several values; empty for a column without any."""
    found = spread(name, [float(row[name]) for row in rows if row[name]])
    mean = found[f"{name}_mean"]
    return "" if mean is None else mean_text(mean, found[f"{name}_std"])


def grouped(rows: Sequence[Row], names: Sequence[str]) -> dict[tuple[str, ...], list[Row]]:
    """Returns rows by their values in some columns, in the order in which these come first."""
    found: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        found.setdefault(tuple(row[name] for name in names), []).append(row)
    return found


def table_of(names: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Returns a table with these columns and cells."""
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (names, ["---"] * len(names), *lines))


def _published() -> dict[int, dict[str, dict[Name, paper.Value]]]:
    tables: dict[int, dict[str, dict[Name, paper.Value]]] = {}
    for (number, task, method, ablation), value in paper.maximum_training_success().items():
        tables.setdefault(number, {}).setdefault(task, {})[method, ablation] = value
    return tables


def _table(
    tasks: Mapping[str, Published], runs: Sequence[Row], cell: Callable[[Name, Ours, Published], str | None]
) -> str:
    """Returns a table of tasks by methods, without rows in which nothing was run; empty where that leaves none.

    Args:
        tasks: the paper's values by task.
        runs: ours, without variants.
        cell: returns a cell's text; None in all rows leaves the column out.
    """
    found = [
        (task, author, {name: cell(name, ours, names) for name in names})
        for task, names in tasks.items()
        for author, ours in _by_author([row for row in runs if row["task"] == task], names)
    ]
    rows = [row for row in found if any(text and not text.startswith(_NOT_RUN) for text in row[2].values())]
    if not rows:
        return ""
    names = dict.fromkeys(name for *_, cells in rows for name in cells)
    shown = [name for name in names if any(cells.get(name) for *_, cells in rows)]
    lines = [[task, AUTHORS[author], *(cells.get(name) or "" for name in shown)] for task, author, cells in rows]
    return table_of(["task", "functions by", *(method_label(*name) for name in shown)], lines)


def _by_author(runs: Sequence[Row], names: Container[Name]) -> Iterator[tuple[str, Ours]]:
    """Yields each author among the runs of some methods and ablations, and by these the runs beside which it stands."""
    own = [row for row in runs if (row["method"], row["ablation"]) in names]
    writers = dict.fromkeys(row["author"] for row in own if row["author"] != "nobody")
    for author in writers or dict.fromkeys(row["author"] for row in own):
        yield author, grouped([row for row in own if row["author"] in (author, "nobody")], ("method", "ablation"))


def _beside(name: Name, ours: Ours, published: Published) -> str:
    own, value = ours.get(name), published.get(name)
    measured = f"{mean_of('mts', own)}, n = {len(own)}" if own else _NOT_RUN
    return measured + (f"; paper {mean_text(value.mean, value.std)}" if value else "")


def _drop_beside(name: Name, ours: Ours, published: Published) -> str | None:
    """Returns by how much an ablation is behind PoRSE, ours and the paper's; None for PoRSE itself."""
    if name == _PORSE:
        return None
    own, full = ([float(row["mts"]) for row in ours.get(each, ())] for each in (name, _PORSE))
    measured = _drop(fmean(own), fmean(full)) if own and full else _NOT_RUN
    return f"{measured}; paper {_drop(published[name].mean, published[_PORSE].mean)}"


def _drop(mts: float, full: float) -> str:
    """Returns what PoRSE's MTS loses, as a share of it: 0.6 instead of 0.8 is 25 %, and so is -1 instead of -0.8."""
    return f"{(full - mts) / abs(full):.1%}".replace("%", " %") if full else "undefined"


def _weights(runs: Sequence[Row], winners: Sequence[Row]) -> str:
    """Returns what PoRSE's winners have of that which the mutants of their iteration vary: beta, then alpha, in turn."""
    published = paper.winners_weights()
    own = [row for row in runs if (row["method"], row["ablation"]) == _PORSE]
    steps = list(dict.fromkeys((n, kind) for _, n, kind in published))
    lines = []
    for (task, author), rows in grouped(own, ("task", "author")).items():
        entries = {(row["suite"], row["entry"]) for row in rows}
        weights = [row for row in winners if (row["suite"], row["entry"]) in entries]
        cells = []
        for n, kind in steps:
            at = [row for row in weights if int(row["iteration"]) == n]
            value = published.get((task, n, kind))
            measured = mean_of(kind, at) if at else _NOT_RUN
            cells.append(measured if value is None else f"{measured}; paper {figure(value)}")
        if any((task, *step) in published for step in steps):
            lines.append([task, AUTHORS[author], str(len(rows)), *cells])
    return table_of(["task", "functions by", "runs", *(f"{n}: {kind}" for n, kind in steps)], lines) if lines else ""
