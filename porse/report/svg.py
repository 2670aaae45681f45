"""A chart as a file of its own, for pages that are not HTML."""

from jinja2 import PackageLoader

from porse.report.charts import Chart
from porse.report.page import templates


def svg(chart: Chart) -> str:
    """Returns a chart with at least one finite point as SVG: its legend above the field, and no title."""
    return templates(PackageLoader("porse.report", "pages")).get_template("chart.svg.jinja").render(shown=chart) + "\n"
