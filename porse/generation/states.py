"""Real states of the run's task, for trying functions on, and the checker that uses them."""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from porse.code.limits import Limits
from porse.code.sandbox import Sandbox
from porse.code.states import save_states
from porse.code.validate import Submission, judge
from porse.code.verdict import Verdict
from porse.config import Params
from porse.generation.functions import Attempt, Check
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
def checker(params: Params) -> Iterator[Check]:
    """Gives a function from attempts to their verdicts and normalised sources, on real states of the run's task.

    One confined process serves all that is checked while the block runs. It starts when it is first needed.
    """
    variables = find_task(params.task).VARIABLES
    sandbox: Sandbox | None = None
    with ExitStack() as opened:

        def check(attempts: Sequence[Attempt]) -> list[tuple[Verdict, str]]:
            nonlocal sandbox
            if not attempts:
                return []
            if sandbox is None:
                states = Path(opened.enter_context(tempfile.TemporaryDirectory())) / "states.safetensors"
                # It loads torch while the states are made.
                sandbox = opened.enter_context(Sandbox(Limits()))
                probe, seed = params.validate, seed_for(params.seed, "probe")
                save_states(states, probe_states(params.task, probe.probe_envs, probe.probe_steps, seed))
                sandbox.load(states, variables)
            return [judge(Submission(attempt.reply.text, attempt.kind), variables, sandbox) for attempt in attempts]

        yield check
