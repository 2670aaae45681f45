"""Finished runs from suites and from folders, as one list whose runs can be told apart."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from porse.config import ROOT
from porse.errors import PorseError
from porse.outdated import params_of_run
from porse.report.results import read_figures
from porse.suite.folders import folders_of
from porse.suite.plan import Entry, load_suite
from porse.suite.status import Status, suite_status


@dataclass(frozen=True)
class Done:
    """A finished run: its status as a suite has it, and the folder of its `params.yaml` and `results/`."""

    status: Status
    folder: Path


@dataclass(frozen=True)
class Sources:
    """Runs that are compared, and a sentence for each suite of which something was left out."""

    runs: Sequence[Done]
    left_out: Sequence[str]


def read_sources(paths: Sequence[Path]) -> Sources:
    """Returns the finished runs of suites' files and of runs' folders.

    What an entry of a suite and a run have in common (task, method, ablation, variant, seed) does not tell them apart: where
    two sources share it, the name of the file or of the folder joins the variants of all their runs.

    Raises:
        ParamsError: a suite's file or a run's parameters are wrong.
        TableError: a table of a run is missing or is not as declared.
        PorseError: there is no run, or two runs cannot be told apart.
    """
    found: list[tuple[str, list[Done]]] = []
    left_out = []
    for path in paths:
        if path.is_dir():
            found.append((path.resolve().name, [_run(path)]))
            continue
        runs, sentence = _suite(path)
        found.append((path.stem, runs))
        left_out += [sentence] if sentence else []
    counts = Counter(_key(run) for _, runs in found for run in runs)
    named = []
    for name, runs in found:
        shared = any(counts[_key(run)] > 1 for run in runs)
        named += [_named(run, name) if shared else run for run in runs]
    if not named:
        raise PorseError(
            f"expected a finished run in {', '.join(map(str, paths))}, found none; run `porse suite run` or `porse repro` first"
        )
    key, count = Counter(map(_key, named)).most_common(1)[0]
    if count > 1:
        twice = next(run.status.entry.name for run in named if _key(run) == key)
        raise PorseError(
            f"expected runs that can be told apart, found {twice} twice; give the folders, or the suites' files, other names"
        )
    return Sources(named, left_out)


def _suite(path: Path) -> tuple[list[Done], str]:
    suite = load_suite(path)
    folders = folders_of(suite.name, ROOT)
    statuses = suite_status(suite, ROOT, str(path))
    done = [Done(status, folders.result(status.entry.name)) for status in statuses if status.state == "done"]
    others = Counter(status.state for status in statuses if status.state != "done")
    if not others:
        return done, ""
    words = ", ".join(f"{count} {state}" for state, count in sorted(others.items()))
    return done, f"Of {path} {len(done)} of {len(statuses)} entries are done and shown; left out: {words}."


def _run(folder: Path) -> Done:
    params = params_of_run(folder)
    entry = Entry(params.task, params.method, params.ablation, "", params.seed, {})
    return Done(Status(entry, "done", read_figures(folder), None), folder)


def _key(run: Done) -> tuple[str, str, str, str, int]:
    entry = run.status.entry
    return entry.task, entry.method, entry.ablation, entry.variant, entry.seed


def _named(run: Done, name: str) -> Done:
    entry = run.status.entry
    variant = f"{name}/{entry.variant}" if entry.variant else name
    return replace(run, status=replace(run.status, entry=replace(entry, variant=variant)))
