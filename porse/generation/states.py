"""Real states of the run's task, for trying functions on, and the checker that uses them."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

import torch
from torch import Tensor

from porse.config import Params
from porse.functions.read.confine import Limits
from porse.functions.read.sandbox import Sandbox
from porse.functions.read.states import packed
from porse.functions.verdict import Verdict
from porse.generation.functions import Attempt, Check
from porse.identity import seed_for
from porse.tasks import make_task


def probe_states(task_name: str, num_envs: int, steps: int, seed: int) -> dict[str, Any]:
    """Returns the values of all variables of a task in states that a reward is paid for: each comes after a step.

    A third of the states has seen one step of random actions, a third `steps` of them, as the last third, whose episodes
    are nearly over by their clocks. Tensors have 3 x num_envs rows: each kind of state has broken functions that only met the
    others. None comes right after a reset, where forces are exactly 0 and no reward is ever paid.
    """
    task = make_task(task_name, num_envs, seed)
    generator = torch.Generator().manual_seed(seed)
    seen: list[dict[str, Any]] = []
    for step in range(max(steps, 1)):
        task.step(2.0 * torch.rand(num_envs, task.NUM_ACTIONS, generator=generator) - 1.0)
        if step in (0, max(steps, 1) - 1):
            seen.append({n: v.clone() if isinstance(v, Tensor) else v for n, v in task.variables().items()})
    late = dict(seen[-1])
    if isinstance(clock := late.get("progress_buf"), Tensor):
        late["progress_buf"] = clock + (task.EPISODE_LENGTH - 1 - int(clock.max()))
    parts = [seen[0], seen[-1], late]
    joined = {n: torch.cat([part[n] for part in parts]) if isinstance(v, Tensor) else v for n, v in late.items()}
    return joined | {"num_envs": 3 * num_envs}


@contextmanager
def checker(params: Params) -> Iterator[Check]:
    """Gives a function from attempts to their verdicts and normalised sources, on real states of the run's task.

    One confined process serves all that is checked while the block runs. It starts when it is first needed.
    """
    sandbox: Sandbox | None = None
    with ExitStack() as opened:

        def check(attempts: Sequence[Attempt]) -> list[tuple[Verdict, str]]:
            nonlocal sandbox
            if not attempts:
                return []
            if sandbox is None:
                # It loads torch while the states are made.
                sandbox = opened.enter_context(Sandbox(Limits()))
                probe, seed = params.validate, seed_for(params.seed, "probe")
                sandbox.prepare(packed(probe_states(params.task, probe.probe_envs, probe.probe_steps, seed)))
            return [sandbox.judge(attempt.reply.text, attempt.kind) for attempt in attempts]

        yield check
