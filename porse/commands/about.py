"""What there is: tables, parameters, schedule, methods."""

import json
from dataclasses import asdict
from pathlib import Path

import click

from porse import tables
from porse.commands import with_params
from porse.config import leaves, load_document, load_params, parse_params, resolve_document
from porse.inputs.stages import STAGES
from porse.methods import ABLATIONS, METHODS
from porse.printing import echo, print_line
from porse.search.schedule import allowed_epochs, mutants, total_epochs, varied, work


@click.command("tables")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list of objects.")
def show_tables(as_json: bool) -> None:
    """Print the data dictionary: the rows and columns of each table."""
    if as_json:
        found = [
            {
                "table": table.name,
                "grain": table.grain,
                "key": list(table.key),
                "columns": [
                    {"column": column.name, "type": str(column.type), "meaning": column.meaning}
                    for column in table.columns
                ],
            }
            for table in tables.TABLES.values()
        ]
        echo(json.dumps(found, indent=2))
        return
    for table in tables.TABLES.values():
        print_line("", f"{table.name}: one row is {table.grain}; key: {', '.join(table.key)}", hang=8)
        for column in table.columns:
            print_line(f"    {column.name:18} {column.type!s:7} ", column.meaning)


@click.command("schedule")
@with_params
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object.")
def show_schedule(path: Path, as_json: bool) -> None:
    """Print the cost of each rung of each iteration, in epochs."""
    params = load_params(path)
    if as_json:
        rungs = [
            {"iteration": entry.n, **asdict(cost)} for entry in params.iterations for cost in work(params, entry.n)
        ]
        vary = [
            {"iteration": entry.n, "varied": varied(params, entry.n)}
            for entry in params.iterations
            if mutants(params, entry.n)
        ]
        sums = {"total_epochs": total_epochs(params), "allowed_epochs": allowed_epochs(params)}
        echo(json.dumps({"rungs": rungs, "mutants": vary, **sums}, indent=2))
        return
    for entry in params.iterations:
        for cost in work(params, entry.n):
            echo(f"iteration {entry.n} rung {cost.rung:8} {cost.candidates:3} candidates {cost.epochs:7} epochs")
        if mutants(params, entry.n):
            echo(f"iteration {entry.n}: mutants vary {varied(params, entry.n)}")
    echo(f"in all {total_epochs(params)} epochs of {allowed_epochs(params)} allowed")


@click.command("params")
@with_params
@click.option("--stage", type=click.Choice([*STAGES]), help="Only what this stage reads.")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list of objects.")
def show_params(path: Path, stage: str | None, as_json: bool) -> None:
    """Print the parameters as the stages read them, with the origin of those that the file does not give."""
    document = load_document(path)
    parse_params(document, str(path))
    resolved = resolve_document(document, str(path))
    wanted = None if stage is None else STAGES[stage].parameters
    rows = []
    for name, value in leaves(resolved.document):
        if wanted is None or any(name == own or name.startswith(f"{own}.") for own in wanted):
            sources = resolved.origins
            origin = next((sources[key] for key in sources if name == key or name.startswith(f"{key}.")), "")
            rows.append({"parameter": name, "value": value, "origin": origin or path.name})
    if as_json:
        echo(json.dumps(rows, indent=2))
        return
    for row in rows:
        source = "" if row["origin"] == path.name else f"  # {row['origin']}"
        print_line("", f"{row['parameter']}: {json.dumps(row['value'])}{source}", hang=4)


@click.command("methods")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list of objects.")
def show_methods(as_json: bool) -> None:
    """Print the methods and the ablations: the parameters that each replaces."""
    if as_json:
        found = [
            {
                "kind": kind,
                "name": name,
                "replaces": {f"{s}.{key}": v for s, own in sections.items() for key, v in own.items()},
            }
            for kind, sets in (("method", METHODS), ("ablation", ABLATIONS))
            for name, sections in sets.items()
        ]
        echo(json.dumps(found, indent=2))
        return
    for heading, sets in (("method", METHODS), ("ablation", ABLATIONS)):
        for name, sections in sets.items():
            values = [f"{s}.{key}: {json.dumps(value)}" for s, own in sections.items() for key, value in own.items()]
            print_line(f"{heading:8} {name:20} ", ", ".join(values) or "params.yaml as it is")
