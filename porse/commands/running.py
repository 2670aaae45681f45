"""How a project runs: its pipeline, by DVC or in one process."""

import sys
from pathlib import Path

import click

from porse import numerics
from porse.commands import EXISTING, FOLDER, with_params
from porse.config import load_params
from porse.pipeline import check_pipeline, write_pipeline
from porse.printing import echo
from porse.renderer import import_without_drawing
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


@click.command("repro", context_settings={"ignore_unknown_options": True})
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
@click.option("--quiet", "progress", flag_value="quiet", help="Print failures only.")
@click.option("--json", "progress", flag_value="json", help="Print progress as JSON, an object a line.")
def repro(arguments: tuple[str, ...], progress: str | None) -> None:
    """Run the pipeline: every stage whose inputs have changed since it ran. A stopped run goes on where it was.

    First it writes what `porse pipeline` writes, and repairs what a killed run may have left. Each stage prints a line, or shows
    its bars on a terminal; the last lines are those of `porse status`.

    ARGUMENTS go to `dvc repro`, which then prints its own output, too; `dvc repro --help` lists them. Targets count from the
    project's root.

    \b
    Examples:
      porse repro
      porse repro --force iterations/1/dvc.yaml:fuse
    """  # noqa: D301, click wants the sign itself
    code = reproduce(Path(), arguments, lambda line: echo(line, err=True), progress or "")
    if code == 0 and not progress and not arguments:
        from porse.status import status_of, status_text

        echo(status_text(status_of(Path())))
    sys.exit(code)


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
    import_without_drawing()
    from porse.generation.states import checker
    from porse.iteration import Place, run

    with checker(params) as check:
        run(params, Place(out, prompts, cache), check, echo)
