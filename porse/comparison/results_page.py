"""The page of all suites' results, from the tables that Git tracks: `python -m porse.comparison.results_page docs`."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import click

from porse.comparison.compare import label_of, line_over, mts_so_far
from porse.comparison.evidence import Evidence, read_evidence
from porse.comparison.evidence import Line as Row
from porse.comparison.forms import mean_text
from porse.comparison.paper_tables import AUTHORS, grouped, mean_of, paper_tables, table_of, tables_without_a_task
from porse.comparison.reliable import Estimate, interquartile_mean, probability_of_improvement
from porse.methods import METHODS
from porse.report import paper
from porse.report.charts import Chart
from porse.report.svg import svg

PAGE, FOLDER = "compared.md", "results"

_HEAD = """# Methods beside each other, in figures

`python -m porse.comparison.results_page docs` writes this page from two tables; do not edit it. [Results](results.md) says in words
what holds.

```sh
porse suite run suites/NAME.yaml
python -m porse.comparison.evidence suites/NAME.yaml docs/results
python -m porse.comparison.results_page docs
```

These commands compute a suite, add its finished runs to [runs.csv](results/runs.csv) and [winners.csv](results/winners.csv), and
write this page. Every finished run of a suite is in the tables. The second command also says whether a run that already stands
there was computed again with the same bits.

*MTS* is the maximum training success, the highest fitness of an epoch, and *IQM* its interquartile mean over the seeds: the mean
of the middle half. *Better* is the probability that a run of PoRSE has a higher MTS than a run of this row. It counts PoRSE's runs of
all suites on the same task, with as many epochs allowed and functions by the same author; where nobody wrote any, by the first
author of the table. Intervals are 95 % in name, by bootstrap over the seeds, and hold less: with three seeds an interval of the IQM
is the range of the runs and covers about three quarters, with five about 90 %.

*Score* ranks trainings: the winner's mean fitness over its last epochs, but its highest fitness in the rows marked *max* (Eureka and
REvolve). So MTS compares all rows, and the score only those with the same mark. *Further MTS* is the mean MTS of the winner's
lineage with further seeds; the column is there where runs have it, which those before it was kept have not. *Final* is what the
winner's mean action is worth in whole episodes. *Valid* is the share of functions that passed every check.
"""

_FORM = """# In the form of the paper's tables

MTS, mean and deviation over the seeds. The paper's budget is 90 000 epochs a run. Table 14, which method has which part, is in
[Methods](methods.md#what-each-method-does). Table 16 follows from tables 1 and 2: by how much of PoRSE's MTS an ablation is behind
it; below zero, it is ahead. Table 18 has the beta and alpha of PoRSE's winners in the iterations in which mutants vary them; the
paper counts iterations from 0.
"""

_FURTHER = "further MTS"
_COLUMNS = ("method", "seeds", "MTS", "IQM", "better", "score", _FURTHER, "final", "epochs", "valid", "paper's MTS")


def page(found: Evidence) -> tuple[str, Mapping[str, str]]:
    """Returns the page as Markdown, and its pictures as SVG by file name.

    Args:
        found: the tables; at least one run.
    """
    parts, pictures = [_HEAD], {}
    for (suite, task), rows in grouped(found.runs, ("suite", "task")).items():
        name = f"{suite}-{task}.svg"
        pictures[name] = svg(_chart(task, rows, found.winners))
        parts.append(
            f"## {suite}: {task}\n\n{_authors(rows)}\n\n{_table(rows, found.runs)}\n\n"
            f"![MTS so far by iteration: mean over seeds, in a band from the least to the greatest]({FOLDER}/{name})"
        )
    parts.append(_FORM)
    parts += [
        f"- Table {number} has no task on which a suite has run: {', '.join(tasks)}."
        for number, tasks in tables_without_a_task(found).items()
    ]
    parts += [f"## Table {number}\n\n{lines}" for number, lines in paper_tables(found)]
    return "\n\n".join(part.rstrip() for part in parts) + "\n", pictures


def _baseline(runs: Sequence[Row], like: Row, author: str) -> list[float]:
    """Returns the MTS of PoRSE's runs by an author, on a row's task and with as many epochs allowed."""
    return [
        float(row["mts"])
        for row in runs
        if (row["method"], row["ablation"], row["variant"]) == ("porse", "none", "")
        and (row["task"], row["epochs_allowed"], row["author"]) == (like["task"], like["epochs_allowed"], author)
    ]


def _writer(rows: Sequence[Row], otherwise: str) -> str:
    """Returns the first author of rows who is somebody, else `otherwise`."""
    return next((row["author"] for row in rows if row["author"] != "nobody"), otherwise)


def _authors(rows: Sequence[Row]) -> str:
    named = " and ".join(dict.fromkeys(AUTHORS[row["author"]] for row in rows if row["author"] != "nobody")) or "nobody"
    epochs = sorted({int(row["epochs_allowed"]) for row in rows})
    return f"{len(rows)} {'run' if len(rows) == 1 else 'runs'}; functions by {named}; at most {' or '.join(f'{count:,}' for count in epochs)} epochs each."


def _table(rows: Sequence[Row], runs: Sequence[Row]) -> str:
    """Returns the table of a suite's rows on one task.

    Args:
        rows: those.
        runs: all rows, PoRSE's among them.
    """
    lines = []
    writer = _writer(rows, "nobody")
    for own in grouped(rows, ("method", "ablation", "variant")).values():
        first, mts = own[0], [float(row["mts"]) for row in own]
        published = None if first["variant"] else paper.find_mts(first["task"], first["method"], first["ablation"])
        is_baseline = (first["method"], first["ablation"], first["variant"]) == ("porse", "none", "")
        baseline = [] if is_baseline else _baseline(runs, first, _writer(own, writer))
        functions = sum(int(row["functions"]) for row in own)
        cells = [
            label_of(first),
            str(len(own)),
            mean_of("mts", own),
            _interval(interquartile_mean([mts])),
            _interval(probability_of_improvement([baseline], [mts])) if baseline else "",
            mean_of("score", own) + (" max" if _is_maximum(first) else ""),
            mean_of("evaluation_mts_mean", own),
            mean_of("success", own),
            f"{sum(int(row['epochs_spent']) for row in own) / len(own):,.0f}",
            f"{sum(int(row['valid_functions']) for row in own) / functions:.2f}" if functions else "",
            mean_text(published.mean, published.std) if published else "",
        ]
        lines.append(cells)
    shown = [n for n, name in enumerate(_COLUMNS) if name != _FURTHER or any(line[n] for line in lines)]
    return table_of([_COLUMNS[n] for n in shown], [[line[n] for n in shown] for line in lines])


def _is_maximum(row: Row) -> bool:
    """Returns whether the score of a row's method is the highest fitness, and no mean."""
    return bool(METHODS[row["method"]].get("eliminate", {}).get("score") == "max")


def _interval(found: Estimate) -> str:
    ends = "" if found.low is None else f" ({found.low:.3g} to {found.high:.3g})"
    return f"{found.value:.3g}{ends}"


def _chart(task: str, rows: Sequence[Row], winners: Sequence[Row]) -> Chart:
    lines = []
    for own in grouped(rows, ("method", "ablation", "variant")).values():
        at: dict[int, list[float]] = {}
        for row in own:
            run = [each for each in winners if (each["suite"], each["entry"]) == (row["suite"], row["entry"])]
            for iteration, mts in mts_so_far(run):
                at.setdefault(iteration, []).append(mts)
        lines.append(line_over(label_of(own[0]), at, len(own)))
    return Chart(task, "iteration", "MTS so far", lines)


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
