"""`porse doctor`: what a run needs of the machine, the packages, the project and its folders, checked one by one."""

import json
import os
import platform
import re
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Literal

import click

from porse import numerics
from porse.config import Params, load_params
from porse.errors import CacheError, ParamsError, PorseError
from porse.functions.read.confine import filters_calls
from porse.llm.store import Store
from porse.paths import has_own_package, project_root
from porse.pipeline import check_pipeline
from porse.printing import echo
from porse.processes import memory_mib
from porse.renderer import draws
from porse.report.answer import author_of
from porse.repro import has_source_control
from porse.training.limits import WORKERS_VARIABLE, cpus, workers
from porse.training.memory import check_memory

State = Literal["ok", "warning", "problem"]

TRAINING_MIB = 600
"""A training of Quadcopter fills 345 MiB, libraries included; larger scenes and `size: paper` take more."""

DISK_NEEDED_MIB, DISK_WANTED_MIB = 200, 2048
"""A default run leaves about 80 MiB, twice that where DVC copies; a suite of 20 leaves about 2 GiB."""

RECORDS_READ = 2000
"""So many recorded replies are read at most, in about a second, spread over the cache: `porse llm verify` reads all."""

_PIN = re.compile(r"^([A-Za-z0-9._-]+)==([^\s;]+)")
_WRITTEN = ("", "run", "inputs", "evaluation", "results", "plots", "logs", "iterations", ".porse", ".dvc", ".dvc/tmp")
"""Folders below the root that a run writes into."""


@dataclass(frozen=True)
class Finding:
    """What one check found.

    Attributes:
        check: what was looked at.
        state: `ok`; `warning`, a run works but not all of it, or not as it should; `problem`, a run fails.
        found: what there is, in a sentence.
        advice: what to do about it, empty where nothing need be done.
    """

    check: str
    state: State
    found: str
    advice: str = ""


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list of objects.")
def doctor(as_json: bool) -> None:
    """Check machine, packages, renderer, recorded replies and folders, and say what to do; exit 1 if a run would fail."""
    findings = examine(Path())
    if as_json:
        echo(json.dumps([asdict(finding) for finding in findings], indent=2))
    else:
        echo(findings_text(findings, shutil.get_terminal_size((100, 24)).columns))
    sys.exit(1 if any(finding.state == "problem" for finding in findings) else 0)


def examine(root: Path) -> list[Finding]:
    """Returns what all checks found, those of the project in `root` included where one is there."""
    return [*_machine(root), *_project(root)]


def findings_text(findings: list[Finding], width: int) -> str:
    """Returns the findings as lines of at most `width` columns, what to do below each, and a last line that counts them."""
    lines: list[str] = []
    start = max(len(finding.check) for finding in findings) + 10
    for finding in findings:
        head = f"{finding.state:8}{finding.check:{start - 8}}"
        lines += textwrap.wrap(
            f"{head}{finding.found}", max(width, start + 30), subsequent_indent=" " * start, break_on_hyphens=False
        )
        if finding.advice:
            lines += textwrap.wrap(
                f"-> {finding.advice}",
                max(width, start + 30),
                initial_indent=" " * start,
                subsequent_indent=" " * (start + 3),
                break_on_hyphens=False,
            )
    counts = [sum(finding.state == state for finding in findings) for state in ("problem", "warning")]
    said = [
        f"{count} {name}{'' if count == 1 else 's'}" for count, name in zip(counts, ("problem", "warning"), strict=True)
    ]
    return "\n".join([*lines, "", f"{said[0]}, {said[1]}"])


def _machine(root: Path) -> Iterator[Finding]:
    params = _read_params(root)
    yield python()
    yield cpu(params.numerics if params else "portable")
    yield cores_and_memory()
    yield confinement()
    yield packages(root / "requirements.lock")
    yield git()
    yield renderer()


def _project(root: Path) -> Iterator[Finding]:
    if project_root(root.resolve()) is None:
        yield Finding(
            "project",
            "problem",
            f"no dvc.yaml and params.yaml in {root.resolve()} or above",
            "run from a clone of the project, or from any folder below it",
        )
        return
    yield parameters(root)
    yield source_control(root)
    params = _read_params(root)
    yield replies(root / "llm_cache", params is None or _needs_replies(params))
    yield dvc_cache(root)
    yield permissions(root)
    yield disk(root)


def _read_params(root: Path) -> Params | None:
    try:
        return load_params(root / "params.yaml", root)
    except (PorseError, OSError):
        return None


def python() -> Finding:
    """Returns which Python this is; an older one than 3.11 cannot even import this."""
    return Finding("Python", "ok", f"{platform.python_version()} in {sys.prefix}")


