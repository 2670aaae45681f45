"""`porse repro`: `dvc repro` that goes on after any kill, without a hand, and whose stages find their imports done."""

import configparser
import functools
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import FrameType

from porse.config import Params, load_params
from porse.errors import PorseError
from porse.paths import python_of_stages
from porse.pipeline import write_pipeline
from porse.plan import write_plan
from porse.processes import die_with_parent
from porse.repair import repair
from porse.stage import HOW_ON
from porse.training.bar import check_progress
from porse.training.cluster import ray_here
from porse.training.executor import executor_from_environment, uses_ray
from porse.training.memory import check_memory
from porse.warm.start import warm_server

_QUIET_DVC = Path(__file__).with_name("quiet_dvc.py")
"""Run by its path: a project may bring a package of another version along."""

_WRONG_ARGUMENTS = 254
"""DVC's exit code for them."""


def reproduce(root: Path, arguments: Sequence[str], say: Callable[[str], None], progress: str = "") -> int:
    """Mends what a killed run may have left, runs `dvc repro` in a process that ends with this one, and returns an exit code.

    Stages are forked from a warm server while it runs.

    Args:
        root: the project's root.
        arguments: what `dvc repro` gets; without any, DVC says its own errors alone, and each stage its line.
        say: told one line for everything that was mended or written.
        progress: how stages show theirs (`porse.training.bar`); empty: as PORSE_PROGRESS says.

    Returns:
        0 where all is done, 1 where something failed, 2 where DVC does not take the arguments, and 128 more than the number of
        the signal that ended the run, as a shell says it: 130 for Ctrl-C.

    Raises:
        PorseError: there is no pipeline in `root`, its parameters or an environment variable are wrong, or memory is too small.
    """
    if not (root / "dvc.yaml").is_file():
        raise PorseError(
            f"expected dvc.yaml in {root.resolve()} or a folder above it, found none; run from a folder of the project"
        )
    if not has_source_control(root):
        raise PorseError(
            f"expected {root.resolve()} to be in a Git repository, as DVC does, found no .git, as in an unpacked source "
            "archive; take a clone, or run: git init && git add . && git commit -m start"
        )
    params = load_params(root / "params.yaml", root)
    check_start(params)
    # In this order: a copy of a lock that takes the place of a damaged one may name stages that are no more.
    for line in [*repair(root), *write_pipeline(root, params)]:
        say(line)
    # What DVC says between the stages is neither progress nor JSON. Who gives it arguments wants to read what it says of them.
    run_dvc = ["-P", str(_QUIET_DVC)] if progress or not arguments else ["-m", "dvc"]
    command = [sys.executable, *run_dvc, "repro", *arguments]
    end_with_this = functools.partial(die_with_parent, os.getpid())
    with ExitStack() as kept:
        found = kept.enter_context(warm_server(params.numerics))
        plan = Path(kept.enter_context(tempfile.TemporaryDirectory(prefix="porse-"))) / "plan.json"
        write_plan(plan, params)
        environment = {**os.environ, **python_of_stages(root), **found, "PORSE_PLAN": str(plan)}
        if uses_ray():
            # Once for all stages: each would else start its own.
            environment |= kept.enter_context(ray_here()).environment
        if progress:
            environment["PORSE_PROGRESS"] = progress
        process = subprocess.Popen(command, cwd=root, env=environment, preexec_fn=end_with_this)

        interrupted = False

        def hand_on(number: int, _: FrameType | None) -> None:
            process.send_signal(number)

        def note(_: int, __: FrameType | None) -> None:
            nonlocal interrupted
            interrupted = True

        # A key in the terminal reaches DVC by itself, which then ends its stage; this process waits for both.
        signal.signal(signal.SIGINT, note)
        signal.signal(signal.SIGTERM, hand_on)
        code = process.wait()
    if not code:
        return 0
    if interrupted:
        say(f"stopped by Ctrl-C: {HOW_ON}")
        return 128 + signal.SIGINT
    if code < 0:
        return 128 - code
    if code == _WRONG_ARGUMENTS:
        return 2
    say("stopped by the error above: correct it, and run `porse repro` again, and it goes on from there")
    return 1


def check_start(params: Params) -> None:
    """Checks what a run would else stop at after minutes: environment variables, and memory for one training.

    Raises:
        ParamsError: a variable is not what it may be, or a training does not fit.
    """
    check_progress()
    executor_from_environment()
    check_memory(params)


def has_source_control(root: Path) -> bool:
    """Returns whether DVC finds a Git repository in `root` or above it, or is told to do without (core.no_scm)."""
    if any((folder / ".git").exists() for folder in (root.resolve(), *root.resolve().parents)):
        return True
    parser = configparser.ConfigParser(strict=False)
    parser.read([root / ".dvc" / "config", root / ".dvc" / "config.local"], encoding="utf-8")
    return parser.get("core", "no_scm", fallback="false").strip().lower() == "true"
