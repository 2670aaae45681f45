"""A comparison as CSV, Markdown and LaTeX: in all of them rows are tasks and columns are methods, as in the paper's tables."""

import csv
import dataclasses
import io
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from porse.comparison.compare import FIGURES, Cell, Comparison
from porse.report.answer import figure

Rows = list[list[str]]
"""Cells, the first row the titles."""

_CELL = (
    "task", "label", "figure", "seeds", "mean", "deviation", "low", "high", "difference", "difference_low",
    "difference_high",
)  # fmt: skip


def csv_of(shown: Comparison) -> str:
    """Returns a line for each cell, with all that is known of it; numbers in full."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*_CELL, "paper_table", "paper_mean", "paper_deviation"])
    for cell in shown.cells:
        values = dataclasses.asdict(cell)
        paper = (cell.paper.table, cell.paper.mean, cell.paper.std) if cell.paper else (None, None, None)
        writer.writerow(["" if value is None else value for value in (*(values[name] for name in _CELL), *paper)])
    return text.getvalue()


def markdown_of(shown: Comparison) -> str:
    """Returns one table for each figure, then beta and alpha, and what was spent."""
    parts = ["# Comparison", *shown.left_out, about(shown)]
    for title, cells in tables_of(shown):
        head, *lines = ([cell.replace("|", "\\|") for cell in line] for line in cells)
        rule = ["---"] * len(head)
        parts += [f"## {title}", "\n".join(f"| {' | '.join(line)} |" for line in (head, rule, *lines))]
    return "\n\n".join(parts) + "\n"


def latex_of(shown: Comparison) -> str:
    """Returns one `table` for each, for a document that uses booktabs."""
    parts = [f"% {sentence}" for sentence in (*shown.left_out, about(shown), "Needs \\usepackage{booktabs}.")]
    for title, cells in tables_of(shown):
        head, *lines = ([_tex(cell) for cell in line] for line in cells)
        rows = "\n".join(f"    {' & '.join(line)} \\\\" for line in lines)
        parts.append(
            "\\begin{table}\n  \\centering\n"
            f"  \\caption{{{_tex(title)}}}\n"
            f"  \\begin{{tabular}}{{l{'r' * (len(head) - 1)}}}\n    \\toprule\n    {' & '.join(head)} \\\\\n    \\midrule\n"
            f"{rows}\n    \\bottomrule\n  \\end{{tabular}}\n\\end{{table}}"
        )
    return "\n\n".join(parts) + "\n"


def about(shown: Comparison) -> str:
    """Returns what the cells of the tables mean."""
    against = f" After it, the mean difference to {shown.baseline}, seed by seed." if shown.baseline else ""
    return (
        "Mean and deviation over n seeds, with the bootstrap interval of the mean. It is one of 95 % in name: with three seeds it "
        "covers about 70 %, with five about 84 %. Of one run, the interval over its episodes where it has one."
        f'{against} "Paper" is the paper\'s mean and deviation over five seeds. The score is a mean over the last epochs, but of '
        "eureka and revolve-auto the highest of any epoch: MTS compares all methods."
    )


def tables_of(shown: Comparison) -> Iterator[tuple[str, Rows]]:
    """Yields the title and the cells of each table."""
    for name, title in FIGURES.items():
        if any(cell.figure == name for cell in shown.cells):
            yield title, _by_task(shown, name)
    if shown.weights:
        yield "Beta and alpha of the winners by iteration (table 18)", _weights(shown.weights)
    yield (
        "What was spent",
        [
            ["task", "method", "runs", "epochs spent", "epochs allowed", "environment steps"],
            *(
                [
                    row["task"], row["label"], str(row["runs"]),
                    *(f"{row[name]:,.0f}" for name in ("epochs_spent", "epochs_allowed", "environment_steps")),
                ]
                for row in shown.budget
            ),
        ],
    )  # fmt: skip


def cell_text(cell: Cell | None) -> str:
    """Returns a cell as people read it; empty for None."""
    if cell is None:
        return ""
    parts = [mean_text(cell.mean, cell.deviation)]
    if cell.low is not None and cell.high is not None:
        parts.append(f"[{figure(cell.low)}, {figure(cell.high)}]")
    parts.append(f"n = {cell.seeds}")
    if cell.difference is not None:
        ends = (cell.difference_low, cell.difference_high)
        parts.append(f"difference {figure(cell.difference)}")
        if ends[0] is not None:
            parts.append(f"[{figure(ends[0])}, {figure(ends[1])}]")
    if cell.paper:
        parts.append(f"paper {mean_text(cell.paper.mean, cell.paper.std)}")
    return "; ".join(parts)


def mean_text(mean: float, deviation: float | None) -> str:
    """Returns a mean with its deviation where there is one."""
    if deviation is None:
        return figure(mean)
    # Equal values may have a mean that differs from them by rounding.
    return f"{figure(mean)} ± {figure(deviation if deviation > 1e-12 * abs(mean) else 0.0)}"


def _by_task(shown: Comparison, name: str) -> Rows:
    # What was run, and has no such figure, is not what was not run.
    missing = {(row["task"], row["label"]): "undefined" for row in shown.budget}
    lines = (
        [task, *(cell_text(shown.cell(name, task, label)) or missing.get((task, label), "") for label in shown.labels)]
        for task in shown.tasks
    )
    return [["task", *shown.labels], *lines]


def _weights(rows: Sequence[Mapping[str, Any]]) -> Rows:
    steps = sorted({(row["iteration"], row["varied"]) for row in rows})
    found: Rows = [["task", "method", *(f"{n}: {kind}" for n, kind in steps)]]
    for task, label in dict.fromkeys((row["task"], row["label"]) for row in rows):
        own = {(row["iteration"], row["varied"]): row for row in rows if (row["task"], row["label"]) == (task, label)}
        found.append([task, label, *(_weight(own[step]) if step in own else "" for step in steps)])
    return found


def _weight(row: Mapping[str, Any]) -> str:
    published = "" if row["paper"] is None else f"; paper {figure(row['paper'])}"
    return f"{mean_text(row['mean'], row['std'])}{published}"


_TEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "±": r"$\pm$",
}  # fmt: skip


def _tex(text: str) -> str:
    return "".join(_TEX.get(sign, sign) for sign in text)
