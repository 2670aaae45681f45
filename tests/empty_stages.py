"""What DVC itself takes: a project whose stages do nothing but write a byte, run by `dvc repro`. For tests and figures.

`python tests/empty_stages.py [ITERATIONS ...]` prints a row for each number of iterations.
"""

import resource
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tiny import committed_params, dvc, make_project

PYTHON = """#!/bin/sh
# A stage in name only: every folder or file that it would write holds one byte, or for resolve, its parameters' text.
set -e
shift
name=$1
shift
while [ $# -gt 0 ]; do
    case "$1" in
        --out) out=$2 ;;
        --results) mkdir -p "$2"; echo 1 > "$2/a" ;;
        --plots) mkdir -p "$2"; echo 'epoch,fitness' > "$2/fitness.csv"; echo 'iteration,mts' > "$2/iterations.csv" ;;
        --metrics) echo '{}' > "$2" ;;
    esac
    shift 2
done
case "$name" in
    stages.resolve) mkdir -p "$out"; for stage in begin eliminate evaluate fuse generate mutate summarise train-population validate-code; do
        echo 1 > "$out/$stage.json"; done ;;
    stages.summarise) ;;
    *) mkdir -p "$out"; echo "$out" > "$out/a" ;;
esac
"""


@dataclass(frozen=True)
class Cost:
    """What `dvc repro` took.

    Attributes:
        stages: how many stages it ran.
        cpu: seconds of computing, of DVC and of the shells that it started.
        wall: seconds on the clock.
        lock_lines: lines of all lock files, and of the longest one.
        again: seconds of computing of a second `dvc repro`, with nothing to do.
        again_wall: the same on the clock.
    """

    stages: int
    cpu: float
    wall: float
    lock_lines: tuple[int, int]
    again: float
    again_wall: float


def params_of(iterations: int) -> dict[str, Any]:
    """Returns the committed parameters with so many iterations."""
    entries = [{"n": n, "next": n + 1} for n in range(1, iterations)]
    return {**committed_params(), "iterations": [*entries, {"n": iterations, "next": "result"}]}


def cost_of(folder: Path, iterations: int) -> Cost:
    """Runs a project of that many iterations in an empty folder."""
    venv = folder / "venv"
    (venv / "bin").mkdir(parents=True)
    (venv / "bin" / "python").write_text(PYTHON)
    (venv / "bin" / "python").chmod(0o755)
    project = make_project(folder / "project", params_of(iterations), venv)
    first, cpu, wall = _timed(project)
    second, again, again_wall = _timed(project)
    assert "Running stage" not in second
    lines = [len(path.read_text().splitlines()) for path in project.rglob("dvc.lock")]
    return Cost(first.count("Running stage"), cpu, wall, (sum(lines), max(lines)), again, again_wall)


def _timed(project: Path) -> tuple[str, float, float]:
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    output = dvc(project, "repro", timeout_s=1200).stdout
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return output, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, time.monotonic() - started


if __name__ == "__main__":
    for count in map(int, sys.argv[1:] or ["5"]):
        with tempfile.TemporaryDirectory() as scratch:
            print(f"{count} iterations: {cost_of(Path(scratch), count)}", flush=True)
