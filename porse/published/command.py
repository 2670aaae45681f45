"""The commands about published runs: `porse publish`, `published`, `show`, `play`, `replay`."""

import copy
import functools
import json
import secrets
import sys
import tempfile
import webbrowser
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from random import Random
from typing import Any

import click
from click.core import ParameterSource

from porse import renderer
from porse import show as shows
from porse.config import Params
from porse.errors import PorseError
from porse.printing import echo
from porse.published.causes import named
from porse.published.check import check_content, read_params
from porse.published.fetch import find, is_address, is_name, published_folders, receive
from porse.published.locks import Shelf, read_locks
from porse.published.manifest import FOLDER, OUTPUTS, OUTPUTS_FILE, read_manifest
from porse.published.replay import Replay, drawn, names_of, replay
from porse.report.answer import author_of
from porse.report.results import read_figures
from porse.search.schedule import total_epochs
from porse.suite.clone import dvc_cache

ROOT = Path()


class _Source(click.ParamType):
    """The name of a published run, an address, or a folder; a path counts from where it is typed."""

    name = "run"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Returns a name or an address as it is, and a path from the root of the file system."""
        text = str(value)
        return text if is_name(text) or is_address(text) else str(Path(text).absolute())


@click.command()
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.argument("name")
@click.option(
    "--words",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="A file with its author's words, Markdown, for the card.",
)
@click.option("--remote", metavar="REMOTE", help="A folder, or any remote of DVC's, for all outputs of the run.")
@click.option("--replace", "replaces", is_flag=True, help="Take the place of a published run of that name.")
def publish(run: Path, name: str, words: Path | None, remote: str | None, replaces: bool) -> None:
    """Make published/NAME of the finished run in the folder RUN: this project, or what a suite keeps of an entry."""
    # Imported here: pages and films are slow to import, and nobody else needs them.
    from porse.published.publish import publish as make

    text = words.read_text(encoding="utf-8") if words else ""
    make(run, name, ROOT, text, remote, replaces, echo)


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list of objects.")
def published(as_json: bool) -> None:
    """List the published runs of this project."""
    rows = [_row(folder) for folder in published_folders(ROOT)]
    if as_json:
        echo(json.dumps(rows, indent=2))
        return
    if not rows:
        echo(f"no run is published in {FOLDER}/; `porse publish RUN NAME` makes one of a finished run")
    for row in rows:
        score = f"score {row['score']:.3f}, MTS {row['mts']:.3f}"
        size = f"{row['epochs']} epochs, {row['bytes'] / 2**20:.2f} MiB"
        echo(
            f"{row['name']}: {row['method']} on {row['task']}, {row['ablation']}, seed {row['seed']}, {row['author']}; {score}; {size}"
        )


def _row(folder: Path) -> dict[str, Any]:
    params, figures, manifest = _params(folder), read_figures(folder), read_manifest(folder)
    return {
        "name": folder.name,
        "task": params.task,
        "method": params.method,
        "ablation": params.ablation,
        "author": author_of(params),
        "seed": params.seed,
        "score": figures["score"],
        "mts": figures["mts"],
        "epochs": total_epochs(params),
        "files": len(manifest.files),
        "bytes": sum(file.size for file in manifest.files.values()),
        "program": {**manifest.program},
    }


def _params(folder: Path) -> Params:
    """Returns the parameters of a run that this project publishes: what is in the project is trusted as the project is."""
    return read_params(folder, trust=True)


@click.command()
@click.argument("name")
def show(name: str) -> None:
    """Open the report page of the published run NAME, where there is a display, and say where page and card are."""
    folder = find(ROOT, name)
    page = folder / "report.html"
    echo(f"{page}: the report")
    echo(f"{folder / 'card.md'}: what it is, and what it shows")
    if renderer.has_display() and webbrowser.open(page.resolve().as_uri()):
        echo(f"{page}: opened")


FILM_S = 2.0
"""Of a published run where there is no display and no length is asked for: a film takes seconds to draw for one of its own."""


def _with_published(callback: Any) -> Any:
    """Returns the callback of `porse play` that also takes the name of a published run in a task's place."""

    @functools.wraps(callback)
    def run(task: str, checkpoint: Path | None, path: Path | None, **others: Any) -> Any:
        if not is_name(task) or not (ROOT / FOLDER / task).is_dir():
            return callback(task=task, checkpoint=checkpoint, path=path, **others)
        folder = find(ROOT, task)
        if others["out"] is None and not renderer.has_display():
            others["out"] = Path(f"{task}.gif")
        if others["out"] is not None and _is_default("seconds"):
            others["seconds"] = FILM_S
        return callback(
            task=_params(folder).task, checkpoint=checkpoint or folder / "run", path=folder / "params.yaml", **others
        )

    return run