def cpu(profile: numerics.Profile) -> Finding:
    """Returns whether the CPU has the instructions of a numeric profile, and what its results are worth elsewhere."""
    machine, model = platform.machine(), numerics.cpu_model()
    name = f"{model or 'unknown model'}, {machine}"
    flags = numerics.cpu_flags()
    lacking = sorted({"avx2", "fma"} - flags)
    if machine not in ("x86_64", "AMD64"):
        return Finding(
            "CPU",
            "warning",
            f"{name}: no x86-64 CPU; results are the same from run to run here, but the bits differ from the committed locks",
            "nothing, if figures are enough; take an x86-64 CPU with AVX2 to get the bits that the locks name",
        )
    if lacking and profile == "portable":
        return Finding(
            "CPU",
            "problem",
            f"{name}: without {' and '.join(lacking)}, which numerics: portable needs",
            "take a CPU with AVX2 and FMA, or set numerics: fast in params.yaml, which ends with other bits",
        )
    if lacking or profile == "fast":
        without = f"without {' and '.join(lacking)}, so numerics: portable cannot run; " if lacking else ""
        return Finding(
            "CPU",
            "warning",
            f"{name}: {without}numerics: fast gives the same bits on one kind of CPU only",
            "nothing, if runs are compared on this machine alone; else set numerics: portable on a CPU with AVX2",
        )
    return Finding("CPU", "ok", f"{name}: has AVX2 and FMA; numerics: portable gives the bits that the locks name")


def confinement() -> Finding:
    """Returns whether functions that a model wrote are tried without system calls that reach files or other processes."""
    if filters_calls():
        return Finding("confinement", "ok", "system calls of generated functions are filtered")
    return Finding(
        "confinement",
        "warning",
        "this system cannot filter the system calls of generated functions: only the static check and limits of resources stand "
        "before your files",
        "try functions and runs of strangers in a container or a virtual machine, or on Linux on x86-64 or ARM64",
    )


