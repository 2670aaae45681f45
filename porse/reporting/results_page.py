"""The page of all suites' results, from the tables that Git tracks: `python -m porse.reporting.results_page docs`."""

import math
from collections.abc import Container, Iterator, Mapping, Sequence
from pathlib import Path

import click

from porse.report import paper
from porse.report.charts import Chart
from porse.report.figures import method_label, spread
from porse.report.svg import svg
from porse.reporting.compare import label_of, line_over
from porse.reporting.evidence import Evidence, read_evidence
from porse.reporting.evidence import Line as Row
from porse.reporting.forms import mean_text
from porse.reporting.reliable import Estimate, interquartile_mean, probability_of_improvement

PAGE, FOLDER = "compared.md", "results"

_AUTHORS = {"model": "a language model", "grammar": "the grammar", "files": "people", "nobody": "nobody"}

_HEAD = """# Methods beside each other, in figures

`python -m porse.reporting.results_page docs` writes this page from two tables; do not edit it. [Results](results.md) says in words
what holds.

```sh
porse suite run suites/NAME.yaml
python -m porse.reporting.evidence suites/NAME.yaml docs/results
python -m porse.reporting.results_page docs
```

compute a suite, add its finished runs to [runs.csv](results/runs.csv) and [winners.csv](results/winners.csv), and write this page.
Every finished run of a suite is in the tables. The second command also says whether a run that already stands there was
computed again with the same bits.

*MTS* is the maximum training success, the highest fitness of an epoch, and *IQM* its interquartile mean over the seeds: the mean
of the middle half. *Better* is the probability that a run of PoRSE from the same suites has a higher MTS than a run of this row.
Intervals hold 95 %, by bootstrap over the seeds. *Score* is the winner's mean fitness over its last epochs, which ranks trainings.
*Final* is what the winner's mean action is worth in whole episodes. *Valid* is the share of functions that passed every check.
"""


def page(found: Evidence) -> tuple[str, Mapping[str, str]]:
    """Returns the page as Markdown, and its pictures as SVG by file name.

    Args:
        found: the tables; at least one run.
    """
    parts, pictures = [_HEAD], {}
    for (suite, task), rows in _grouped(found.runs, ("suite", "task")).items():
        name = f"{suite}-{task}.svg"
        pictures[name] = svg(_chart(task, rows, found.winners))
        parts.append(
            f"## {suite}: {task}\n\n{_authors(rows)}\n\n{_table(rows, _baseline(found.runs, rows[0]))}\n\n"
            f"![MTS so far by iteration: mean over seeds, in a band from the least to the greatest]({FOLDER}/{name})"
        )
    parts.append(
        "# In the form of the paper's tables\n\nMTS, mean and deviation over the seeds. The paper's budget is 90 000 epochs a run."
    )
    parts += [f"## Table {number}\n\n{lines}" for number, lines in _paper_tables(found.runs)]
    return "\n\n".join(part.rstrip() for part in parts) + "\n", pictures


def _grouped(rows: Sequence[Row], names: Sequence[str]) -> dict[tuple[str, ...], list[Row]]:
    found: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        found.setdefault(tuple(row[name] for name in names), []).append(row)
    return found


def _baseline(runs: Sequence[Row], like: Row) -> list[float]:
    """Returns the MTS of PoRSE's runs on a row's task, by the same author and with the same number of epochs."""
    same = ("task", "author", "epochs_allowed")
    return [
        float(row["mts"])
        for row in runs
        if (row["method"], row["ablation"], row["variant"]) == ("porse", "none", "")
        and all(row[name] == like[name] for name in same)
    ]


def _authors(rows: Sequence[Row]) -> str:
    named = (
        " and ".join(dict.fromkeys(_AUTHORS[row["author"]] for row in rows if row["author"] != "nobody")) or "nobody"
    )
    epochs = sorted({int(row["epochs_allowed"]) for row in rows})
    return f"{len(rows)} {'run' if len(rows) == 1 else 'runs'}; functions by {named}; at most {' or '.join(f'{count:,}' for count in epochs)} epochs each."


