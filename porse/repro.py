"""`porse repro`: `dvc repro` that goes on after any kill, without a hand, and whose stages find their imports done."""

import functools
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType

from porse.config import load_params
from porse.errors import PorseError
from porse.pipeline import write_pipeline
from porse.processes import die_with_parent
from porse.repair import repair
from porse.warm.start import warm_server


def reproduce(root: Path, arguments: Sequence[str], say: Callable[[str], None]) -> int:
    """Mends what a killed run may have left, runs `dvc repro` in a process that ends with this one, and returns its code.

    Stages are forked from a warm server while it runs.

    Args:
        root: the project's root.
        arguments: what `dvc repro` gets.
        say: told one line for everything that was mended or written.

    Raises:
        PorseError: there is no pipeline in `root`, or its parameters are wrong.
    """
    if not (root / "dvc.yaml").is_file():
        raise PorseError(f"expected dvc.yaml in {root.resolve()}, found none; run from the project's root")
    params = load_params(root / "params.yaml", root)
    for line in [*write_pipeline(root, params), *repair(root)]:
        say(line)
    command = [sys.executable, "-m", "dvc", "repro", *arguments]
    end_with_this = functools.partial(die_with_parent, os.getpid())
    with warm_server(params.numerics) as found:
        process = subprocess.Popen(command, cwd=root, env={**os.environ, **found}, preexec_fn=end_with_this)

        def hand_on(number: int, _: FrameType | None) -> None:
            process.send_signal(number)

        # A key in the terminal reaches DVC by itself, which then ends its stage; this process waits for both.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, hand_on)
        return process.wait()
