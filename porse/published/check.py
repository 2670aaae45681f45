"""What is in the files of a published run, held against their declarations, in a process with limits on memory and time.

A table of a megabyte can claim to be one of a terabyte, and a text of a kilobyte to be deeper than any stack. Nothing of what
this process reads is run; what it cannot read within its limits is refused, by the name of the file that it was at.
"""

import json
import resource
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from porse import tables
from porse.checkpoint import check_networks, read_checkpoint
from porse.config import ROOT, Params, load_document, load_params
from porse.errors import PorseError
from porse.generation.answers import FILES, GRAMMAR, SPLICED
from porse.llm.store import REFRESHED
from porse.llm.verify import verify
from porse.printing import visible
from porse.processes import die_with_parent, limit_memory
from porse.published.inputs import is_visible, parse_inputs
from porse.published.locks import INPUTS, RESOLVE, Stage, check_pipeline_of, digest, is_output, read_locks
from porse.published.manifest import refused
from porse.published.shapes import policy_shapes
from porse.report.results import read_results
from porse.tables import Table
from porse.task_names import is_own

MEMORY_MIB, SECONDS = 3072, 300
"""What the check of a run may take; that of a tiny one takes half a second of computing."""

MOST_TEXT_BYTES = 2 * 2**20
"""Of a parameter file, a preset, a lock, the inputs of a stage."""

REPLIES = "llm_cache"

_AT = "at: "
_START_TABLES: dict[str, Table] = {
    "winner": tables.CANDIDATES,
    "score": tables.SURVIVORS,
    "feedback": tables.FEEDBACK,
    "members": tables.MEMBERS,
    "member_feedback": tables.MEMBER_FEEDBACK,
}


def check_content(folder: Path, trust: bool, memory_mib: int = MEMORY_MIB) -> None:
    """Checks what the files of a published run hold, in a process of its own; their bytes have been checked.

    Args:
        folder: the run.
        trust: whether its task may be its author's own, and its code be run later.
        memory_mib: what the check may take beyond what the libraries do.

    Raises:
        PorseError: a file is not what it should be; it is named.
    """
    command = [
        sys.executable,
        "-m",
        "porse.published.check",
        str(folder),
        "trust" if trust else "check",
        str(memory_mib),
    ]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=2 * SECONDS, errors="replace")
    except subprocess.TimeoutExpired:
        raise refused(str(folder), f"files that are read within {2 * SECONDS} s", "some that are not") from None
    if not done.returncode:
        return
    lines = done.stdout.splitlines()
    if lines and not lines[-1].startswith(_AT):
        raise PorseError(lines[-1])
    name = lines[-1].removeprefix(_AT) if lines else ""
    last = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
    raise refused(
        str(folder / name), f"a file that is read within {memory_mib} MiB and {SECONDS} s", f"none such ({last[:200]})"
    )


def read_params(folder: Path, trust: bool) -> Params:
    """Returns the parameters of a published run.

    Raises:
        PorseError: they are wrong, or the task is its author's own and is not trusted.
    """
    document = load_document(folder / "params.yaml")
    task = document.get("task") if isinstance(document, dict) else None
    if isinstance(task, str) and is_own(task) and not trust:
        raise PorseError(
            f"refused: expected a task of this package in {folder / 'params.yaml'}, found {task[:100]!r}, which is its author's "
            "code; read what is in code/, and give --trust to run it with your rights"
        )
    return load_params(folder / "params.yaml", folder)


