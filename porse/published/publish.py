"""A published run made from a finished one: the workspace after `porse repro`, or the folder that a suite keeps of an entry."""

import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from porse import __version__, tables
from porse.comparison.film import winner_film
from porse.config import Params, leaves, load_document, load_params, presets_root, resolve_document
from porse.documents import render_yaml
from porse.errors import CacheError, PorseError
from porse.generation.answers import FILES
from porse.inputs.files import changed_files
from porse.inputs.resolve import Inputs
from porse.llm.record import Record
from porse.llm.store import REFRESHED, Store
from porse.pipeline import RUN, lock_files
from porse.pool import BEST, policy_file
from porse.presets import SIZES, preset_file
from porse.presets.own import sizes_of
from porse.presets.rules import values_by_rule
from porse.published.card import card
from porse.published.check import REPLIES, check_content
from porse.published.fetch import is_name
from porse.published.inputs import parse_inputs
from porse.published.locks import INPUTS, RESOLVE, Shelf, Stage, digest, is_output, overlaps, put, read_locks
from porse.published.manifest import FOLDER, MANIFEST, MOST_GIT_BYTES, OUTPUTS, OUTPUTS_FILE, make_manifest
from porse.report.answer import Fact
from porse.report.page import no_film, page_of, render
from porse.report.results import Results, read_results
from porse.suite.clone import DVC, call, dvc_cache
from porse.task_names import TASK_CLASSES

MOST_PAGE_BYTES = 2 * 2**20
"""A page that is larger is published without its film: `porse play` shows the winner."""

_SPARE_BYTES = 64 * 2**10
"""Kept free for the card and the manifest."""

_NOT_OWN = ("porse/", "stages/", "prompts/", "functions/", f"{REPLIES}/", "requirements.lock")
"""What of a stage's inputs is no code of the author's own."""

_DVC_CONFIG = """\
['core']
    no_scm = true
    analytics = false
    check_update = false
['cache']
    dir = ../../.dvc/cache
"""
_GITIGNORE = f"/*/{OUTPUTS}/\n/.dvc/config.local\n/.dvc/tmp/\n*.partial\n"


@dataclass(frozen=True)
class Source:
    """A finished run that is to be published.

    Attributes:
        folder: its folder.
        root: the project that it is of.
        params: its parameters.
        stages: what its locks name.
        shelf: where its outputs may be had.
    """

    folder: Path
    root: Path
    params: Params
    stages: Sequence[Stage]
    shelf: Shelf

    def md5(self, path: str) -> str:
        """Returns the MD5 that the locks have of an output, or of what stage `resolve` read; empty where they have none."""
        outs = {name: md5 for stage in self.stages for name, md5 in stage.outs.items()}
        read = {name: md5 for stage in self.stages if stage.name == RESOLVE for name, md5 in stage.deps.items()}
        return {**read, **outs}.get(path, "")

    @property
    def presets(self) -> Path:
        """Where the preset lies that its parameters are laid over."""
        return presets_root(self.folder, self.root)

    @cached_property
    def inputs(self) -> dict[str, tuple[bytes, Inputs]]:
        """The inputs of its stages by the kind of stage, each with the bytes of its file.

        Raises:
            PorseError: a file of them is gone, or holds something else.
        """
        found = {}
        with tempfile.TemporaryDirectory(prefix="porse-") as scratch:
            for path in (out for stage in self.stages for out in stage.outs if out.startswith(f"{INPUTS}/")):
                if not self.shelf.fetch(path, self.md5(path), Path(scratch) / path):
                    raise _gone(self, path)
                data = (Path(scratch) / path).read_bytes()
                found[Path(path).stem] = data, parse_inputs(data, path)
        return found

    @property
    def files(self) -> dict[str, str]:
        """SHA-256 of each file that a stage depends on, by its name."""
        return {name: sha256 for _, own in self.inputs.values() for name, sha256 in own.files.items()}


