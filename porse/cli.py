"""`porse ...`: what people type. The pipeline itself is `dvc repro`."""

import importlib
import json
import sys
from pathlib import Path
from typing import Any

import click

from porse import __version__, numerics, tables
from porse.config import leaves, load_document, load_params, parse_params, resolve_document
from porse.errors import PorseError
from porse.inputs.stages import STAGES
from porse.methods import ABLATIONS, METHODS
from porse.pipeline import check_pipeline, write_pipeline
from porse.report.markdown import results_table
from porse.report.trends import read_finished, trends, trends_table
from porse.repro import reproduce
from porse.search.schedule import allowed_epochs, mutants, total_epochs, varied, work
from porse.task_names import TAGS, TASK_TAGS

_LAZY = {
    "llm": "porse.estimate:llm",
    "check-code": "porse.check_code:check_code",
    "play": "porse.show:play",
    "render": "porse.show:render",
    "report": "porse.report.page:report",
    "suite": "porse.suite.cli:suite",
}
"""Commands that live with what they are about; imported when they are called, since some need torch."""

FOLDER = click.Path(file_okay=False, path_type=Path)


class _Porse(click.Group):
    """Adds the lazy commands, and prints a PorseError as its paragraph, without a traceback."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted([*super().list_commands(ctx), *_LAZY])

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _LAZY:
            return super().get_command(ctx, cmd_name)
        module, name = _LAZY[cmd_name].split(":")
        return getattr(importlib.import_module(module), name)

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except PorseError as error:
            raise click.ClickException(str(error)) from error


@click.group(cls=_Porse)
@click.version_option(__version__)
def main() -> None:
    """Robot skills without a hand-written reward, replayable offline. The pipeline itself is `dvc repro`."""


@main.command("tables")
def show_tables() -> None:
    """Print the data dictionary: what a row and a column of each table mean."""
    for table in tables.TABLES.values():
        click.echo(f"{table.name}: one row is {table.grain}; key: {', '.join(table.key)}")
        for column in table.columns:
            click.echo(f"    {column.name:18} {column.type!s:7} {column.meaning}")


@main.command("schedule")
@click.option(
    "--params", "path", default="params.yaml", show_default=True, type=click.Path(dir_okay=False, path_type=Path)
)
def show_schedule(path: Path) -> None:
    """Print what each rung of each iteration costs, in epochs."""
    params = load_params(path)
    for entry in params.iterations:
        for cost in work(params, entry.n):
            click.echo(f"iteration {entry.n} rung {cost.rung:8} {cost.candidates:3} candidates {cost.epochs:7} epochs")
        if mutants(params, entry.n):
            click.echo(f"iteration {entry.n}: mutants vary {varied(params, entry.n)}")
    click.echo(f"in all {total_epochs(params)} epochs of {allowed_epochs(params)} allowed")


@main.command("run")
@click.option("--out", required=True, type=FOLDER, help="Where the outputs go; made when missing.")
@click.option(
    "--params", "path", default="params.yaml", show_default=True, type=click.Path(dir_okay=False, path_type=Path)
)
@click.option("--prompts", default="prompts", show_default=True, type=FOLDER, help="The prompts' templates.")
@click.option("--cache", default="llm_cache", show_default=True, type=FOLDER, help="The recorded replies.")
def run_at_once(out: Path, path: Path, prompts: Path, cache: Path) -> None:
    """Run params.yaml in one process, without DVC: the same bytes, nothing tracked, nothing skipped."""
    params = load_params(path)
    # Before torch is imported.
    numerics.apply(params.numerics)
    from porse.generation.states import checker
    from porse.iteration import Place, run

    with checker(params) as check:
        run(params, Place(out, prompts, cache), check, click.echo)


@main.command("params")
@click.option(
    "--params", "path", default="params.yaml", show_default=True, type=click.Path(dir_okay=False, path_type=Path)
)
@click.option("--stage", type=click.Choice([*STAGES]), help="Only what this stage reads.")
def show_params(path: Path, stage: str | None) -> None:
    """Print the parameters as stages read them, each with where it comes from when that is not the file."""
    document = load_document(path)
    parse_params(document, str(path))
    resolved = resolve_document(document, str(path))
    wanted = None if stage is None else STAGES[stage].parameters
    for name, value in leaves(resolved.document):
        if wanted is None or any(name == own or name.startswith(f"{own}.") for own in wanted):
            sources = resolved.origins
            origin = next((sources[key] for key in sources if name == key or name.startswith(f"{key}.")), "")
            click.echo(f"{name}: {json.dumps(value)}{f'  # {origin}' if origin else ''}")


@main.command("pipeline")
@click.option("--check", is_flag=True, help="Write nothing; fail where something would be written.")
def pipeline(check: bool) -> None:
    """Write the dvc.yaml of each iteration from iterations, rungs, mutate.pool and fuse.pool of params.yaml."""
    params = load_params(Path("params.yaml"))
    if check:
        check_pipeline(Path(), params)
        return
    for line in write_pipeline(Path(), params) or ["every dvc.yaml is as it should be"]:
        click.echo(line)


@main.command("repro", context_settings={"ignore_unknown_options": True, "help_option_names": []})
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
def repro(arguments: tuple[str, ...]) -> None:
    """Mend what a killed run may have left, then run `dvc repro` with the ARGUMENTS."""
    code = reproduce(Path(), arguments, lambda line: click.echo(line, err=True))
    # As a shell says it: a process that a signal ended has no code of its own.
    sys.exit(code if code >= 0 else 128 - code)


@main.command("methods")
def show_methods() -> None:
    """Print the methods and the ablations: the parameters that each replaces."""
    for heading, sets in (("method", METHODS), ("ablation", ABLATIONS)):
        for name, sections in sets.items():
            values = [f"{s}.{key}: {json.dumps(value)}" for s, own in sections.items() for key, value in own.items()]
            click.echo(f"{heading:8} {name:20} {', '.join(values) or 'params.yaml as it is'}")


@main.command("results")
@click.option(
    "--metrics", "path", default="metrics.json", show_default=True, type=click.Path(dir_okay=False, path_type=Path)
)
def show_results(path: Path) -> None:
    """Print score and MTS by iteration, and final success, from a run's metrics, as Markdown."""
    try:
        metrics = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise PorseError(
            f"expected the metrics of a run at {path}, found no such file; run `dvc repro` first"
        ) from None
    click.echo(results_table(metrics))