def _is_default(name: str) -> bool:
    """Returns whether an option of the command at work has its default; nobody gave it."""
    return click.get_current_context().get_parameter_source(name) is ParameterSource.DEFAULT


play = copy.copy(shows.play)
play.callback = _with_published(shows.play.callback)
play.help = (
    "Show a policy, or random actions, on TASK, or the winner of the published run of that name: in the viewer, or as a .gif "
    "where there is no display."
)


@click.command("replay")
@click.argument("run", required=False, type=_Source())
@click.option(
    "--stages", multiple=True, metavar="STAGE", help="Compute this stage alone, as 2/mutate; may be given again."
)
@click.option("--sample", type=click.IntRange(1, 10_000), help="Compute so many stages, drawn at random.")
@click.option(
    "--seed", type=click.IntRange(0, 2**63 - 1), help="Of the draw.  [default: another one each time, printed]"
)
@click.option(
    "--trust", is_flag=True, help="Run the code of a task that came with a run from elsewhere, with your rights."
)
@click.option(
    "--keep", type=click.Path(file_okay=False, path_type=Path), help="Compute in this new folder, and leave it there."
)
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object.")
def replay_command(
    run: str | None,
    stages: tuple[str, ...],
    sample: int | None,
    seed: int | None,
    trust: bool,
    keep: Path | None,
    as_json: bool,
) -> None:
    """Compute the published RUN again from its recorded replies, in a scratch copy, and compare every output.

    RUN is a name of `porse published`, or the folder or the address of a run from elsewhere. Without it: the smallest of those
    here; with --sample another one, drawn too. Exit code 1 where an output differs.
    """
    if stages and sample:
        raise click.UsageError("expected --stages or --sample, found both")
    if seed is not None and not sample:
        raise click.UsageError("expected --sample with --seed, found none")
    if keep is not None and keep.exists() and any(keep.iterdir()):
        raise click.UsageError(f"expected a new folder for --keep, found something in {keep}")
    if sample and seed is None:
        seed = secrets.randbelow(2**32)
    if run is None:
        run = chosen(published_folders(ROOT), seed)
        if run is None:
            echo(json.dumps(None) if as_json else f"no run is published in {FOLDER}/: nothing to replay")
            return

    def say(line: str) -> None:
        echo(line, err=True)

    with tempfile.TemporaryDirectory(prefix="porse-replay-") as place:
        folder, shelf = _checked(run, Path(place) / "received", trust, say)
        params = read_params(folder, trust=True)
        asked = [*dict.fromkeys(name for text in stages for name in text.split(","))]
        if sample and seed is not None:
            asked = drawn(read_locks(folder), sample, seed)
            say(f"drawn with --seed {seed}, of {run}: {', '.join(asked)}")
        say(f"{run}: {params.method} on {params.task}, {total_epochs(params)} epochs in all")
        found = replay(folder, ROOT, keep or Path(place) / "copy", asked, shelf, trust, say)
        names, commit = names_of(read_locks(folder)), read_manifest(folder).program.get("commit", "")
    document = _document(run, found, names, seed, commit)
    echo(json.dumps(document, indent=2) if as_json else _text(run, found, names, commit))
    sys.exit(0 if found.is_identical else 1)


