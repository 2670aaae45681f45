"""`porse ...`: what people type. The pipeline itself is `dvc repro`."""

import errno
import importlib
import signal
import sys
from typing import IO, Any

import click
from click.shell_completion import CompletionItem

from porse import __version__
from porse.errors import PorseError
from porse.paths import at_root
from porse.printing import echo, print_line

_COMMANDS = {
    "bench": ("porse.bench.command:bench", "Measure how close it is to what its libraries can do."),
    "check-code": ("porse.check_code:check_code", "Check reward and mapping functions for a task."),
    "demo": ("porse.demo:demo", "Run everything at tiny size, in about a minute."),
    "doctor": ("porse.doctor:doctor", "Check whether a run would work here, and say what to do."),
    "estimate": ("porse.estimate:estimate", "Print steps, hours, disk and replies of a run beforehand."),
    "experiments": ("porse.experiments:experiments", "Print the experiments of `dvc exp run`."),
    "export": ("porse.export:export", "Write the winner's policy as ONNX or TorchScript."),
    "init": ("porse.init:init", "Start a project of your own."),
    "llm": ("porse.llm_estimate:llm", "Answer, check, read and replace recorded replies."),
    "methods": ("porse.commands.about:show_methods", "Print the methods and the ablations."),
    "params": ("porse.commands.about:show_params", "Print the parameters as the stages read them."),
    "pipeline": ("porse.commands.running:pipeline", "Write the dvc.yaml of each iteration."),
    "play": ("porse.published.command:play", "Show a policy, or random actions, on a task."),
    "publish": ("porse.published.command:publish", "Make published/NAME of a finished run."),
    "published": ("porse.published.command:published", "List the published runs."),
    "render": ("porse.show:render", "Draw a task."),
    "replay": ("porse.published.command:replay_command", "Compute a published run again, and compare."),
    "report": ("porse.comparison.command:report", "Write an HTML page about finished runs."),
    "repro": ("porse.commands.running:repro", "Run the pipeline: `dvc repro`, with repairs and progress."),
    "results": ("porse.commands.outcome:show_results", "Print what a finished run reached."),
    "run": ("porse.commands.running:run_at_once", "Run params.yaml in one process, without DVC."),
    "schedule": ("porse.commands.about:show_schedule", "Print the cost of each rung, in epochs."),
    "schema": ("porse.schema:command", "Write the JSON Schema of params.yaml, for editors."),
    "show": ("porse.published.command:show", "Open the report page of a published run."),
    "status": ("porse.status:status", "Print where the pipeline is, and how to go on."),
    "suite": ("porse.suite.cli:suite", "Run and compare many runs from one file."),
    "tables": ("porse.commands.about:show_tables", "Print the data dictionary."),
    "tasks": ("porse.commands.tasks:show_tasks", "Print the tasks, with sizes and tags."),
    "trends": ("porse.commands.outcome:show_trends", "Print beta and alpha of winners by iteration."),
}
"""Where each command is, and what `porse --help` says of it. A command is imported when it is called."""

_PROGRAMS = ("git",)
"""Programs that the commands call by name."""

_SAME_AGAIN = "run the same command again; it starts over"
_HOW_ON = {
    "demo": "remove the --out folder and run the command again; it starts over",
    "run": "`porse run` cannot continue; remove the --out folder or name another, or use `porse repro`, which continues",
    "suite": "run `porse suite run` again, and it continues with the interrupted entry",
}
"""What to do after Ctrl-C, by the command; `porse repro` says what its stages say."""


class _Failure(click.ClickException):
    """A foreseeable failure: its paragraph is wrapped on a terminal, and one line elsewhere."""

    def show(self, file: IO[Any] | None = None) -> None:
        print_line("Error: ", self.message, hang=0, err=True)


class _Porse(click.Group):
    """Imports a command when it is called, and prints a PorseError as its paragraph, without a traceback."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        # Imported here, as every command is: the list of commands needs none of it.
        from porse import numerics

        numerics.prepare()
        module, name = _COMMANDS[cmd_name][0].split(":")
        return at_root(getattr(importlib.import_module(module), name))

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, _COMMANDS[name][1]) for name in self.list_commands(ctx)])

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        names = [name for name in self.list_commands(ctx) if name.startswith(incomplete)]
        options = click.Command.shell_complete(self, ctx, incomplete)
        return [*(CompletionItem(name, help=_COMMANDS[name][1]) for name in names), *options]

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except PorseError as error:
            raise _Failure(str(error)) from error
        except OSError as error:
            # A reader that has gone, as of `porse tables | head`, is click's; what names no file is a fault of ours.
            if error.errno == errno.EPIPE or error.filename is None:
                raise
            if isinstance(error, FileNotFoundError) and error.filename in _PROGRAMS:
                raise _Failure(f"expected {error.filename} on the PATH, found none; install it") from error
            raise _Failure(
                f"expected a file or folder that can be read and written at {error.filename}, found: {error.strerror}; "
                "`porse doctor` checks the folders of a run"
            ) from error
        except KeyboardInterrupt:
            # Imports nothing large when all is well.
            from porse.stage import HOW_ON

            how = {**_HOW_ON, "repro": HOW_ON}.get(ctx.invoked_subcommand or "", _SAME_AGAIN)
            echo(f"\nstopped by Ctrl-C: {how}", err=True)
            # As a shell says it.
            sys.exit(128 + signal.SIGINT)


@click.group(cls=_Porse)
@click.version_option(__version__)
def main() -> None:
    """Train robot skills with rewards written by a language model. `porse repro` runs the pipeline."""