def publish(
    run: Path, name: str, root: Path, words: str, remote: str | None, replaces: bool, say: Callable[[str], None]
) -> Path:
    """Makes `published/NAME/` of a finished run, and returns it.

    Args:
        run: the run's folder.
        name: the name to publish it under.
        root: the project's root, which must be the working directory.
        words: what its author says of it.
        remote: a folder, or whatever DVC takes as a remote, for all outputs; None for none.
        replaces: whether an earlier run of that name gives way.
        say: told a line about what was made.

    Raises:
        PorseError: the name will not do, the run is not finished or has been changed since, or it is too large for Git.
    """
    target = root / FOLDER / name
    _check_name(name, target, replaces)
    source = _source(run, root)
    _check_unchanged(source)
    _check_finished(source)
    partial = target.with_name(f"{name}.partial")
    if partial.exists():
        shutil.rmtree(partial)
    partial.mkdir(parents=True)
    try:
        _copy_small(source, partial)
        results = read_results(partial)
        _write_page(results, source, partial)
        kept = _copy_policies(source, partial)
        left_out = tuple(path for path in _outputs(source) if not is_output(partial / path, source.md5(path)))
        if remote is not None:
            _add_outputs(source, partial, root)
        facts = [*kept, *_kept_facts(partial, left_out, remote is not None)]
        (partial / "card.md").write_text(card(name, results, words, facts), encoding="utf-8")
        manifest = make_manifest(partial, _program(source), left_out)
        (partial / MANIFEST).write_bytes(manifest.render())
        _check_size(partial)
        check_content(partial, trust=True)
        if target.exists():
            shutil.rmtree(target)
        partial.rename(target)
    finally:
        if partial.exists():
            shutil.rmtree(partial)
    size = sum(file.size for file in manifest.files.values())
    say(f"{target}: {len(manifest.files)} files, {size / 2**20:.2f} MiB; commit it")
    if not manifest.program["commit"]:
        say("its code is no commit's: commit code and locks first, and publish it again, so that readers can find it")
    if remote is not None:
        _push(target, root, remote)
        say(f"{remote}: has all outputs of {name} now, for `dvc pull {name}/{OUTPUTS_FILE}` in {FOLDER}/")
    return target


def _check_name(name: str, target: Path, replaces: bool) -> None:
    if not is_name(name) or name in TASK_CLASSES:
        raise PorseError(
            f"expected a name of at most 60 small letters, digits and dashes for a published run, found {name!r}; choose another"
        )
    if target.exists() and not replaces:
        raise PorseError(
            f"expected no published run of the name {name}, found {target}; choose another name, or give --replace"
        )


def _source(run: Path, root: Path) -> Source:
    if not (run / "dvc.lock").is_file() or not (run / "metrics.json").is_file():
        raise PorseError(
            f"expected a finished run in {run}, found no dvc.lock and metrics.json of one; run `porse repro` there, or name the "
            "folder .porse/suites/SUITE/results/ENTRY of an entry that is done"
        )
    params = load_params(run / "params.yaml", presets_root(run, root))
    folders = [(run, str(run)), (run / OUTPUTS, str(run / OUTPUTS))]
    return Source(run, root, params, read_locks(run), Shelf(folders, dvc_cache(root)))


def _check_unchanged(source: Source) -> None:
    """Checks that the parameters in the run's folder, and the preset that they are laid over, are still those of the run."""
    path = source.folder / "params.yaml"
    if digest(path) != source.md5("params.yaml"):
        raise PorseError(
            f"expected in {path} the parameters that the run in {source.folder} was made with, by its lock, found others; "
            "run `porse repro`, or take the change back"
        )
    now = dict(leaves(resolve_document(load_document(path), str(path), source.presets).document))
    for _, inputs in source.inputs.values():
        for name, value in leaves(inputs.parameters):
            if now.get(name, value) != value:
                raise PorseError(
                    f"expected the parameters that the run in {source.folder} was made with, found {name}: {now[name]!r} in place of "
                    f"{value!r}: the preset, or a set of a method, has changed since; run `porse repro`, or take the change back"
                )


def _check_finished(source: Source) -> None:
    """Checks that each stage read what the stages before it left: a run that was stopped on its way has entries of two runs."""
    whole = _whole_run(source)
    made = {RUN: whole}
    for stage in source.stages:
        # What `resolve` reads nobody makes.
        read = {path: md5 for path, md5 in stage.deps.items() if stage.name != RESOLVE and (path != RUN or whole)}
        old = next((path for path, md5 in read.items() if made.get(path) != md5), None)
        if old is not None:
            raise PorseError(
                f"expected a finished run in {source.folder}, found by its locks that the stage {stage.name} has not run since "
                f"{old} changed; run `porse repro`, which finishes it"
            )
        made |= stage.outs


