"""A published run computed again in a scratch copy of the project, from its own recorded replies, and compared by its locks."""

import functools
import os
import re
import shutil
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random

from porse import numerics
from porse.config import Params, load_params
from porse.documents import read_yaml
from porse.errors import PorseError
from porse.llm.store import REFRESHED
from porse.paths import python_of_stages
from porse.pipeline import write_pipeline
from porse.processes import die_with_parent
from porse.published.causes import causes, changed_inputs
from porse.published.check import REPLIES, read_params
from porse.published.inputs import Changes
from porse.published.locks import INPUTS, RESOLVE, Shelf, Stage, overlaps, put, read_locks
from porse.stage import error_in
from porse.suite.clone import DVC, copy_files, new_repository
from porse.suite.resolve import tracked_files
from porse.task_names import is_own, own_place
from porse.warm.start import warm_server

_SHOWN = 40
"""Last lines of a stage's output that an error can be told from."""

_ADVICE = re.compile(r"\s|> |Generating lock|Updating lock|To (track|enable) |Use `dvc push`|WARNING: '.*' is empty")
"""Of DVC's own lines, those that concern a project that somebody works in."""

_OWN_DEP = re.compile(r"^( *)- porse$", re.MULTILINE)


@dataclass(frozen=True)
class Plan:
    """What is computed.

    Attributes:
        asked: stages that were asked for; empty for all.
        computed: those, and the ones whose outputs they read and that nobody has, in their order.
        taken: where each output came from that was not computed, by its path.
    """

    asked: tuple[str, ...]
    computed: tuple[Stage, ...]
    taken: Mapping[str, str]


@dataclass(frozen=True)
class Difference:
    """The first output that differs from the published one.

    Attributes:
        stage: the stage that left it.
        outputs: those of its outputs that differ.
        files: files in them that differ, where the published ones are at hand.
        causes: likely causes, the likeliest first.
    """

    stage: str
    outputs: tuple[str, ...]
    files: tuple[str, ...]
    causes: tuple[str, ...]


@dataclass(frozen=True)
class Replay:
    """What a replay found.

    Attributes:
        plan: what was computed.
        outputs: how many outputs were compared.
        differ: those of them that are not the published bytes, by path.
        first: the first stage whose outputs differ, None where none do.
        failed: the stage that failed, with its error; empty where none did.
        changed: what differs in the inputs of each kind of stage that was computed, between then and now.
        seconds: how long it took, on the clock.
    """

    plan: Plan
    outputs: int
    differ: tuple[str, ...]
    first: Difference | None
    failed: str
    changed: Mapping[str, Changes]
    seconds: float

    @property
    def identical(self) -> int:
        """How many outputs are the published bytes."""
        return self.outputs - len(self.differ)

    @property
    def is_identical(self) -> bool:
        """Whether all that was computed is what was published."""
        return not self.failed and not self.differ


def names_of(stages: Sequence[Stage]) -> list[str]:
    """Returns the names of the stages that can be asked for."""
    return [stage.name for stage in stages if stage.name != RESOLVE]


def drawn(stages: Sequence[Stage], count: int, seed: int) -> list[str]:
    """Returns the names of so many stages, drawn with a seed; all where there are no more."""
    names = names_of(stages)
    chosen = {*Random(seed).sample(names, min(count, len(names)))}
    return [name for name in names if name in chosen]


def replay(
    folder: Path, root: Path, scratch: Path, asked: Sequence[str], shelf: Shelf, trust: bool, say: Callable[[str], None]
) -> Replay:
    """Computes stages of a published run again.

    Args:
        folder: the published run, checked.
        root: the project's root, whose code computes.
        scratch: an empty folder, for a copy of the project.
        asked: names of stages; none for all.
        shelf: where outputs may be had that stages read, so that they need not be computed; not used for all stages.
        trust: whether the run's own code may be run.
        say: told lines about what is done.

    Raises:
        PorseError: there is no such stage, or Git or DVC does not work here.
    """
    started = time.monotonic()
    stages, params = read_locks(folder), read_params(folder, trust)
    unknown = [name for name in asked if name not in names_of(stages)]
    if unknown:
        raise PorseError(
            f"expected stages of this run, found {unknown[0]!r}; its stages are {', '.join(names_of(stages))}"
        )
    numerics.apply(params.numerics)
    _make_copy(folder, root, scratch, params)
    plan = _planned(stages, asked, shelf, scratch)
    if asked:
        for words in sorted({*plan.taken.values()}):
            say(f"{sum(each == words for each in plan.taken.values())} outputs that they read: taken from {words}")
        extra = [stage.name for stage in plan.computed if stage.name not in asked]
        if extra:
            say(f"computed because they read its outputs, which nobody here has: {', '.join(extra)}")
    failed = _reproduce(scratch, plan, params.numerics, say)
    now = {stage.name: stage for stage in read_locks(scratch)} if (scratch / "dvc.lock").is_file() else {}
    changed = changed_inputs(folder / INPUTS, scratch / INPUTS, [stage.kind for stage in plan.computed])
    compared = [(stage, now[stage.name]) for stage in plan.computed if stage.name in now and stage.name != RESOLVE]
    differ = tuple(path for stage, own in compared for path, md5 in stage.outs.items() if own.outs.get(path) != md5)
    # Stages are in their order: the first with a difference has read none.
    first = next((stage for stage, _ in compared if any(path in differ for path in stage.outs)), None)
    return Replay(
        plan,
        sum(len(stage.outs) for stage, _ in compared),
        differ,
        _difference(first, differ, folder, shelf, scratch, params, changed) if first else None,
        failed,
        changed,
        time.monotonic() - started,
    )


