"""What every stage script needs: the command line in one shape, parameters, and errors as one paragraph."""

import json
import os
import sys
from collections.abc import Callable, Sequence
from itertools import takewhile
from pathlib import Path
from typing import Any, NoReturn

import click

from porse import numerics
from porse.config import Params
from porse.errors import PorseError
from porse.inputs.resolve import check_unchanged, read_inputs
from porse.printing import echo, visible

PROGRESS_VARIABLE, PLAN_VARIABLE = "PORSE_PROGRESS", "PORSE_PLAN"
"""How progress is shown, and the file that says what the run's stages are: see `porse.training.bar`."""

LOGS = Path("logs")
HOW_ON = "run `porse repro` again, and it goes on with the stage that was at work"
"""What to do after Ctrl-C, in a stage and around it."""

_ERROR = "Error: "
"""Begins what a stage says when it fails; click writes it."""

_INPUTS, _READ = "porse.inputs", "porse.inputs.read"


class PlainCommand(click.Command):
    """A click command that prints a PorseError as its paragraph, without a traceback."""

    def invoke(self, ctx: click.Context) -> Any:
        """Runs the command; raises ClickException where it raised a PorseError, or was stopped by Ctrl-C."""
        try:
            return super().invoke(ctx)
        except PorseError as error:
            raise click.ClickException(visible(str(error))) from error
        except KeyboardInterrupt:
            raise click.ClickException(f"stopped by Ctrl-C: {HOW_ON}") from None


class StageCommand(PlainCommand):
    """The command of a stage that has inputs: `--inputs FILE` names them, and they are the same before and after."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.params.append(click.Option(["--inputs"], required=True, type=click.Path(path_type=Path)))

    def invoke(self, ctx: click.Context) -> Any:
        """Runs the command; raises ClickException where it raised a PorseError, or where its inputs have changed."""
        ctx.meta[_INPUTS] = ctx.params.pop("inputs")
        result = super().invoke(ctx)
        path = ctx.meta[_INPUTS]
        try:
            check_unchanged(Path(), path, ctx.meta[_READ], "while the stage ran")
        except PorseError as error:
            raise click.ClickException(visible(str(error))) from error
        return result


def run_stage(command: click.Command) -> NoReturn:
    """Runs a stage's command as this process, which ends at once: to take PyTorch apart takes a second, and is no use."""
    try:
        command.main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def folder(name: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Returns a required option `--NAME PATH`."""
    return click.option(f"--{name}", required=True, type=click.Path(path_type=Path))


def begin() -> Params:
    """Returns the parameters of the stage, with the numeric profile set before anything imports torch.

    Raises:
        ParamsError: the parameters are wrong, or the code is no longer what the stage's inputs say.
    """
    context = click.get_current_context()
    path = context.meta[_INPUTS]
    inputs, params = read_inputs(path)
    context.meta[_READ] = inputs
    check_unchanged(Path(), path, inputs, "since stage resolve wrote them down")
    numerics.apply(params.numerics)
    return params


def error_in(lines: Sequence[str]) -> str:
    """Returns the last error that a stage printed, as one line, of the lines of a log; empty where there is none."""
    start = max((number for number, line in enumerate(lines) if line.startswith(_ERROR)), default=None)
    if start is None:
        return ""
    # What DVC adds says only which stage it was.
    own = takewhile(lambda line: not line.startswith("ERROR: "), lines[start:])
    return " ".join(line.strip() for line in own).removeprefix(_ERROR)


def write_manifest(logs: Path = LOGS) -> None:
    """Writes what the results may depend on besides the parameters to `environment.json` in `logs`, which is not tracked."""
    logs.mkdir(exist_ok=True)
    (logs / "environment.json").write_text(
        json.dumps(numerics.manifest(), indent=2, sort_keys=True) + "\n", encoding="utf-8"
    )


def say(text: str) -> None:
    """Prints what the stage did, at once, whatever stdout is: as lines, or as PORSE_PROGRESS says a JSON object or nothing.

    Under `porse repro`, which stage of how many it is stands before each line.
    """
    mode, (number, stages) = os.environ.get(PROGRESS_VARIABLE, ""), _place()
    if mode == "quiet":
        return
    if mode == "json":
        echo(json.dumps({"event": "stage", "stage": number, "stages": stages, "said": text}))
    else:
        for line in text.splitlines():
            echo(f"[{number}/{stages}] {line}" if stages else line)
    sys.stdout.flush()


def _place() -> tuple[int, int]:
    """Returns which stage this is, by the name that DVC gives it, and how many the plan has; zeros without a plan."""
    try:
        names = json.loads(Path(os.environ[PLAN_VARIABLE]).read_text(encoding="utf-8"))["names"]
        return names.index(os.environ["DVC_STAGE"]) + 1, len(names)
    except (KeyError, OSError, ValueError):
        return 0, 0