def _whole_run(source: Source) -> str:
    """Returns the MD5 of the folder `run`, which many stages make together; empty where not all of it lies there as they left it."""
    left = {path: md5 for stage in source.stages for path, md5 in stage.outs.items() if overlaps(path, RUN)}
    if all(is_output(source.folder / path, md5) for path, md5 in left.items()):
        return digest(source.folder / RUN)
    return ""


def _gone(source: Source, path: str) -> PorseError:
    return PorseError(
        f"expected {path} in {source.folder} or in DVC's cache as the run left it, found it gone or changed; run `porse repro` "
        "(a suite's entry: `porse suite run`) again"
    )


def _copy_small(source: Source, target: Path) -> None:
    """Copies all but policies: parameters, locks, inputs, metrics, tables, replies, the machine's record, code of one's own."""
    run, params = source.folder, source.params
    files = [run / "params.yaml", *lock_files(run)]
    for path in files:
        put(path, target / path.relative_to(run))
    for name in ("metrics.json", "results"):
        if not source.shelf.fetch(name, source.md5(name), target / name):
            raise _gone(source, name)
    for kind, (data, _) in source.inputs.items():
        path = target / INPUTS / f"{kind}.json"
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
    _copy_preset(params.task, source.presets, target)
    if (run / "logs" / "environment.json").is_file():
        put(run / "logs" / "environment.json", target / "logs" / "environment.json")
    _copy_replies(source, target)
    changed = changed_files(source.root, source.files)
    for name in sorted(source.files):
        functions = params.generator == FILES and name.startswith(f"functions/{params.generate.functions}/")
        code = not name.startswith(_NOT_OWN)
        if (functions or code) and name in changed:
            raise PorseError(
                f"expected {name} as the run read it, found it changed or gone; run `porse repro`, or take the change back"
            )
        if functions:
            put(source.root / name, target / name)
        elif code:
            put(source.root / name, target / "code" / name)


def _copy_preset(task: str, root: Path, target: Path) -> None:
    """Copies the preset of a task; of one without, the values that follow from its class, which a reader then need not import."""
    path, copy = root / preset_file(task), target / preset_file(task)
    if path.is_file():
        put(path, copy)
        return
    values = {size: values_by_rule(size, sizes_of(task, root, path)) for size in SIZES}
    copy.parent.mkdir(exist_ok=True)
    copy.write_text(render_yaml(values), encoding="utf-8")


def _copy_replies(source: Source, target: Path) -> None:
    """Copies the records that the run's tables name, and those whose longer repetition they name."""
    cache = source.folder / REPLIES if (source.folder / REPLIES).is_dir() else source.root / REPLIES
    rows = tables.read(target / "results" / "replies.parquet", tables.REPLIES)
    used = {row["key"] for row in rows}
    store = Store(cache)
    for key in store.all_keys():
        record = store.read(key) if key in used else _truncated(store, key)
        if record is not None and (key in used or record.request.longer().key in used):
            path = target / REPLIES / store.path(key).relative_to(cache)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(record.render())
    refreshed = cache / REFRESHED
    wanted = source.md5(f"{REPLIES}/{REFRESHED}")
    if refreshed.is_file() and wanted in ("", digest(refreshed)):
        put(refreshed, target / REPLIES / REFRESHED)


def _truncated(store: Store, key: str) -> Record | None:
    """Returns the record of a key where its limit cut it off: the run read it on its way to the longer one; else None."""
    try:
        record = store.read(key)
    except CacheError:
        return None
    return record if record is not None and record.truncated else None


def _write_page(results: Results, source: Source, target: Path) -> None:
    text = render(page_of(results, winner_film(source.params, source.folder)))
    if len(text.encode()) > MOST_PAGE_BYTES:
        text = render(page_of(results, no_film("the page would be too large with it; `porse play` shows the winner.")))
    (target / "report.html").write_text(text, encoding="utf-8")


