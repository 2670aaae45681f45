"""How a project runs: its pipeline, by DVC or in one process."""

import sys
from pathlib import Path

import click

from porse import numerics
from porse.commands import EXISTING, FOLDER, with_params
from porse.config import load_params
from porse.pipeline import check_pipeline, write_pipeline
from porse.printing import echo
from porse.repro import check_start, reproduce


@click.command("pipeline")
@click.option("--check", is_flag=True, help="Write nothing; fail if a dvc.yaml is out of date.")
def pipeline(check: bool) -> None:
    """Write the dvc.yaml of each iteration from iterations, rungs, mutate.pool and fuse.pool of params.yaml."""
    params = load_params(Path("params.yaml"))
    if check:
        check_pipeline(Path(), params)
        return
    for line in write_pipeline(Path(), params) or ["every dvc.yaml is up to date"]:
        echo(line)


@click.command("repro", context_settings={"ignore_unknown_options": True, "help_option_names": []})
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
@click.option("--quiet", "progress", flag_value="quiet", help="Print failures only.")
@click.option("--json", "progress", flag_value="json", help="Print progress as JSON, an object a line.")
def repro(arguments: tuple[str, ...], progress: str | None) -> None:
    """Repair what a killed run may have left, then run `dvc repro` with the ARGUMENTS.

    Without ARGUMENTS, each stage prints a line, or shows its bars on a terminal; the last line is that of `porse status`. With
    ARGUMENTS, DVC prints its own output, too.
    """
    code = reproduce(Path(), arguments, lambda line: echo(line, err=True), progress or "")
    if code == 0 and not progress and not arguments:
        from porse.status import status_of, status_text

        echo(status_text(status_of(Path())))
    # As a shell says it: a process that a signal ended has no code of its own.
    sys.exit(code if code >= 0 else 128 - code)


@click.command("run")
@click.option("--out", required=True, type=FOLDER, help="Folder for the outputs; created if missing.")
@with_params
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
        run(params, Place(out, prompts, cache), check, echo)