def _make_copy(folder: Path, root: Path, scratch: Path, params: Params) -> None:
    """Puts the project's tracked files, and of the run its parameters, its preset and its replies, into a repository."""
    files = tracked_files(root)
    if "dvc.yaml" not in files:
        raise PorseError(
            f"expected dvc.yaml among the files that Git tracks in {root.resolve()}, found none; a replay takes those: git add them"
        )
    new_repository(scratch)
    copy_files(files, root, scratch)
    # A cache of its own, whatever the project's is: nothing is found there that was not computed here.
    (scratch / ".dvc" / "config.local").write_text("['cache']\n    dir = cache\n", encoding="utf-8")
    if (root / ".venv").exists():
        (scratch / ".venv").symlink_to((root / ".venv").resolve())
    cache = scratch / REPLIES
    if (folder / REPLIES).is_dir():
        shutil.copytree(folder / REPLIES, cache)
    cache.mkdir(exist_ok=True)
    if not (cache / REFRESHED).exists() and (root / REPLIES / REFRESHED).is_file():
        shutil.copyfile(root / REPLIES / REFRESHED, cache / REFRESHED)
    for name in ("presets", "functions"):
        if (folder / name).is_dir():
            shutil.copytree(folder / name, scratch / name, dirs_exist_ok=True)
    shutil.copyfile(folder / "params.yaml", scratch / "params.yaml")
    if is_own(params.task):
        _add_task(folder, scratch, params.task)
    write_pipeline(scratch, load_params(scratch / "params.yaml", scratch))


def _add_task(folder: Path, scratch: Path, task: str) -> None:
    """Adds the files of a task of its author's own, where the project has none of their names, and names them as a dependency."""
    for path in sorted((folder / "code").rglob("*")):
        target = scratch / path.relative_to(folder / "code")
        if path.is_file() and not target.exists():
            put(path, target)
    place = own_place(task)
    if place not in read_yaml(scratch / "dvc.yaml")["stages"][RESOLVE]["deps"]:
        text = (scratch / "dvc.yaml").read_text(encoding="utf-8")
        (scratch / "dvc.yaml").write_text(_OWN_DEP.sub(rf"\g<0>\n\1- {place}", text, count=1), encoding="utf-8")


def _planned(stages: Sequence[Stage], asked: Sequence[str], shelf: Shelf, scratch: Path) -> Plan:
    """Returns what is to be computed, and puts into the scratch copy what need not be."""
    if not asked:
        return Plan((), tuple(stages), {})
    by_name = {stage.name: stage for stage in stages}
    todo, computed, taken = [*asked], {*asked}, dict[str, str]()
    while todo:
        wanted = by_name[todo.pop()].read
        for stage in stages:
            for path, md5 in stage.outs.items():
                if stage.name in computed or path in taken or not any(overlaps(path, dep) for dep in wanted):
                    continue
                words = shelf.fetch(path, md5, scratch / path)
                if words:
                    taken[path] = words
                else:
                    computed.add(stage.name)
                    todo.append(stage.name)
    return Plan(tuple(asked), tuple(stage for stage in stages if stage.name in computed), taken)


def _reproduce(scratch: Path, plan: Plan, profile: numerics.Profile, say: Callable[[str], None]) -> str:
    """Runs `dvc repro` in the scratch copy, and returns the error of the stage that failed; empty where none did."""
    targets = ["--single-item", RESOLVE, *(stage.target for stage in plan.computed)] if plan.asked else []
    # Whatever the shell says: recorded replies, and no others.
    own = {"PORSE_LLM_MODE": "frozen", "DVC_NO_ANALYTICS": "1"}
    lines: list[str] = []
    with (
        warm_server(profile) as warm,
        subprocess.Popen(
            [*DVC, "repro", "--no-run-cache", *targets],
            cwd=scratch,
            env={**os.environ, **python_of_stages(scratch), **warm, **own},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            preexec_fn=functools.partial(die_with_parent, os.getpid()),
        ) as process,
    ):
        assert process.stdout is not None
        for line in process.stdout:
            if line.strip() and not _ADVICE.match(line):
                lines = [*lines[-_SHOWN:], line.rstrip()]
                say(line.rstrip())
        code = process.wait()
    if not code:
        return ""
    stage = next((line for line in reversed(lines) if line.startswith("ERROR: ")), "")
    found = re.search(r"'([^']+)'", stage)
    named = f"{found[1].replace('iterations/', '').replace('/dvc.yaml:', '/')}: " if found else ""
    return f"{named}{error_in(lines) or (lines or [f'exit code {code}'])[-1]}"


def _difference(
    stage: Stage,
    differ: Sequence[str],
    folder: Path,
    shelf: Shelf,
    scratch: Path,
    params: Params,
    changed: Mapping[str, Changes],
) -> Difference:
    outputs = tuple(path for path in stage.outs if path in differ)
    files: list[str] = []
    for path in outputs:
        kept = scratch / ".published" / path
        if shelf.fetch(path, stage.outs[path], kept):
            files += _files_that_differ(kept, scratch / path, path)
    return Difference(
        stage.name, outputs, tuple(files), tuple(causes(folder, params, changed.get(stage.kind, Changes((), ()))))
    )


def _files_that_differ(then: Path, now: Path, name: str) -> list[str]:
    if not then.is_dir():
        return [name]
    files = {path.relative_to(place) for place in (then, now) for path in place.rglob("*") if path.is_file()}
    return [
        f"{name}/{file.as_posix()}"
        for file in sorted(files)
        if not (
            (then / file).is_file()
            and (now / file).is_file()
            and (then / file).read_bytes() == (now / file).read_bytes()
        )
    ]
