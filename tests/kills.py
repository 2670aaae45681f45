"""Kills a run again and again, at random and where it hurts, and checks that it goes on by itself to the same bytes.

`python tests/kills.py FOLDER RANDOM AIMED [empty]` makes a tiny project in FOLDER, kills that many runs of it, adds a line for
each to FOLDER/kills.jsonl, and prints what came out. Started again with the same folder, it goes on. For tests.
"""

import contextlib
import functools
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from empty_stages import PYTHON, params_of
from tiny import BIN, QUIET, committed_params, make_project

WAIT_S = 5.0
"""Processes may live this long after the run that started them was killed."""
HOOK = Path(__file__).resolve().parent / "killing"


def tiny_params() -> dict[str, Any]:
    """Parameters of a run of one iteration with two rungs, mutants, and no replies."""
    params = committed_params()
    params["generator"] = "grammar"
    params["generate"] |= {"candidates": 2, "elites": 1}
    params["validate"] |= {"probe_envs": 8, "probe_steps": 8}
    params["train"] |= {"num_envs": 4, "steps_per_epoch": 4, "rung_epochs": 2, "hidden": [8], "minibatches": 2}
    params["iterations"] = [{"n": 1, "next": "result"}]
    params["rungs"] = [
        {"rung": 1, "pool": "validate-code", "until": 1, "keep": 1},
        {"rung": "mutants", "pool": "mutate", "until": 1, "keep": 1},
    ]
    params["mutate"] |= {"pool": "eliminate-1", "mutants": 1}
    params["fuse"]["pool"] = "eliminate-mutants"
    params["evaluate"] |= {"seeds": 1, "episodes": 8}
    return params


@dataclass(frozen=True)
class Kill:
    """One killed run.

    Attributes:
        how: `random`, or what was aimed at.
        after_s: seconds until its processes were gone.
        left: how many were left after WAIT_S.
        said: what `porse repro` said that it mended.
    """

    how: str
    after_s: float
    left: int
    said: list[str]


class Victim:
    """A project that is killed.

    Args:
        folder: where it is made; what is there is used.
        empty: stages do nothing, so that a run is DVC alone.
    """

    def __init__(self, folder: Path, empty: bool) -> None:
        self.folder = folder
        self._empty = empty
        self.undisturbed = folder / "undisturbed.json"
        if not self.undisturbed.is_file():
            project = self.fresh()
            finish(project)
            self.undisturbed.write_text(json.dumps(bytes_of(project)))

    def fresh(self) -> Path:
        """Returns the project without anything that a run writes."""
        project = self.folder / "project"
        if project.exists():
            shutil.rmtree(project)
        venv = self.folder / "venv" if self._empty else BIN.parent
        if self._empty and not venv.exists():
            (venv / "bin").mkdir(parents=True)
            (venv / "bin" / "python").write_text(PYTHON)
            (venv / "bin" / "python").chmod(0o755)
        return make_project(project, params_of(2) if self._empty else tiny_params(), venv)

    def differences(self, project: Path) -> list[str]:
        """Returns the files that are not as in the undisturbed run."""
        wanted, found = json.loads(self.undisturbed.read_text()), bytes_of(project)
        return sorted(name for name in {*wanted, *found} if wanted.get(name) != found.get(name))


def start(project: Path, **environment: str) -> subprocess.Popen[str]:
    """Starts `porse repro` as people do."""
    return subprocess.Popen(
        [str(BIN / "porse"), "repro"], cwd=project, env={**os.environ, **QUIET, **environment},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
    )  # fmt: skip


def finish(project: Path) -> list[str]:
    """Runs to the end and returns what was said to be mended."""
    process = start(project)
    output, _ = process.communicate(timeout=600)
    assert process.returncode == 0, output[-3000:]
    return mended(output)


def mended(output: str) -> list[str]:
    return [line for line in output.splitlines() if ": removed" in line or "in its place" in line]


def kill_at_random(project: Path, number: int, longest_s: float = 8.0) -> Kill:
    """Kills DVC some time after its start; the number says when."""
    draw = random.Random(f"kill {number}")
    process = start(project)
    time.sleep(draw.uniform(0.0, longest_s))
    return _ended("random", process, project, dvc_alone=draw.random() < 0.5)


def kill_in_a_write(project: Path, name: str, number: int, share: int) -> Kill:
    """Kills DVC in the middle of writing a file."""
    hook = {"PORSE_TEST_KILL": f"{name}:{number}:{share}", "PYTHONPATH": str(HOOK)}
    process = start(project, **hook)
    process.wait(timeout=300)
    return _ended(f"{name} at {share} %", process, project)


def kill_at_a_start(project: Path, wanted: str, delay_s: float) -> Kill:
    """Kills DVC that long after a process of the project with these words in its command was first seen."""
    process = start(project)
    deadline = time.monotonic() + 120
    while process.poll() is None and not any(wanted in words for words in living(project).values()):
        assert time.monotonic() < deadline
        time.sleep(0.002)
    time.sleep(delay_s)
    return _ended(f"start of {wanted} + {1000 * delay_s:.0f} ms", process, project)


