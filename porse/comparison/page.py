"""A comparison as one HTML page that needs nothing else: no script, no network, no other file."""

from jinja2 import ChoiceLoader, PackageLoader

from porse.comparison.compare import FIGURES, Comparison
from porse.comparison.forms import about, tables_of
from porse.report.intervals import Interval, Intervals, intervals
from porse.report.page import templates


def html_of(shown: Comparison) -> str:
    """Returns tables and figures of a comparison as one page."""
    loader = ChoiceLoader([PackageLoader("porse.comparison", "pages"), PackageLoader("porse.report", "pages")])
    template = templates(loader).get_template("compare.html.jinja")
    drawings: dict[str, list[Intervals]] = {title: [] for title, _ in tables_of(shown)}
    for name, title in FIGURES.items():
        for task in shown.tasks:
            found = [shown.cell(name, task, label) for label in shown.labels]
            rows = [
                Interval(cell.label, cell.mean, cell.low, cell.high, cell.paper.mean if cell.paper else None)
                for cell in found
                if cell
            ]
            if rows:
                # 0 is the sparse reward and 1 the human one.
                drawings[title].append(intervals(task, rows, (0.0, 1.0) if name.startswith("hns") else ()))
    return template.render(
        title=_title(shown), shown=shown, about=about(shown), tables=list(tables_of(shown)), drawings=drawings
    )


def _title(shown: Comparison) -> str:
    runs = sum(row["runs"] for row in shown.budget)
    where = ", ".join(shown.tasks) if len(shown.tasks) < 4 else f"{len(shown.tasks)} tasks"
    return f"{runs} {'run' if runs == 1 else 'runs'} on {where}"
