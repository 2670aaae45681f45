"""`porse ...`: what people type. The pipeline itself is `dvc repro`."""

import errno
import importlib
import json
import shutil
import signal
import sys
import textwrap
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any

import click

from porse import __version__, numerics, tables
from porse.config import leaves, load_document, load_params, parse_params, resolve_document
from porse.errors import PorseError
from porse.inputs.stages import STAGES
from porse.methods import ABLATIONS, METHODS
from porse.outdated import another_run
from porse.paths import at_root
from porse.pipeline import check_pipeline, write_pipeline
from porse.report.markdown import results_table
from porse.report.results import read_results
from porse.report.trends import read_finished, trends, trends_table
from porse.repro import check_start, reproduce
from porse.search.schedule import allowed_epochs, mutants, total_epochs, varied, work
from porse.stage import HOW_ON
from porse.task_names import TAGS, TASK_TAGS

_LAZY = {
    "export": "porse.export:export",
    "init": "porse.init:init",
    "llm": "porse.estimate:llm",
    "check-code": "porse.check_code:check_code",
    "demo": "porse.demo:demo",
    "experiments": "porse.experiments:experiments",
    "estimate": "porse.effort:estimate",
    "doctor": "porse.doctor:doctor",
    "play": "porse.published.command:play",
    "publish": "porse.published.command:publish",
    "published": "porse.published.command:published",
    "render": "porse.show:render",
    "replay": "porse.published.command:replay_command",
    "report": "porse.reporting.command:report",
    "schema": "porse.schema:command",
    "show": "porse.published.command:show",
    "status": "porse.status:status",
    "suite": "porse.suite.cli:suite",
}
"""Commands that live with what they are about; imported when they are called, since some need torch."""

_SAME_AGAIN = "run the same command again; it starts over"
_HOW_ON = {
    "demo": "remove the --out folder and run the command again; it starts over",
    "repro": HOW_ON,
    "run": "`porse run` cannot continue; remove the --out folder or name another, or use `porse repro`, which continues",
    "suite": "run `porse suite run` again, and it continues with the interrupted entry",
}
"""What to do after Ctrl-C, by the command."""

FOLDER = click.Path(file_okay=False, path_type=Path)
EXISTING = click.Path(exists=True, file_okay=False, path_type=Path)


class _Failure(click.ClickException):
    """A foreseeable failure: its paragraph is wrapped on a terminal, and one line elsewhere."""

    def show(self, file: IO[Any] | None = None) -> None:
        _print("Error: ", self.message, hang=0, err=True)


def _print(head: str, text: str, hang: int | None = None, err: bool = False) -> None:
    """Prints a line; on a terminal it is wrapped, and goes on below its text, or `hang` columns from the left."""
    line = head + text
    if (sys.stderr if err else sys.stdout).isatty():
        width = shutil.get_terminal_size().columns
        if hang is None:
            hang = len(head) if len(head) <= width // 2 else 8
        # What has several lines has them for a reason.
        line = "\n".join(
            textwrap.fill(
                part,
                width,
                subsequent_indent=" " * hang,
                break_long_words=False,
                break_on_hyphens=False,
                replace_whitespace=False,
            )
            for part in line.splitlines()
        )
    click.echo(line, err=err)