def _table(rows: Sequence[Row], baseline: Sequence[float]) -> str:
    lines = [
        "| method | seeds | MTS | IQM | better | score | final | epochs | valid | paper's MTS |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for own in _grouped(rows, ("method", "ablation", "variant")).values():
        first, mts = own[0], [float(row["mts"]) for row in own]
        published = None if first["variant"] else paper.find_mts(first["task"], first["method"], first["ablation"])
        is_baseline = (first["method"], first["ablation"], first["variant"]) == ("porse", "none", "")
        compared = baseline and not is_baseline
        functions = sum(int(row["functions"]) for row in own)
        cells = [
            label_of(first),
            str(len(own)),
            _mean("mts", own),
            _interval(interquartile_mean([mts])),
            _interval(probability_of_improvement([baseline], [mts])) if compared else "",
            _mean("score", own),
            _mean("success", own),
            f"{sum(int(row['epochs_spent']) for row in own) / len(own):,.0f}",
            f"{sum(int(row['valid_functions']) for row in own) / functions:.2f}" if functions else "",
            mean_text(published.mean, published.std) if published else "",
        ]
        lines.append(_cells(*cells))
    return "\n".join(lines)


def _mean(name: str, rows: Sequence[Row]) -> str:
    found = spread(name, [float(row[name]) for row in rows])
    mean = found[f"{name}_mean"]
    return "" if mean is None else mean_text(mean, found[f"{name}_std"])


def _interval(found: Estimate) -> str:
    ends = "" if found.low is None else f" ({found.low:.3g} to {found.high:.3g})"
    return f"{found.value:.3g}{ends}"


def _chart(task: str, rows: Sequence[Row], winners: Sequence[Row]) -> Chart:
    lines = []
    for own in _grouped(rows, ("method", "ablation", "variant")).values():
        at: dict[int, list[float]] = {}
        for row in own:
            best = -math.inf
            for winner in winners:
                if (winner["suite"], winner["entry"]) == (row["suite"], row["entry"]):
                    best = max(best, float(winner["mts"]))
                    at.setdefault(int(winner["iteration"]), []).append(best)
        lines.append(line_over(label_of(own[0]), at, len(own)))
    return Chart(task, "iteration", "MTS so far", lines)


def _paper_tables(runs: Sequence[Row]) -> Iterator[tuple[int, str]]:
    """Yields the number and the lines of each table of the paper that has a task and a method of ours.

    A task has a row for each author of functions. Runs without functions stand in all of them.
    """
    plain = [row for row in runs if not row["variant"]]
    tables: dict[int, dict[str, dict[tuple[str, str], paper.Value]]] = {}
    for (number, task, method, ablation), value in paper.maximum_training_success().items():
        tables.setdefault(number, {}).setdefault(task, {})[method, ablation] = value
    for number, tasks in sorted(tables.items()):
        rows = [
            (task, cells, author, ours)
            for task, cells in tasks.items()
            for author, ours in _by_author([row for row in plain if row["task"] == task], cells)
        ]
        if rows:
            names = list(dict.fromkeys(name for _, cells, _, _ in rows for name in cells))
            yield (
                number,
                "\n".join(
                    (
                        _cells("task", "functions by", *(method_label(*name) for name in names)),
                        "| --- " * (len(names) + 2) + "|",
                        *(
                            _cells(
                                task, _AUTHORS[author], *(_beside(ours.get(name), cells.get(name)) for name in names)
                            )
                            for task, cells, author, ours in rows
                        ),
                    )
                ),
            )


def _by_author(
    runs: Sequence[Row], names: Container[tuple[str, str]]
) -> Iterator[tuple[str, Mapping[tuple[str, ...], Sequence[Row]]]]:
    """Yields each author among the runs of some methods and ablations, and by these the runs beside which it stands."""
    own = [row for row in runs if (row["method"], row["ablation"]) in names]
    writers = dict.fromkeys(row["author"] for row in own if row["author"] != "nobody")
    for author in writers or dict.fromkeys(row["author"] for row in own):
        yield author, _grouped([row for row in own if row["author"] in (author, "nobody")], ("method", "ablation"))


def _cells(*texts: str) -> str:
    return f"| {' | '.join(texts)} |"


def _beside(own: Sequence[Row] | None, value: paper.Value | None) -> str:
    measured = f"{_mean('mts', own)}, n = {len(own)}" if own else "not run"
    return measured + (f"; paper {mean_text(value.mean, value.std)}" if value else "")


@click.command()
@click.argument("docs", type=click.Path(exists=True, file_okay=False, path_type=Path))
def main(docs: Path) -> None:
    """Write the page of results to the folder DOCS, and its pictures to DOCS/results, from the tables there."""
    text, pictures = page(read_evidence(docs / FOLDER))
    (docs / PAGE).write_text(text, encoding="utf-8")
    for name, picture in pictures.items():
        (docs / FOLDER / name).write_text(picture, encoding="utf-8")


if __name__ == "__main__":
    main()
