"""`porse ...`: what people type. The pipeline itself is `dvc repro`."""

import errno
import importlib
import json
import signal
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

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
from porse.report.trends import read_finished, trends, trends_table
from porse.repro import HOW_ON, check_start, reproduce
from porse.search.schedule import allowed_epochs, mutants, total_epochs, varied, work
from porse.task_names import TAGS, TASK_TAGS

_LAZY = {
    "export": "porse.export:export",
    "init": "porse.init:init",
    "llm": "porse.estimate:llm",
    "check-code": "porse.check_code:check_code",
    "demo": "porse.demo:demo",
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

_SAME_AGAIN = "give the same command again to start over"
_HOW_ON = {
    "demo": "remove the --out folder and give the command again, which starts over",
    "repro": HOW_ON,
    "run": "`porse run` does not go on; remove the --out folder or name another, or use `porse repro`, which does",
    "suite": "run `porse suite run` again, and it goes on with the entry that was at work",
}
"""What to do after Ctrl-C, by the command."""

FOLDER = click.Path(file_okay=False, path_type=Path)
EXISTING = click.Path(exists=True, file_okay=False, path_type=Path)


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
            raise click.ClickException(str(error)) from error
        except OSError as error:
            # A reader that has gone, as of `porse tables | head`, is click's; what names no file is a fault of ours.
            if error.errno == errno.EPIPE or error.filename is None:
                raise
            raise click.ClickException(
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
    """Robot skills without a hand-written reward, replayable offline. The pipeline itself is `dvc repro`."""


@main.command("tables")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list of objects.")
def show_tables(as_json: bool) -> None:
    """Print the data dictionary: what a row and a column of each table mean."""
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
        click.echo(f"{table.name}: one row is {table.grain}; key: {', '.join(table.key)}")
        for column in table.columns:
            click.echo(f"    {column.name:18} {column.type!s:7} {column.meaning}")


@main.command("schedule")
@click.option(
    "--params", "path", default="params.yaml", show_default=True, type=click.Path(dir_okay=False, path_type=Path)
)
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object.")
def show_schedule(path: Path, as_json: bool) -> None:
    """Print what each rung of each iteration costs, in epochs."""
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
@click.option("--out", required=True, type=FOLDER, help="Where the outputs go; made when missing.")
@click.option(
    "--params", "path", default="params.yaml", show_default=True, type=click.Path(dir_okay=False, path_type=Path)
)
@click.option("--prompts", default="prompts", show_default=True, type=EXISTING, help="The prompts' templates.")
@click.option("--cache", default="llm_cache", show_default=True, type=FOLDER, help="The recorded replies.")
def run_at_once(out: Path, path: Path, prompts: Path, cache: Path) -> None:
    """Run params.yaml in one process, without DVC: the same bytes, nothing tracked, nothing skipped."""
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
    """Print the parameters as stages read them, each with where it comes from when that is not the file."""
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
        click.echo(f"{row['parameter']}: {json.dumps(row['value'])}{source}")


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
@click.option("--quiet", "progress", flag_value="quiet", help="Print what fails, and nothing else.")
@click.option("--json", "progress", flag_value="json", help="Print progress as JSON, an object a line.")
def repro(arguments: tuple[str, ...], progress: str | None) -> None:
    """Mend what a killed run may have left, then run `dvc repro` with the ARGUMENTS."""
    code = reproduce(Path(), arguments, lambda line: click.echo(line, err=True), progress or "")
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
            click.echo(f"{heading:8} {name:20} {', '.join(values) or 'params.yaml as it is'}")


@main.command("results")
@click.option(
    "--metrics", "path", default="metrics.json", show_default=True, type=click.Path(dir_okay=False, path_type=Path)
)
@click.option("--json", "as_json", is_flag=True, help="Print the metrics as they are, as a JSON object.")
def show_results(path: Path, as_json: bool) -> None:
    """Print score and MTS by iteration, and final success, from a run's metrics, as Markdown.

    Where params.yaml beside them is no longer that of the run, a line on standard error says so.
    """
    try:
        metrics = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise PorseError(
            f"expected the metrics of a run at {path}, found no such file; run `dvc repro` first"
        ) from None
    except ValueError as error:
        raise PorseError(
            f"expected the metrics of a run at {path}, found no JSON ({error}); `git checkout {path}` or `dvc repro` restores it"
        ) from None
    if (path.parent / "params.yaml").is_file() and (warning := another_run(path.parent)):
        click.echo(f"warning: {warning}", err=True)
    if as_json:
        click.echo(json.dumps(metrics, indent=2))
        return
    try:
        table = results_table(metrics)
    except (AttributeError, KeyError, TypeError) as error:
        raise PorseError(
            f"expected the metrics that this version writes at {path}, found others ({error!r}); run `dvc repro` for new ones"
        ) from None
    click.echo(table)


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
        click.echo(
            f"{row['task']:20} {row['family']:7} {row['observations']:4} {row['actions']:3} {row['episode_length']:5} "
            f"{tagged:20} {row['description']}"
        )
    if not tags:
        click.echo()
        for tag, meaning in TAGS.items():
            click.echo(f"{tag:11} {meaning}")