class _Porse(click.Group):
    """Adds the lazy commands, and prints a PorseError as its paragraph, without a traceback."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted([*super().list_commands(ctx), *_LAZY])

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        command = super().get_command(ctx, cmd_name)
        if cmd_name in _LAZY:
            module, name = _LAZY[cmd_name].split(":")
            command = getattr(importlib.import_module(module), name)
        return None if command is None else at_root(command)

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except PorseError as error:
            raise _Failure(str(error)) from error
        except OSError as error:
            # A reader that has gone, as of `porse tables | head`, is click's; what names no file is a fault of ours.
            if error.errno == errno.EPIPE or error.filename is None:
                raise
            raise _Failure(
                f"expected a file or folder that can be read and written at {error.filename}, found: {error.strerror}; "
                "`porse doctor` checks the folders of a run"
            ) from error
        except KeyboardInterrupt:
            command = ctx.invoked_subcommand or ""
            click.echo(f"\nstopped by Ctrl-C: {_HOW_ON.get(command, _SAME_AGAIN)}", err=True)
            # As a shell says it.
            sys.exit(128 + signal.SIGINT)


@click.group(cls=_Porse)
@click.version_option(__version__)
def main() -> None:
    """Train robot skills with rewards written by a language model. `porse repro` runs the pipeline."""


@main.command("tables")
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
        click.echo(json.dumps(found, indent=2))
        return
    for table in tables.TABLES.values():
        _print("", f"{table.name}: one row is {table.grain}; key: {', '.join(table.key)}", hang=8)
        for column in table.columns:
            _print(f"    {column.name:18} {column.type!s:7} ", column.meaning)


@main.command("schedule")
@click.option(
    "--params", "path", default="params.yaml", show_default=True, type=click.Path(dir_okay=False, path_type=Path)
)
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
        click.echo(json.dumps({"rungs": rungs, "mutants": vary, **sums}, indent=2))
        return
    for entry in params.iterations:
        for cost in work(params, entry.n):
            click.echo(f"iteration {entry.n} rung {cost.rung:8} {cost.candidates:3} candidates {cost.epochs:7} epochs")
        if mutants(params, entry.n):
            click.echo(f"iteration {entry.n}: mutants vary {varied(params, entry.n)}")
    click.echo(f"in all {total_epochs(params)} epochs of {allowed_epochs(params)} allowed")


@main.command("run")
@click.option("--out", required=True, type=FOLDER, help="Folder for the outputs; created if missing.")
@click.option(
    "--params", "path", default="params.yaml", show_default=True, type=click.Path(dir_okay=False, path_type=Path)
)
@click.option("--prompts", default="prompts", show_default=True, type=EXISTING, help="The prompts' templates.")
@click.option("--cache", default="llm_cache", show_default=True, type=FOLDER, help="The recorded replies.")
def run_at_once(out: Path, path: Path, prompts: Path, cache: Path) -> None:
    """Run params.yaml in one process, without DVC. The bytes are the same; nothing is tracked or skipped."""
    params = load_params(path)
    # Before torch is imported.
    numerics.apply(params.numerics)
    check_start(params)
    from porse.generation.states import checker
    from porse.iteration import Place, run

    with checker(params) as check:
        run(params, Place(out, prompts, cache), check, click.echo)


@main.command("params")
@click.option(
    "--params", "path", default="params.yaml", show_default=True, type=click.Path(dir_okay=False, path_type=Path)
)
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
        click.echo(json.dumps(rows, indent=2))
        return
    for row in rows:
        source = "" if row["origin"] == path.name else f"  # {row['origin']}"
        _print("", f"{row['parameter']}: {json.dumps(row['value'])}{source}", hang=4)


@main.command("pipeline")
@click.option("--check", is_flag=True, help="Write nothing; fail if something would be written.")
def pipeline(check: bool) -> None:
    """Write the dvc.yaml of each iteration from iterations, rungs, mutate.pool and fuse.pool of params.yaml."""
    params = load_params(Path("params.yaml"))
    if check:
        check_pipeline(Path(), params)
        return
    for line in write_pipeline(Path(), params) or ["every dvc.yaml is up to date"]:
        click.echo(line)


@main.command("repro", context_settings={"ignore_unknown_options": True, "help_option_names": []})
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
@click.option("--quiet", "progress", flag_value="quiet", help="Print failures only.")
@click.option("--json", "progress", flag_value="json", help="Print progress as JSON, an object a line.")
def repro(arguments: tuple[str, ...], progress: str | None) -> None:
    """Repair what a killed run may have left, then run `dvc repro` with the ARGUMENTS.

    Without ARGUMENTS, each stage prints a line, or shows its bars on a terminal; the last line is that of `porse status`. With
    ARGUMENTS, DVC prints its own output, too.
    """
    code = reproduce(Path(), arguments, lambda line: click.echo(line, err=True), progress or "")
    if code == 0 and not progress and not arguments:
        from porse.status import status_of, status_text

        click.echo(status_text(status_of(Path())))
    # As a shell says it: a process that a signal ended has no code of its own.
    sys.exit(code if code >= 0 else 128 - code)


@main.command("methods")
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
        click.echo(json.dumps(found, indent=2))
        return
    for heading, sets in (("method", METHODS), ("ablation", ABLATIONS)):
        for name, sections in sets.items():
            values = [f"{s}.{key}: {json.dumps(value)}" for s, own in sections.items() for key, value in own.items()]
            _print(f"{heading:8} {name:20} ", ", ".join(values) or "params.yaml as it is")


@main.command("results")
@click.argument("run", default=".", type=EXISTING)
@click.option(
    "--json", "as_json", is_flag=True, help="Print all figures and the rows of the iterations, as a JSON object."
)
def show_results(run: Path, as_json: bool) -> None:
    """Print score and MTS by iteration, and final success, of the finished run in the folder RUN, as Markdown.

    Where params.yaml is no longer that of the run, a line on standard error says so.
    """
    # Without a lock, as in what `porse demo` leaves, nothing says what the run was of.
    if (run / "dvc.lock").is_file() and (warning := another_run(run)):
        _print("warning: ", str(warning), hang=0, err=True)
    found = read_results(run)
    if not as_json:
        click.echo(results_table(found.iterations, found.figures))
        return
    params = found.params
    named = {"task": params.task, "method": params.method, "ablation": params.ablation, "seed": params.seed}
    click.echo(json.dumps({**named, **found.figures, "iterations": found.iterations}, indent=2))


@main.command("trends")
@click.argument("runs", nargs=-1, type=EXISTING)
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
        sizes = f"{row['observations']:4} {row['actions']:3} {row['episode_length']:5}"
        _print(f"{row['task']:20} {row['family']:7} {sizes} {tagged:20} ", str(row["description"]))
    if not tags:
        click.echo()
        for tag, meaning in TAGS.items():
            _print(f"{tag:11} ", meaning)
