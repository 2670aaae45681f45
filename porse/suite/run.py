"""Runs the entries of a suite: done ones are skipped, a failed one stops nobody else.

One after the other; or, where trainings go to a cluster, as many at once as it has room for. What leaves this machine then are
the trainings: DVC, replies and keys stay here.
"""

import os
import shutil
import subprocess
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

from porse.paths import python_of_stages
from porse.pipeline import lock_files
from porse.processes import die_with_parent
from porse.repair import repair
from porse.stage import LOGS, error_in
from porse.suite.clone import DVC, copy_files, fill_clone, new_clone
from porse.suite.folders import Clone, Folders, folders_of, locked, read_json, write_json
from porse.suite.plan import Suite
from porse.suite.resolve import Resolved, code_id, resolve, tracked_files
from porse.training.cluster import Here, ray_here
from porse.training.executor import uses_ray
from porse.training.remote import is_on_gpu
from porse.warm.start import warm_server

_KEPT_LINES = 20
"""Lines of a failed entry's log that are kept with it."""

_MET_ANOTHER = "without a confirmation"
"""How DVC refuses to replace a file that it does not find in its cache."""

_TRIES = 3
"""How often DVC is started at most."""


def run_suite(suite: Suite, root: Path, where: str, say: Callable[[str], None]) -> list[str]:
    """Runs what is not done yet, and returns the names of the entries that failed.

    All entries run with the tracked files as they are at the start; editing them meanwhile changes nothing here.

    Args:
        suite: the suite.
        root: the project's root.
        where: names the suite's file in errors.
        say: told one line when an entry starts and when it ends.

    Raises:
        ParamsError: the parameters of an entry are wrong; nothing has run then.
        PorseError: the suite is running already, or Git or DVC does not work here.
    """
    folders = folders_of(suite.name, root)
    with locked(folders.lock) as lock, ExitStack() as servers:
        files = tracked_files(root)
        if folders.source.exists():
            shutil.rmtree(folders.source)
        copy_files(files, root, folders.source)
        entries = resolve(suite, root, code_id(folders.source, files), where)
        waiting: list[tuple[str, Resolved]] = []
        for number, resolved in enumerate(entries, start=1):
            label = f"[{number}/{len(entries)}] {resolved.entry.name}"
            if is_done(folders, resolved):
                say(f"{label}: was done before")
            else:
                waiting.append((label, resolved))
        if not waiting:
            return []
        cluster = servers.enter_context(ray_here()) if uses_ray() else None
        at_once = 1 if cluster is None else entries_at_once(cluster, [resolved for _, resolved in waiting])
        around = {} if cluster is None else cluster.environment
        profiles = {resolved.params["numerics"] for _, resolved in waiting}
        warm = {profile: {**servers.enter_context(warm_server(profile)), **around} for profile in sorted(profiles)}

        def run(labelled: tuple[str, Resolved]) -> list[str]:
            """Runs an entry, and returns its name where it failed."""
            label, resolved = labelled
            name = resolved.entry.name
            say(f"{label}: runs, see {folders.log(name).relative_to(root)}")
            clone = folders.clone if at_once == 1 else folders.clone_of(name)
            if _run_entry(folders, clone, resolved, files, root, lock, warm[resolved.params["numerics"]]):
                say(f"{label}: done")
                return []
            say(f"{label}: failed: {failure(folders, name)}")
            return [name]

        if at_once == 1:
            return [name for labelled in waiting for name in run(labelled)]
        # Threads that wait. A process that one of them has started ends with it, so that they live as long as the pool.
        with ThreadPoolExecutor(at_once) as threads:
            return [name for failed in threads.map(run, waiting) for name in failed]