@main.command("trends")
@click.argument("runs", nargs=-1, type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list of objects.")
def show_trends(runs: tuple[Path, ...], as_json: bool) -> None:
    """Print beta and alpha of the winners by iteration, over the finished runs in the folders RUNS, `.` by default."""
    found = trends(read_finished(folder) for folder in runs or (Path(),))
    click.echo(json.dumps(found, indent=2) if as_json else trends_table(found))


@main.command("tasks")
@click.option(
    "--tag", "tags", multiple=True, type=click.Choice([*TAGS]), help="Only tasks with this tag; may be given again."
)
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list of objects.")
def show_tasks(tags: tuple[str, ...], as_json: bool) -> None:
    """Print the tasks, with sizes and tags."""
    from porse.tasks import TASKS

    rows = [
        {
            "task": name,
            "observations": task.NUM_OBSERVATIONS,
            "actions": task.NUM_ACTIONS,
            "family": task.FAMILY,
            "description": task.DESCRIPTION,
            "episode_length": task.EPISODE_LENGTH,
            "tags": list(TASK_TAGS[name]),
        }
        # Looking a task up imports its module: only those that are printed.
        for name, task in ((name, TASKS[name]) for name in TASKS if {*tags} <= {*TASK_TAGS[name]})
    ]
    if as_json:
        click.echo(json.dumps(rows, indent=2))
        return
    for row in rows:
        tagged = ", ".join(TASK_TAGS[str(row["task"])])
        click.echo(
            f"{row['task']:20} {row['family']:7} {row['observations']:4} {row['actions']:3} {row['episode_length']:5} "
            f"{tagged:20} {row['description']}"
        )
    if not tags:
        click.echo()
        for tag, meaning in TAGS.items():
            click.echo(f"{tag:11} {meaning}")