def _ended(how: str, process: subprocess.Popen[str], project: Path, dvc_alone: bool = False) -> Kill:
    """Kills DVC, or the guard that started it and that DVC ends with."""
    inner = [number for number, words in living(project).items() if "/quiet_dvc.py repro" in words]
    if dvc_alone and inner:
        os.kill(inner[0], signal.SIGKILL)
    else:
        process.send_signal(signal.SIGKILL)
    killed = time.monotonic()
    process.wait()
    while living(project) and time.monotonic() - killed < WAIT_S:
        time.sleep(0.01)
    after, left = time.monotonic() - killed, living(project)
    for number in left:
        # Counted once: they would be found again after the next kill, and they hold the output open.
        with contextlib.suppress(ProcessLookupError):
            os.kill(number, signal.SIGKILL)
    assert process.stdout is not None
    said = mended(process.stdout.read())
    process.stdout.close()
    return Kill(how, round(after, 3), len(left), said)


def living(project: Path) -> dict[int, str]:
    """Returns the commands of the processes that work in the project, by their number."""
    found = {}
    for entry in Path("/proc").iterdir():
        try:
            if not entry.name.isdecimal() or (entry / "stat").read_text().rpartition(")")[2].split()[0] == "Z":
                continue
            folder = (entry / "cwd").readlink()
            if folder == project or project in folder.parents or _root_of(entry) == str(project):
                found[int(entry.name)] = (entry / "cmdline").read_text().replace("\0", " ")
        except (FileNotFoundError, PermissionError, ProcessLookupError):
            continue  # it has ended, or is another user's
    return found


def _root_of(entry: Path) -> str:
    """Returns the project that a process is a stage of, wherever it works."""
    words = (entry / "environ").read_bytes().split(b"\0")
    return next((word[9:].decode() for word in words if word.startswith(b"DVC_ROOT=")), "")


def bytes_of(project: Path) -> dict[str, str]:
    """Returns the hashes of all that a run leaves, and of the locks."""
    names = [
        "dvc.lock",
        "metrics.json",
        *(f"iterations/{path.parent.name}/dvc.lock" for path in project.glob("iterations/*/dvc.lock")),
    ]
    for folder in ("inputs", "run", "evaluation", "results", "plots"):
        names += [str(path.relative_to(project)) for path in (project / folder).rglob("*") if path.is_file()]
    return {name: hashlib.sha256((project / name).read_bytes()).hexdigest() for name in sorted(names)}


WRITES = 20
"""Of the kills where they hurt, the first ones are in DVC's own writes."""


def aimed_kills() -> list[Callable[[Path], Kill]]:
    """Returns thirty kills where they hurt."""
    writes = [("dvc.lock", number, share) for number in (1, 2, 4, 7) for share in (0, 37, 99)]
    writes += [("rwlock", number, share) for number in (1, 2, 5, 6) for share in (0, 50)]
    starts = [("porse.warm.server", delay) for delay in (0.0, 0.05, 0.2, 0.5, 1.0)]
    starts += [("stages.train_population", delay) for delay in (0.0, 0.02, 0.1)] + [
        ("stages.resolve", 0.0),
        ("stages.generate", 0.01),
    ]

    def writing(name: str, number: int, share: int) -> Callable[[Path], Kill]:
        return lambda project: kill_in_a_write(project, name, number, share)

    def starting(wanted: str, delay: float) -> Callable[[Path], Kill]:
        return lambda project: kill_at_a_start(project, wanted, delay)

    return [*(writing(*each) for each in writes), *(starting(*each) for each in starts)]


def campaign(folder: Path, random_kills: int, aimed: int, empty: bool = False, at_once: int = 5) -> dict[str, Any]:
    """Kills runs, several times before each is let finish, and returns what came out of all of them so far.

    Args:
        folder: where it is done; a campaign that was begun there goes on.
        random_kills: how many kills at random.
        aimed: how many of `aimed_kills`.
        empty: stages do nothing, and kills aim at DVC's own writes alone.
        at_once: how many times a run is killed before it is let finish.
    """
    victim, log = Victim(folder, empty), folder / "kills.jsonl"
    done = len(log.read_text().splitlines()) if log.exists() else 0
    plan: list[Callable[[Path], Kill]] = [functools.partial(kill_at_random, number=n) for n in range(random_kills)]
    places = random.Random(2026)
    for kill in (aimed_kills()[:WRITES] if empty else aimed_kills())[:aimed]:
        plan.insert(places.randint(0, len(plan)), kill)
    for first in range(done - done % at_once, len(plan), at_once):
        project = victim.fresh()
        kills = [kill(project) for kill in plan[first : first + at_once]]
        said = finish(project)
        rows = [{**kill.__dict__, "mended_after": said, "different": victim.differences(project)} for kill in kills]
        kept = log.read_text().splitlines()[:first] if log.exists() else []
        log.write_text("\n".join([*kept, *map(json.dumps, rows)]) + "\n")
    return summary([json.loads(line) for line in log.read_text().splitlines()])


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Returns counts over kills."""
    return {
        "kills": len(rows),
        "random": sum(row["how"] == "random" for row in rows),
        "different": sum(bool(row["different"]) for row in rows),
        "left": sum(row["left"] for row in rows),
        "longest_s": max(row["after_s"] for row in rows),
        "mended": sum(len(row["said"]) for row in rows),
    }


if __name__ == "__main__":
    place, at_random, aimed, *rest = sys.argv[1:]
    Path(place).mkdir(parents=True, exist_ok=True)
    print(campaign(Path(place).resolve(), int(at_random), int(aimed), empty=rest == ["empty"]))
