"""`porse check-code`: the verdict that the pipeline would give, on files."""

import json
import sys
from dataclasses import asdict
from pathlib import Path

import click

from porse.functions.read.confine import Limits
from porse.functions.read.sandbox import Sandbox
from porse.functions.verdict import Kind, Verdict
from porse.paths import TASK_ARGUMENT
from porse.presets import check_task_name
from porse.printing import echo

FILE = click.Path(dir_okay=False, allow_dash=True)


@click.command("check-code")
@click.argument("task")
@click.option(
    "--reward", "rewards", multiple=True, type=FILE, metavar="FILE", help="A reply or a function; - is standard input."
)
@click.option("--mapping", "mappings", multiple=True, type=FILE, metavar="FILE", help="The same for a mapping.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object for each file, one a line.")
def check_code(task: str, rewards: tuple[str, ...], mappings: tuple[str, ...], as_json: bool) -> None:
    """Check reward and mapping functions for TASK as the pipeline would, and exit 0 when all would be accepted."""
    files: list[tuple[str, Kind]] = [*((name, "reward") for name in rewards), *((name, "mapping") for name in mappings)]
    if not files:
        raise click.UsageError("expected --reward FILE or --mapping FILE, found neither; name at least one file")
    check_task_name(task, TASK_ARGUMENT)
    verdicts = _verdicts(task, [(_read(name), kind) for name, kind in files])
    for (name, kind), verdict in zip(files, verdicts, strict=True):
        echo(json.dumps({"file": name, "kind": kind, **asdict(verdict)}) if as_json else _line(name, verdict))
    sys.exit(0 if all(verdict.passed for verdict in verdicts) else 1)


def _verdicts(task: str, replies: list[tuple[str, Kind]]) -> list[Verdict]:
    with Sandbox(Limits(), "porse.task_probe") as sandbox:
        sandbox.prepare({"task": task, "root": str(Path.cwd())})
        return [sandbox.judge(reply, kind)[0] for reply, kind in replies]


def _read(name: str) -> str:
    """Returns the text of a file, or of standard input for "-"; bytes that are no UTF-8 become question marks."""
    if name == "-":
        return sys.stdin.buffer.read().decode("utf-8", "replace")
    path = Path(name)
    if not path.is_file():
        raise click.UsageError(f"expected a file, found nothing at {name}; give a path, or - for standard input")
    return path.read_bytes().decode("utf-8", "replace")


def _line(name: str, verdict: Verdict) -> str:
    """Returns the verdict for people, like a compiler's message."""
    if not verdict.passed:
        place = f"{name}:{verdict.line}" if verdict.line else name
        return f"{place}: refused ({verdict.check}): {verdict.message}"
    flags = [f"{n} {'rises' if r else 'falls'}" for n, r in zip(verdict.names, verdict.rises, strict=False)]
    warning = f"; warning: {verdict.warning}" if verdict.warning else ""
    return f"{name}: accepted: {', '.join(flags or verdict.names)}{warning}"