def cores_and_memory() -> Finding:
    """Returns whether memory is enough for as many trainings at once as there are cores, or as PORSE_WORKERS says."""
    memory = memory_mib()
    there = f"{cpus()} cores, {memory / 1024:.1f} GiB of memory"
    try:
        at_once = workers()
    except ParamsError as error:
        return Finding(
            "cores, memory",
            "problem",
            f"{there}; {error}",
            f"set {WORKERS_VARIABLE} to a whole number from 1, or unset it",
        )
    found = f"{there}; {at_once} trainings at once"
    if memory < TRAINING_MIB:
        return Finding("cores, memory", "problem", found, f"take a machine with {TRAINING_MIB} MiB of memory at least")
    if memory < at_once * TRAINING_MIB:
        fewer = max(1, memory // TRAINING_MIB)
        return Finding(
            "cores, memory",
            "warning",
            f"{found}, which need {TRAINING_MIB} MiB each",
            f"set {WORKERS_VARIABLE}={fewer}: it changes no result",
        )
    return Finding("cores, memory", "ok", found)


def packages(lock: Path) -> Finding:
    """Returns whether the packages of the lock are installed in its versions; a project of `porse init` may have others."""
    try:
        text = lock.read_text(encoding="utf-8")
    except OSError:
        return Finding(
            "packages",
            "warning",
            f"no {lock.name} to compare the installed packages with",
            "run from a clone of the project, or from any folder below it",
        )
    pins = [match.groups() for line in text.splitlines() if (match := _PIN.match(line))]
    wrong = []
    for name, version in pins:
        try:
            found = metadata.version(name)
        except metadata.PackageNotFoundError:
            found = "none"
        # What comes after +, as in 2.13.0+cpu, names a build of the same version.
        if found.split("+")[0] != version.split("+")[0]:
            wrong.append(f"{name} {found} instead of {version}")
    if wrong:
        more = f" and {len(wrong) - 5} more" if len(wrong) > 5 else ""
        return Finding(
            "packages",
            "problem" if has_own_package(lock.parent) else "warning",
            f"expected the {len(pins)} versions of {lock.name}, found {', '.join(wrong[:5])}{more}",
            "make setup, or: pip install --requirement requirements.lock, which gives the bits that others get",
        )
    return Finding("packages", "ok", f"all {len(pins)} as in {lock.name}")


def git() -> Finding:
    """Returns whether Git can be called."""
    try:
        done = subprocess.run(["git", "--version"], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return Finding("Git", "problem", "no git on the PATH", "install git: DVC and suites call it")
    return Finding("Git", "ok", done.stdout.strip())


def renderer() -> Finding:
    """Returns whether a picture can be drawn, and by what; a process of its own draws one, since drivers may crash."""
    try:
        back_end = draws()
    except PorseError as error:
        found, _, advice = str(error).partition("; ")
        return Finding("renderer", "warning", f"{found}; `porse render` and `porse play` do not work", advice)
    return Finding("renderer", "ok", f"{back_end}: a picture was drawn")


def parameters(root: Path) -> Finding:
    """Returns whether params.yaml is right, the pipeline the one that it asks for, and memory enough for it."""
    try:
        params = load_params(root / "params.yaml", root)
        check_pipeline(root, params)
        check_memory(params)
    except (PorseError, OSError) as error:
        return Finding("parameters", "problem", str(error), "fix what it says")
    return Finding("parameters", "ok", f"{params.method} on {params.task}, numerics: {params.numerics}")


def source_control(root: Path) -> Finding:
    """Returns whether the project is a Git repository, which DVC and suites want."""
    if has_source_control(root):
        return Finding("repository", "ok", "a Git repository, or one that DVC is told to do without")
    return Finding(
        "repository",
        "problem",
        f"no .git in {root.resolve()} or above, as in an unpacked source archive; DVC refuses to run",
        "take a clone, or run: git init && git add . && git commit -m start",
    )


def _needs_replies(params: Params) -> bool:
    """Returns whether a run stops where a question has no reply."""
    return author_of(params) == "model" and params.llm.on_miss == "error"


def replies(cache: Path, needed: bool) -> Finding:
    """Returns whether recorded replies can be read and are what they were, and whether more can be recorded.

    Args:
        cache: the folder of the replies.
        needed: whether a run stops without them.
    """
    store = Store(cache)
    try:
        keys = list(store.all_keys())
        step = max(1, -(-len(keys) // RECORDS_READ))
        read = [store.read(key) for key in keys[::step]]
    except (CacheError, OSError) as error:
        return Finding(
            "reply cache", "problem", str(error), "restore it with: git checkout llm_cache; then porse llm verify"
        )
    if not needed and not keys:
        return Finding("reply cache", "ok", f"no recorded replies in {cache}, and params.yaml asks for none")
    if not keys:
        return Finding(
            "reply cache",
            "warning",
            f"no recorded replies in {cache}: a run has to ask a model",
            "git checkout llm_cache brings the committed ones back; generator: grammar needs none",
        )
    found = f"{len(keys)} recorded replies, {len(read)} of them read and verified"
    if needed and not os.access(cache, os.W_OK):
        return Finding(
            "reply cache",
            "warning",
            f"{found}; read-only: a run replays, and cannot record",
            f"chmod -R u+w {cache}, to record",
        )
    return Finding("reply cache", "ok", f"{found}; writable" if needed else f"{found}; params.yaml asks for none")


def dvc_cache(root: Path) -> Finding:
    """Returns whether DVC has its folder and can write its cache."""
    if not (root / ".dvc").is_dir():
        return Finding("DVC cache", "problem", f"no .dvc in {root.resolve()}", "git checkout .dvc, or: dvc init")
    done = subprocess.run(
        [sys.executable, "-m", "dvc", "cache", "dir"], cwd=root, capture_output=True, text=True, check=False
    )
    if done.returncode:
        said = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        return Finding("DVC cache", "problem", f"`dvc cache dir` says: {said}", "fix what it says")
    cache = root / done.stdout.strip()
    place = _nearest(cache)
    if not os.access(place, os.W_OK | os.X_OK):
        return Finding(
            "DVC cache", "problem", f"{place} is read-only", f"chmod -R u+w {place}, or: dvc cache dir --local FOLDER"
        )
    free = shutil.disk_usage(place).free // 2**20
    if free < DISK_NEEDED_MIB:
        return Finding(
            "DVC cache", "problem", f"{cache}: {free} MiB free", "make room, or: dvc cache dir --local FOLDER"
        )
    return Finding("DVC cache", "ok", f"{cache}: writable, {free / 1024:.1f} GiB free")


def permissions(root: Path) -> Finding:
    """Returns whether all folders that a run writes into can be written."""
    folders = [folder for name in _WRITTEN if (folder := root / name).exists()]
    wrong = [str(folder) for folder in folders if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK)]
    if wrong:
        return Finding(
            "permissions",
            "problem",
            f"cannot write into {', '.join(wrong)}",
            "chmod u+rwx them, or chown them to yourself: a command run by another user may have made them",
        )
    return Finding("permissions", "ok", f"all {len(folders)} folders that a run writes into are writable")


def disk(root: Path) -> Finding:
    """Returns whether there is room for a run."""
    free = shutil.disk_usage(root).free // 2**20
    found = f"{free / 1024:.1f} GiB free in {root.resolve()}"
    advice = (
        f"make room: a default run takes up to {DISK_NEEDED_MIB} MiB, a suite of twenty about {DISK_WANTED_MIB} MiB"
    )
    if free < DISK_NEEDED_MIB:
        return Finding("disk", "problem", found, advice)
    return Finding("disk", "warning", found, advice) if free < DISK_WANTED_MIB else Finding("disk", "ok", found)


def _nearest(path: Path) -> Path:
    """Returns a path, or the nearest folder above it that is there."""
    return next(place for place in (path, *path.resolve().parents) if place.exists())
