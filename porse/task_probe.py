"""The probe of `porse check-code`: one process that loads torch, makes real states of a task and tries functions.

It is the child of a process that needs neither torch nor the simulator, so that a check takes one start of each.
"""

import contextlib
from typing import Any

from porse.functions.read.probe import serve
from porse.generation.states import probe_states

PROBE_ENVS = 16
"""Environments whose states a function is tried on."""
PROBE_STEPS = 16
"""Control steps of random actions before most of those states."""


def _load_task(request: dict[str, Any]) -> dict[str, Any]:
    """Returns the values of the variables of the task that the request names, in real states."""
    # This process runs in an empty folder; a task of one's own lies where the command was given.
    with contextlib.chdir(request["root"]):
        return probe_states(request["task"], PROBE_ENVS, PROBE_STEPS, seed=0)


if __name__ == "__main__":
    serve(_load_task)
