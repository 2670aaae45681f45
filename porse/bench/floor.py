"""The floor: what the libraries need for the same work when nothing is around them."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise

import mujoco
import numpy as np
import torch
from torch import Tensor

from porse import numerics
from porse.config import TrainParams
from porse.sim.physics import CpuPhysics
from porse.tasks.base import Task

Clock = Callable[[], float]
"""Seconds since some moment: `time.process_time`, or `time.perf_counter` where several threads or processes work."""


def physics_of(task: Task) -> CpuPhysics:
    """Returns the simulations of a task, which are MuJoCo's own batch."""
    physics = task._physics
    assert isinstance(physics, CpuPhysics)
    return physics


@contextmanager
def starts_of(physics: CpuPhysics) -> Iterator[list[Tensor]]:
    """Gives a list that is filled with the states, controls included, from which `physics` is advanced meanwhile."""
    starts: list[Tensor] = []
    advance = physics.advance

    def noting(substeps: int) -> Tensor:
        starts.append(physics.state())
        return advance(substeps)

    vars(physics)["advance"] = noting
    try:
        yield starts
    finally:
        del vars(physics)["advance"]


def bare_steps_s(physics: CpuPhysics, starts: Sequence[Tensor], substeps: int, clock: Clock) -> float:
    """Returns the seconds that `Batch.step` alone needs for one control step from each of these states.

    One call of the library for all substeps: what a task does between them, as drag or a bound on speeds, is not in it, and
    neither are the derived fields that it reads afterwards. The simulations are left where the last call led.
    """
    spent = 0.0
    for start in starts:
        physics.load_state(start)
        begun = clock()
        physics._step(substeps, mujoco.mjtStage.mjSTAGE_NONE.value)
        spent += clock() - begun
    physics._batch.warning[:] = 0
    return spent


def _by_torch(left: Tensor, right: Tensor, result: Tensor) -> None:
    torch.mm(left, right, out=result)


def _by_numpy(left: Tensor, right: Tensor, result: Tensor) -> None:
    np.matmul(left.numpy(), right.numpy(), out=result.numpy())


class Products:
    """The matrix products of one epoch of PPO, with factors of the same sizes and in memory of their own.

    They are those of this process's numeric profile: PyTorch's, or in `portable` NumPy's.

    In the rollout, both networks act on every state, and the critic on the last one. In the update, each minibatch has the
    products of both networks, and for each the gradients of all weights and of all layers' inputs but the first's.

    Args:
        observations: numbers in an observation.
        actions: numbers in an action.
        train: the other sizes.
    """

    def __init__(self, observations: int, actions: int, train: TrainParams) -> None:
        batch = train.num_envs * train.steps_per_epoch // train.minibatches
        actor, critic = ([observations, *train.hidden, outputs] for outputs in (actions, 1))
        self._multiply = _by_numpy if numerics.applied() == "portable" else _by_torch
        forward = [self._forward(widths, train.num_envs) for widths in (actor, critic)]
        update = [self._forward(widths, batch) + self._backward(widths, batch) for widths in (actor, critic)]
        self._parts = [
            (train.steps_per_epoch, forward[0] + forward[1]),
            (1, forward[1]),
            (train.passes * train.minibatches, update[0] + update[1]),
        ]

    def seconds(self) -> float:
        """Returns the processor seconds that the products of an epoch take."""
        begun = time.process_time()
        with torch.inference_mode():
            for times, products in self._parts:
                for _ in range(times):
                    for factors in products:
                        self._multiply(*factors)
        return time.process_time() - begun

    def count(self) -> int:
        """Returns how many products an epoch has."""
        return sum(times * len(products) for times, products in self._parts)

    def _forward(self, widths: Sequence[int], rows: int) -> list[tuple[Tensor, Tensor, Tensor]]:
        return [
            (torch.randn(rows, wide), torch.randn(narrow, wide).t(), torch.empty(rows, narrow))
            for wide, narrow in pairwise(widths)
        ]

    def _backward(self, widths: Sequence[int], rows: int) -> list[tuple[Tensor, Tensor, Tensor]]:
        pairs = [*pairwise(widths)]
        weights = [
            (torch.randn(rows, narrow).t(), torch.randn(rows, wide), torch.empty(narrow, wide))
            for wide, narrow in pairs
        ]
        inputs = [
            (torch.randn(rows, narrow), torch.randn(narrow, wide), torch.empty(rows, wide))
            for wide, narrow in pairs[1:]
        ]
        return weights + inputs
