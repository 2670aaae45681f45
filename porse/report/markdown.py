"""Tables for people, as Markdown: README's own are made here, and a test holds that they are current."""

from collections.abc import Mapping
from typing import Any


def results_table(metrics: Mapping[str, Any]) -> str:
    """Returns the table of MTS by iteration from `metrics.json`."""
    lines = [
        "| iteration | MTS | the winner's last fitness | its beta | its alpha |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, row in sorted(metrics["by_iteration"].items(), key=lambda item: int(item[0])):
        lines.append(f"| {name} | {row['mts']:.3f} | {row['fitness']:.3f} | {row['beta']:.3g} | {row['alpha']:.3g} |")
    lines.append(f"| all | **{metrics['mts']:.3f}** | {metrics['final_fitness']:.3f} | | |")
    evaluation = metrics["evaluation"]
    if evaluation["mts_std"] is not None:
        spread = f"{evaluation['mts_mean']:.3f} +- {evaluation['mts_std']:.3f}"
        lines.append(f"| {evaluation['seeds']} further seeds | {spread} | | | |")
    return "\n".join(lines)
