"""Real states of the run's task, for trying functions on, and the checker that uses them."""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from porse.functions.read.limits import Limits
from porse.functions.read.states import save_states
from porse.functions.read.validate import Submission, validate
from porse.functions.verdict import Verdict
from porse.config import Params
from porse.generation.functions import Attempt
from porse.identity import seed_for
from porse.tasks import find_task, make_task


def probe_states(task_name: str, num_envs: int, steps: int, seed: int) -> dict[str, Any]:
    """Returns the values of all variables of a task: states right after a reset, then after random actions.

    Tensors have 2 x num_envs rows, since both kinds of state have broken functions that only met the other.
    """
    task = make_task(task_name, num_envs, seed)
    first = task.variables()
    generator = torch.Generator().manual_seed(seed)
    for _ in range(steps):
        task.step(2.0 * torch.rand(num_envs, task.NUM_ACTIONS, generator=generator) - 1.0)
    last = task.variables()
    joined: dict[str, Any] = {}
    for name, value in last.items():
        before = first[name]
        joined[name] = torch.cat([before, value]) if isinstance(value, Tensor) and isinstance(before, Tensor) else value
    return joined | {"num_envs": 2 * num_envs}


@contextmanager
def checker(params: Params) -> Iterator[Callable[[Sequence[Attempt]], list[tuple[Verdict, str]]]]:
    """Gives a function from attempts to their verdicts and normalised sources, on real states of the run's task."""
    seed = seed_for(params.seed, "probe")
    variables = find_task(params.task).VARIABLES
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "states.safetensors"

        def check(attempts: Sequence[Attempt]) -> list[tuple[Verdict, str]]:
            if not path.exists():
                save_states(
                    path, probe_states(params.task, params.validate.probe_envs, params.validate.probe_steps, seed)
                )
            submissions = [Submission(attempt.reply.text, attempt.kind) for attempt in attempts]
            return validate(submissions, variables, path, Limits())

        yield check
