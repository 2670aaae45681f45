"""Tables for people, as Markdown: README's own are made here, and a test holds that they are current."""

from collections.abc import Mapping, Sequence
from typing import Any

from porse.tables import Row


def results_table(iterations: Sequence[Row], figures: Mapping[str, Any]) -> str:
    """Returns the table of MTS by iteration, and a line with final success.

    Args:
        iterations: rows of the iterations table.
        figures: those of `porse.report.figures.run_figures`.
    """
    lines = [
        "| iteration | the winner's score | MTS | its beta | its alpha |",
        "| --- | --- | --- | --- | --- |",
    ]
    for row in iterations:
        lines.append(
            f"| {row['iteration']} | {row['score']:.3f} | {row['mts']:.3f} | {row['beta']:.3g} | {row['alpha']:.3g} |"
        )
    lines.append(f"| all | {figures['score']:.3f} | **{figures['mts']:.3f}** | | |")
    seeds, failed = figures["evaluation_seeds"], figures["evaluation_failed"]
    if figures["evaluation_mts_std"] is not None:
        spreads = [
            f"{figures[f'evaluation_{name}_mean']:.3f} +- {figures[f'evaluation_{name}_std']:.3f}"
            for name in ("score", "mts")
        ]
        lines.append(f"| {seeds} further seeds | {' | '.join(spreads)} | | |")
    if failed:
        lines.append(f"| {failed} further seeds | failed | failed | | |")
    interval = f"{figures['success']:.3f} ({figures['success_low']:.3f} to {figures['success_high']:.3f})"
    lines += ["", f"Final success in {figures['episodes']} episodes, with its 95 % interval: **{interval}**"]
    return "\n".join(lines)
