"""The suite `sim`: environments over their physics, and one humanoid beside two peers."""

import time
from collections.abc import Iterator
from itertools import islice

import numpy as np
import torch

from porse.bench import humanoid
from porse.bench.figure import Figure, ratios
from porse.bench.humanoid import Humanoids, OwnHumanoids, lacking, step_s
from porse.bench.table import (
    BARE,
    ENVIRONMENTS,
    FEW_ENVIRONMENTS,
    OVER_ENVPOOL,
    OVER_GYMNASIUM,
    SHARE,
    found,
    missing,
    share_tasks,
)
from porse.bench.task_speed import STEPS, rounds
from porse.tasks import make_task

INSTALL = "pip install 'porse[bench]'"
_HUMANOID_STEPS = 2560
"""Environment steps of a round."""


def figures(count: int) -> Iterator[Figure]:
    """Yields the figures of the suite.

    Args:
        count: rounds of each.
    """
    torch.set_num_threads(1)
    for name in share_tasks():
        task = make_task(name, ENVIRONMENTS, seed=0)
        played = [*islice(rounds(task, time.process_time), count)]
        yield found("sim", SHARE.format(task=name), [each.share for each in played])
        if name == "Over":
            yield found("sim", BARE, [ENVIRONMENTS * STEPS / each.bare_s for each in played])
    yield from _peers(count)


def _peers(count: int) -> Iterator[Figure]:
    if lacking("envpool"):
        yield missing("sim", OVER_ENVPOOL, f"no EnvPool: {INSTALL}")
    else:
        peer = humanoid.of_envpool(ENVIRONMENTS)
        yield found("sim", OVER_ENVPOOL, beside(OwnHumanoids(ENVIRONMENTS), peer, ENVIRONMENTS, count))
    if lacking("imageio"):
        yield missing("sim", OVER_GYMNASIUM, f"no gymnasium[mujoco]: {INSTALL}")
    else:
        with humanoid.of_gymnasium(FEW_ENVIRONMENTS) as peer:
            yield found("sim", OVER_GYMNASIUM, beside(OwnHumanoids(FEW_ENVIRONMENTS), peer, FEW_ENVIRONMENTS, count))


def beside(own: Humanoids, peer: Humanoids, num_envs: int, count: int) -> tuple[float, ...]:
    """Returns how many times as much processor time a peer needs for a step, round by round.

    Args:
        own: humanoids in this project's physics.
        peer: as many elsewhere.
        num_envs: how many.
        count: rounds.
    """
    generator = np.random.default_rng(0)
    times: dict[str, list[float]] = {"own": [], "peer": []}
    # The first round finds caches cold, and all humanoids upright.
    for _ in range(count + 1):
        shape = (_HUMANOID_STEPS // num_envs, num_envs, 17)
        drawn = generator.uniform(-humanoid.ACTION, humanoid.ACTION, shape)
        times["own"].append(step_s(own, drawn))
        times["peer"].append(step_s(peer, drawn))
    return ratios(times["peer"][1:], times["own"][1:])