def check_all(folder: Path, trust: bool, at: Callable[[str], None]) -> None:
    """Checks the files of a published run one after the other, in this process.

    Args:
        folder: the run.
        trust: as for `check_content`.
        at: is told the name of each file before it is read.

    Raises:
        PorseError: a file is not what it should be.
    """
    for path in _texts(folder):
        at(path.relative_to(folder).as_posix())
        if path.stat().st_size > MOST_TEXT_BYTES:
            raise refused(str(path), f"at most {MOST_TEXT_BYTES} bytes", "more")
    at("params.yaml")
    params = read_params(folder, trust)
    at("dvc.lock")
    stages = read_locks(folder)
    check_pipeline_of(stages, params, ROOT, folder)
    for path in sorted(folder.glob("inputs/*.json")):
        at(f"inputs/{path.name}")
        parse_inputs(path.read_bytes(), str(path))
    at("logs/environment.json")
    _check_environment(folder / "logs" / "environment.json")
    for path in sorted(folder.glob("results/*.parquet")):
        at(f"results/{path.name}")
        if path.stem not in tables.TABLES:
            raise refused(str(path), "a table that `porse tables` names", "another one")
        tables.read(path, tables.TABLES[path.stem])
    at("results")
    results = read_results(folder)
    if results.params.task != params.task:
        # Whose code may run is decided by params.yaml, and the results are read with the parameters of the inputs.
        raise refused(str(folder / "inputs"), "the task of params.yaml", "another one")
    for path in sorted(folder.glob("run/*/start/*.parquet")):
        at(path.relative_to(folder).as_posix())
        if path.stem not in _START_TABLES:
            raise refused(str(path), f"one of the tables {', '.join(_START_TABLES)}", "another one")
        tables.read(path, _START_TABLES[path.stem])
    for path in sorted(folder.glob("run/*/start/policies/*.safetensors")):
        at(path.relative_to(folder).as_posix())
        policy = read_checkpoint(path)
        # What is a policy of its author's own task shows when its code is run.
        if not is_own(params.task):
            check_networks(policy, policy_shapes(params), params.task, path)
    at(REPLIES)
    written = (FILES, GRAMMAR, SPLICED)
    _check_replies(folder, {row["key"] for row in results.run.replies if row["answered_by"] not in written})
    _check_agreement(folder, stages, at)


def _texts(folder: Path) -> Iterator[Path]:
    for pattern in ("params.yaml", "presets/*", "**/dvc.lock", "inputs/*", "metrics.json", "logs/*", "outputs.dvc"):
        yield from sorted(folder.glob(pattern))


def _check_environment(path: Path) -> None:
    try:
        document = json.loads(path.read_bytes())
        fine = all(isinstance(value, str) for value in document.values()) and is_visible(document, keep="")
    except FileNotFoundError:
        return
    except (ValueError, AttributeError, RecursionError):
        fine = False
    if not fine:
        raise refused(str(path), "names and values of a machine, without control characters", "something else")


def _check_replies(folder: Path, used: set[str]) -> None:
    cache = folder / REPLIES
    if not cache.is_dir():
        if used:
            raise refused(str(cache), f"the {len(used)} replies that its tables name", "none")
        return
    problems = verify(cache, used)
    if problems:
        raise refused(str(cache), f"replies that are what they were, found in its tables ({problems[0]})", "others")


def _check_agreement(folder: Path, stages: list[Stage], at: Callable[[str], None]) -> None:
    """Checks that what was published is what the locks name; a folder of which a part was left out cannot be compared."""
    at("params.yaml")
    named = {path: md5 for stage in stages for path, md5 in stage.outs.items()}
    read = {path: md5 for stage in stages if stage.name == RESOLVE for path, md5 in stage.deps.items()}
    for path in ("params.yaml", f"{REPLIES}/{REFRESHED}"):
        if path in read and (folder / path).is_file() and digest(folder / path) != read[path]:
            raise refused(str(folder / path), "the file that the run read, by its lock", "another one")
    for path, md5 in named.items():
        at(path)
        whole = path in ("metrics.json", "results") or path.startswith(f"{INPUTS}/")
        if whole and (folder / path).exists() and not is_output(folder / path, md5):
            raise refused(str(folder / path), "what the lock names", "something else")
    for start in sorted(folder.glob("run/*/start")):
        if start.relative_to(folder).as_posix() not in named:
            raise refused(str(start), "only what the lock names", "another folder")


def main(folder: Path, trust: bool, memory_mib: int) -> int:
    """Checks a run in this process, which takes limits upon itself first; prints what it is at, and the error; returns its code."""
    die_with_parent()
    limit_memory(memory_mib)
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    try:
        check_all(folder, trust, lambda name: print(f"{_AT}{name}", flush=True))
    except PorseError as error:
        print(visible(" ".join(str(error).split())), flush=True)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2] == "trust", int(sys.argv[3])))