def chosen(folders: Sequence[Path], seed: int | None) -> str | None:
    """Returns the name of the run that is replayed where none is named; None where there is none.

    Args:
        folders: of published runs.
        seed: None for the one that trains the fewest epochs; else one of the others is drawn, where there are others.
    """
    ordered = sorted(folders, key=lambda folder: (total_epochs(_params(folder)), folder.name))
    if seed is None or len(ordered) < 2:
        return ordered[0].name if ordered else None
    return Random(seed).choice(ordered[1:]).name


def _checked(run: str, received: Path, trust: bool, say: Callable[[str], None]) -> tuple[Path, Shelf]:
    """Returns the folder of a run whose files and their content have been checked, and where its outputs may be had.

    One from elsewhere is copied first, and of its outputs none is taken for granted.
    """
    if is_name(run):
        folder = find(ROOT, run)
        try:
            check_content(folder, trust=True)
        except PorseError as error:
            commit = read_manifest(folder).program.get("commit", "")
            raise PorseError(f"{error}{_of_commit(commit)}") from None
        cache = dvc_cache(ROOT)
        if (folder / OUTPUTS_FILE).is_file() and not (folder / OUTPUTS).is_dir():
            say(f"its outputs can be had: cd {FOLDER} && dvc pull --remote REMOTE {run}/{OUTPUTS_FILE}")
        pulled = (folder / OUTPUTS, f"{folder / OUTPUTS}, which DVC pulled")
        return folder, Shelf([(folder, str(folder)), pulled], cache)
    receive(run, received)
    check_content(received, trust)
    return received, Shelf([(received, run)], None)


def _of_commit(commit: str) -> str:
    """Returns what to say of the commit that a run's code is of; nothing where it is of none."""
    return (
        f"; the run's own code is that of commit {commit[:12]}: check it out to replay the run with it"
        if commit
        else ""
    )


def _document(run: str, found: Replay, names: Sequence[str], seed: int | None, commit: str) -> dict[str, Any]:
    computed = names_of(found.plan.computed)
    return {
        "run": run,
        "commit": commit,
        "seed": seed,
        "stages": len(names),
        "asked": [*found.plan.asked] or [*names],
        "computed": computed,
        "taken": {**found.plan.taken},
        "outputs": found.outputs,
        "identical": found.identical,
        "differ": [*found.differ],
        "first_difference": asdict(found.first) if found.first else None,
        "failed": found.failed or None,
        "changed_inputs": {kind: asdict(change) for kind, change in found.changed.items()},
        "seconds": round(found.seconds, 1),
    }


def _text(run: str, found: Replay, names: Sequence[str], commit: str) -> str:
    computed = names_of(found.plan.computed)
    lines = [
        f"{run}: {found.identical} of {found.outputs} outputs identical, of {len(computed)} of {len(names)} stages, in "
        f"{found.seconds:.0f} s"
    ]
    if found.failed:
        lines.append(f"failed: {found.failed}")
    if found.first:
        first = found.first
        lines.append(f"first difference: {first.stage} left another {named(first.outputs)}")
        lines += [f"  files: {named(first.files)}"] if first.files else []
        lines += [f"  likely cause: {cause}" for cause in first.causes]
    if len(found.differ) > 1:
        lines.append(f"{len(found.differ)} outputs differ: {named(found.differ)}")
    lines += _changed_lines(found, commit)
    return "\n".join(lines)


def _changed_lines(found: Replay, commit: str) -> list[str]:
    """Returns what of the code and the parameters is newer than the run, in lines; files that several stages read, once."""
    if not found.changed:
        return []
    files: Mapping[str, None] = dict.fromkeys(file for change in found.changed.values() for file in change.files)
    values = dict.fromkeys(name for change in found.changed.values() for name in change.parameters)
    what = [
        f"{len(names)} {word} ({named([*names])})"
        for word, names in (("files", files), ("parameters", values))
        if names
    ]
    same = "; the outputs are the same all the same" if found.is_identical else _of_commit(commit)
    return [f"inputs of {named([*found.changed])} are not those of the run: {' and '.join(what)}{same}"]
