"""`porse bench`: every figure of the table, measured in one run."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import click

from porse import numerics
from porse.bench.figure import Figure, Suite
from porse.bench.machine import described, machine
from porse.bench.table import TABLE
from porse.printing import echo, print_line
from porse.renderer import import_without_drawing

_NAME_WIDTH = max(len(measure.name) for measure in TABLE)


@click.command()
@click.option(
    "--suite",
    "chosen",
    type=click.Choice([*get_args(Suite), "all"]),
    default="all",
    show_default=True,
    help="What to measure.",
)
@click.option(
    "--rounds",
    default=5,
    show_default=True,
    type=click.IntRange(1, 1000),
    help="Of each figure; slow ones have three at most.",
)
@click.option("--params", default="params.yaml", show_default=True, type=click.Path(dir_okay=False, path_type=Path))
@click.option("--cache", default="llm_cache", show_default=True, type=click.Path(file_okay=False, path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object.")
def bench(chosen: str, rounds: int, params: Path, cache: Path, as_json: bool) -> None:
    """Measure how close simulation, training, commands and replies come to what they are compared with; six minutes in all."""
    import_without_drawing()
    found = machine()
    suites = [suite for suite in get_args(Suite) if chosen in (suite, "all")]
    measured = (figure for suite in suites for figure in figures_of(suite, rounds, params, cache))
    if as_json:
        echo(json.dumps({"machine": found, "figures": [figure.as_json() for figure in measured]}, indent=2))
        return
    for line in described(found):
        print_line("", line, hang=9)
    echo(
        f"\n{'suite':9}{'figure':{_NAME_WIDTH + 2}}{'value':>9}  {'bar':9}{'holds':7}{'low to high':18}{'rounds':8}unit; beside"
    )
    for figure in measured:
        print_line(*line_of(figure))


def figures_of(suite: Suite, rounds: int, params: Path, cache: Path) -> Iterator[Figure]:
    """Yields the figures of one suite as they are measured.

    Args:
        suite: which.
        rounds: of each figure.
        params: the file with the parameters of trainings.
        cache: the recorded replies.

    Raises:
        PorseError: something failed that should have been measured.
    """
    # Each suite is imported when it is measured: torch takes seconds, and must find a numeric profile set.
    if suite == "sim":
        numerics.apply("portable")
        from porse.bench import sim

        yield from sim.figures(rounds)
    elif suite == "train":
        from porse.bench import train

        yield from train.figures(rounds, params)
    elif suite == "pipeline":
        from porse.bench import commands

        yield from commands.figures(rounds)
    else:
        from porse.bench import replies

        yield from replies.figures(rounds, cache)


def line_of(figure: Figure) -> tuple[str, str]:
    """Returns a figure as the columns of a line, and the text behind them."""
    measure, bar = figure.measure, figure.measure.bar
    head = f"{measure.suite:9}{measure.name:{_NAME_WIDTH + 2}}"
    wanted = f"{bar.sense} {bar.limit:g}" if bar else ""
    if figure.value is None:
        return f"{head}{'-':>9}  {wanted:9}", f"not measured: {figure.missing}"
    holds = {True: "yes", False: "no", None: ""}[figure.holds]
    spread = f"{_short(min(figure.rounds))} to {_short(max(figure.rounds))}"
    columns = f"{_short(figure.value):>9}  {wanted:9}{holds:7}{spread:18}{len(figure.rounds):<8}"
    return head + columns, f"{measure.unit}; {measure.peer}"


def _short(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"