def _copy_policies(source: Source, target: Path) -> list[Fact]:
    """Copies what iterations start from, as far as there is room: the winners' policies, the last one first, then the rest."""
    room = MOST_GIT_BYTES - _SPARE_BYTES - sum(path.stat().st_size for path in target.rglob("*") if path.is_file())
    names = [f"run/{entry.next}/start" for entry in reversed(source.params.iterations)]
    every = [f"run/{source.params.iterations[0].n}/start", *reversed(names)]
    best = whole = 0
    with tempfile.TemporaryDirectory(prefix="porse-") as place:
        scratch = Path(place)
        for name in every:
            if not source.shelf.fetch(name, source.md5(name), scratch / name):
                raise _gone(source, name)
        for name in names:
            policy = policy_file(scratch / name, BEST)
            size = policy.stat().st_size
            if size > room:
                break
            put(policy, target / policy.relative_to(scratch))
            room, best = room - size, best + 1
        if not best:
            raise PorseError(
                f"expected room for the winner's policy in {MOST_GIT_BYTES} bytes, found {room} left for {size}; the run is too "
                "large to be published here"
            )
        # Whole folders from the front: a replay can begin with an iteration whose start is whole.
        for name in every:
            files = [path for path in (scratch / name).rglob("*") if path.is_file()]
            more = [path for path in files if not (target / path.relative_to(scratch)).exists()]
            size = sum(path.stat().st_size for path in more)
            if size > room:
                break
            for path in more:
                put(path, target / path.relative_to(scratch))
            room, whole = room - size, whole + 1
    return [
        Fact("Policies of winners", f"{best} of {len(names)} iterations"),
        Fact("What iterations start from, whole", f"{whole} of {len(every)} folders"),
    ]


def _outputs(source: Source) -> list[str]:
    """Returns the outputs of all stages, but for the inputs that stage `resolve` writes."""
    return [path for stage in source.stages for path in stage.outs if not path.startswith(f"{INPUTS}/")]


def _kept_facts(folder: Path, left_out: Sequence[str], is_pulled: bool) -> list[Fact]:
    replies = len([*(folder / REPLIES).glob("??/*.json")])
    where = f"`dvc pull {folder.name.removesuffix('.partial')}/{OUTPUTS_FILE}` brings them" if is_pulled else ""
    return [
        Fact("Replies", str(replies), "the records that the run read; a replay reads these and no others"),
        Fact("Outputs that are not here", str(len(left_out)), where or "a replay computes them"),
    ]


def _program(source: Source) -> dict[str, str]:
    """Returns the version of the package, and the commit that the run's code is of; empty where it is of none."""
    watched = sorted({name.partition("/")[0] for name in source.files} - {REPLIES})
    here = not changed_files(source.root, source.files)
    status = subprocess.run(
        ["git", "status", "--porcelain", "--", *watched], cwd=source.root, capture_output=True, text=True
    )
    head = subprocess.run(["git", "rev-parse", "--verify", "HEAD"], cwd=source.root, capture_output=True, text=True)
    clean = here and not status.returncode and not status.stdout.strip() and not head.returncode
    return {"porse": __version__, "commit": head.stdout.strip() if clean else ""}


def _check_size(folder: Path) -> None:
    sizes = {path.relative_to(folder).as_posix(): path.stat().st_size for path in folder.rglob("*") if path.is_file()}
    if sum(sizes.values()) > MOST_GIT_BYTES:
        largest = sorted(sizes, key=lambda name: -sizes[name])[:3]
        said = ", ".join(f"{name} ({sizes[name]} bytes)" for name in largest)
        raise PorseError(
            f"expected a published run of at most {MOST_GIT_BYTES} bytes, found {sum(sizes.values())}; the largest files are {said}"
        )


def _add_outputs(source: Source, target: Path, root: Path) -> None:
    """Puts all outputs into DVC's cache as one folder, and leaves the file that names it."""
    home = root / FOLDER
    (home / ".dvc").mkdir(exist_ok=True)
    if not (home / ".dvc" / "config").exists():
        (home / ".dvc" / "config").write_text(_DVC_CONFIG, encoding="utf-8")
    if not (home / ".gitignore").exists():
        (home / ".gitignore").write_text(_GITIGNORE, encoding="utf-8")
    for path in _outputs(source):
        if not source.shelf.fetch(path, source.md5(path), target / OUTPUTS / path):
            raise _gone(source, path)
    call(home, *DVC, "add", "--quiet", f"{target.name}/{OUTPUTS}")
    shutil.rmtree(target / OUTPUTS)


def _push(target: Path, root: Path, remote: str) -> None:
    home = root / FOLDER
    place = remote if "://" in remote else str(Path(remote).absolute())
    call(home, *DVC, "remote", "add", "--quiet", "--force", "--local", "published", place)
    call(home, *DVC, "push", "--quiet", "--remote", "published", f"{target.name}/{OUTPUTS_FILE}")
