"""Tables for people, as Markdown: README's own are made here, and a test holds that they are current."""

from collections.abc import Mapping
from typing import Any


def results_table(metrics: Mapping[str, Any]) -> str:
    """Returns the table of MTS by iteration from `metrics.json`, and a line with final success."""
    lines = [
        "| iteration | the winner's score | MTS | its beta | its alpha |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, row in sorted(metrics["by_iteration"].items(), key=lambda item: int(item[0])):
        lines.append(f"| {name} | {row['score']:.3f} | {row['mts']:.3f} | {row['beta']:.3g} | {row['alpha']:.3g} |")
    lines.append(f"| all | {metrics['score']:.3f} | **{metrics['mts']:.3f}** | | |")
    evaluation = metrics["evaluation"]
    if evaluation["mts_std"] is not None:
        spreads = [f"{evaluation[f'{name}_mean']:.3f} +- {evaluation[f'{name}_std']:.3f}" for name in ("score", "mts")]
        lines.append(f"| {evaluation['seeds']} further seeds | {' | '.join(spreads)} | | |")
    if evaluation["failed"]:
        lines.append(f"| {evaluation['failed']} further seeds | failed | failed | | |")
    success = metrics["final_success"]
    interval = f"{success['mean']:.3f} ({success['low']:.3f} to {success['high']:.3f})"
    lines += ["", f"Final success in {success['episodes']} episodes, with its 95 % interval: **{interval}**"]
    return "\n".join(lines)