def entries_at_once(cluster: Here, entries: Sequence[Resolved]) -> int:
    """Returns how many entries fill a cluster: each trains about as many candidates at once as it begins with."""
    on_gpus = any(is_on_gpu(resolved.params.get("device", "cpu")) for resolved in entries)
    candidates = max(resolved.params["generate"]["candidates"] for resolved in entries)
    return max(1, (cluster.gpus if on_gpus else cluster.cpus) // candidates)


def is_done(folders: Folders, resolved: Resolved) -> bool:
    """Returns whether an entry is done, with these parameters and this code."""
    result = folders.result(resolved.entry.name)
    return read_json(result / "done.json") == resolved.ids and (result / "metrics.json").is_file()


def failure(folders: Folders, name: str) -> str | None:
    """Returns why an entry failed, as one line; None when it did not."""
    record = read_json(folders.result(name) / "failed.json")
    if record is None:
        return None
    lines = record["last_lines"]
    return error_in(lines) or (lines or [f"exit code {record['exit_code']}"])[-1]


def _run_entry(
    folders: Folders,
    clone: Clone,
    resolved: Resolved,
    files: Sequence[str],
    root: Path,
    lock: int,
    warm: Mapping[str, str],
) -> bool:
    """Runs one entry, from where it was left if the clone is its own; returns whether it got to its end."""
    name = resolved.entry.name
    current = {"entry": name, **resolved.ids}
    if read_json(clone.current) != current:
        clone.current.unlink(missing_ok=True)
        new_clone(clone.work, root)
    (folders.result(name) / "failed.json").unlink(missing_ok=True)
    fill_clone(clone.work, files, folders.source, root, resolved.params)
    write_json(clone.current, current)
    repair(clone.work)
    log = folders.log(name)
    log.parent.mkdir(parents=True, exist_ok=True)
    code = _reproduce_in_company(clone.work, log, lock, warm)
    result = folders.result(name)
    _set_aside(result, folders.earlier(name))
    result.mkdir(parents=True)
    if code:
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
        last = [line.rstrip() for line in lines if line.strip()][-_KEPT_LINES:]
        write_json(result / "failed.json", {**resolved.ids, "exit_code": code, "last_lines": last})
        return False
    locks = [path.relative_to(clone.work) for path in lock_files(clone.work)]
    for kept in (Path("metrics.json"), Path("params.yaml"), *locks):
        (result / kept).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(clone.work / kept, result / kept)
    shutil.copytree(clone.work / "results", result / "results")
    # The machine's record is not tracked: an entry whose stages all came from DVC's cache leaves none.
    if (clone.work / LOGS).is_dir():
        shutil.copytree(clone.work / LOGS, result / LOGS)
    # The policy that the run ended with, for `porse play` and `porse export`.
    end = Path("run", str(resolved.params["iterations"][-1]["next"]), "start")
    shutil.copytree(clone.work / end, result / end)
    write_json(result / "done.json", resolved.ids)
    if clone != folders.clone:
        # Nobody else will use it.
        shutil.rmtree(clone.work.parent)
    return True


def _set_aside(result: Path, earlier: Path) -> None:
    """Makes way for a new result: one that was done becomes the earlier one, a failed one is removed."""
    if not result.exists():
        return
    if not (result / "done.json").is_file():
        shutil.rmtree(result)
        return
    if earlier.exists():
        shutil.rmtree(earlier)
    earlier.parent.mkdir(parents=True, exist_ok=True)
    result.rename(earlier)


def _reproduce_in_company(work: Path, log: Path, lock: int, warm: Mapping[str, str]) -> int:
    """Runs `dvc repro` in the clone, again where another suite got in its way; returns the last exit code.

    Clones share DVC's cache. While one of them adds an object, another one that adds the same object may find half of it there,
    take it for damaged, and stop. The next start finds it whole.
    """
    for _ in range(_TRIES - 1):
        code = _reproduce(work, log, lock, warm)
        if not code or _MET_ANOTHER not in log.read_text(encoding="utf-8", errors="replace"):
            return code
    return _reproduce(work, log, lock, warm)


def _reproduce(work: Path, log: Path, lock: int, warm: Mapping[str, str]) -> int:
    """Runs `dvc repro` in the clone, and returns its exit code.

    It holds the suite's lock too, and ends with this process: nobody else ever works in the clone.

    Args:
        work: the clone.
        log: the file for its output.
        lock: the suite's lock.
        warm: the environment variables by which stages find a warm server.
    """
    with log.open("wb") as output:
        return subprocess.run(
            [*DVC, "repro"],
            cwd=work,
            env={**os.environ, **python_of_stages(work), **warm},
            stdout=output,
            stderr=subprocess.STDOUT,
            pass_fds=(lock,),
            preexec_fn=die_with_parent,
        ).returncode
