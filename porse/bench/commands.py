"""The suite `pipeline`: what commands take that people wait for, and DVC where there is nothing to do."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from porse.bench.figure import Figure
from porse.bench.machine import plain_environment
from porse.bench.table import CHECK, DVC, HELP, TASKS, found, missing
from porse.errors import PorseError
from porse.paths import project_root

_PORSE = (sys.executable, "-c", "from porse.cli import main; main()")
_REWARD = """def compute_reward(root_positions: torch.Tensor, target_root_positions: torch.Tensor):
    distance = torch.norm(target_root_positions - root_positions, dim=-1)
    closeness = torch.exp(-distance)
    return closeness, {"closeness": closeness}
"""


def figures(count: int) -> Iterator[Figure]:
    """Yields the figures of the suite.

    Args:
        count: rounds of each.

    Raises:
        PorseError: a command failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        reward = Path(folder) / "reward.py"
        reward.write_text(_REWARD, encoding="utf-8")
        named = {
            HELP: ["--help"],
            TASKS: ["tasks"],
            CHECK: ["check-code", "Quadcopter", "--reward", str(reward)],
        }
        for name, words in named.items():
            yield found("pipeline", name, spent_s([*_PORSE, *words], count))
    yield _dvc_status(count)


def spent_s(command: Sequence[str], count: int) -> list[float]:
    """Returns the processor seconds, the system's included, that a command and its processes take, run by run.

    It is run once more before, for the caches of the file system.

    Raises:
        PorseError: it failed.
    """
    return [_once_s(command) for _ in range(count + 1)][1:]


def _once_s(command: Sequence[str]) -> float:
    process = subprocess.Popen(
        command, env=plain_environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    with process:
        assert process.stdout is not None
        said = process.stdout.read()
        # What it and the processes that it waited for have used.
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise PorseError(
            f"expected {' '.join(command)} to succeed, found exit code {process.returncode}: {said.strip()[-500:]}; "
            "run it by itself"
        )
    return used.ru_utime + used.ru_stime


def _dvc_status(count: int) -> Figure:
    if project_root(Path.cwd()) is None or not Path(".dvc").is_dir():
        return missing("pipeline", DVC, "no project of DVC here: run it in a checkout")
    try:
        return found("pipeline", DVC, spent_s([sys.executable, "-m", "dvc", "status"], count))
    except PorseError as error:
        return missing("pipeline", DVC, str(error))
