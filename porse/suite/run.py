"""Runs the entries of a suite, one after the other: done ones are skipped, a failed one stops nobody else."""

import os
import shutil
import subprocess
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

from porse.paths import python_of_stages
from porse.pipeline import FOLDER as ITERATIONS
from porse.processes import die_with_parent
from porse.repair import repair
from porse.suite.clone import DVC, copy_files, fill_clone, new_clone
from porse.suite.folders import Folders, folders_of, locked, read_json, write_json
from porse.suite.plan import Suite
from porse.suite.resolve import Resolved, code_id, resolve, tracked_files
from porse.warm.start import warm_server

_KEPT_LINES = 20
"""Lines of a failed entry's log that are kept with it."""


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
        failed, warm = [], dict[str, Mapping[str, str]]()
        for number, resolved in enumerate(entries, start=1):
            name = resolved.entry.name
            label = f"[{number}/{len(entries)}] {name}"
            if is_done(folders, resolved):
                say(f"{label}: was done before")
                continue
            say(f"{label}: runs, see {folders.log(name).relative_to(root)}")
            profile = resolved.params["numerics"]
            if profile not in warm:
                warm[profile] = servers.enter_context(warm_server(profile))
            if _run_entry(folders, resolved, files, root, lock, warm[profile]):
                say(f"{label}: done")
            else:
                failed.append(name)
                say(f"{label}: failed: {failure(folders, name)}")
        return failed


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
    # A stage says what is wrong in a line of this form; what DVC adds says only which stage it was.
    own = [line.removeprefix("Error: ") for line in lines if line.startswith("Error: ")]
    return (own or lines or [f"exit code {record['exit_code']}"])[-1]


def _run_entry(
    folders: Folders, resolved: Resolved, files: Sequence[str], root: Path, lock: int, warm: Mapping[str, str]
) -> bool:
    """Runs one entry, from where it was left if the clone is its own; returns whether it got to its end."""
    name = resolved.entry.name
    current = {"entry": name, **resolved.ids}
    if read_json(folders.current) != current:
        folders.current.unlink(missing_ok=True)
        new_clone(folders.work, root)
    (folders.result(name) / "failed.json").unlink(missing_ok=True)
    fill_clone(folders.work, files, folders.source, root, resolved.params)
    write_json(folders.current, current)
    repair(folders.work)
    log = folders.log(name)
    log.parent.mkdir(exist_ok=True)
    code = _reproduce(folders.work, log, lock, warm)
    result = folders.result(name)
    _set_aside(result, folders.earlier(name))
    result.mkdir(parents=True)
    if code:
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
        last = [line.rstrip() for line in lines if line.strip()][-_KEPT_LINES:]
        write_json(result / "failed.json", {**resolved.ids, "exit_code": code, "last_lines": last})
        return False
    locks = [path.relative_to(folders.work) for path in folders.work.glob(f"{ITERATIONS}/*/dvc.lock")]
    for kept in (Path("metrics.json"), Path("params.yaml"), Path("dvc.lock"), *locks):
        (result / kept).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(folders.work / kept, result / kept)
    shutil.copytree(folders.work / "results", result / "results")
    # The policy that the run ended with, for `porse play` and `porse export`.
    end = Path("run", str(resolved.params["iterations"][-1]["next"]), "start")
    shutil.copytree(folders.work / end, result / end)
    write_json(result / "done.json", resolved.ids)
    return True


def _set_aside(result: Path, earlier: Path) -> None:
    """Makes way for a new result: one that was done becomes the earlier one, a failed one is taken away."""
    if not result.exists():
        return
    if not (result / "done.json").is_file():
        shutil.rmtree(result)
        return
    if earlier.exists():
        shutil.rmtree(earlier)
    earlier.parent.mkdir(parents=True, exist_ok=True)
    result.rename(earlier)


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
