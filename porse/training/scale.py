"""Running scales of reward streams, so that neither the mix nor PPO depends on the units of a reward.

A stream's scale is the standard deviation of its discounted return, as in the usual normalisation of rewards: each
environment sums R_t = r_t + gamma R_(t-1), anew after an end, and the moments run over all steps and environments so far.
An epoch is counted whole before it is scaled, so that one scale holds in it. Nothing is added to a deviation: a stream in
other units gives the same numbers.
"""

import math
from collections.abc import Mapping
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

_ROUNDING = 2.0**-40
"""Variance of a return, as a share of its squared mean, that is rounding and no variance."""


class Scale(Protocol):
    """Brings a stream to a size."""

    def apply(self, stream: Tensor, ends: Tensor) -> Tensor:
        """Returns one epoch of the stream in its size.

        Args:
            stream: (steps, num_envs), finite.
            ends: (steps, num_envs) bool, whether the episode ended in this step.

        Returns:
            (steps, num_envs) float64.
        """
        ...

    def forget(self) -> None:
        """Begins anew."""
        ...

    def state(self) -> dict[str, Tensor]:
        """Returns all that a continuation needs."""
        ...

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes on from `state()`."""
        ...


class ReturnScale:
    """Divides a stream by the running standard deviation of its discounted return.

    Args:
        gamma: the discount.
        num_envs: number of environments.
    """

    def __init__(self, gamma: float, num_envs: int) -> None:
        self._gamma, self._num_envs = gamma, num_envs
        self.forget()

    def forget(self) -> None:
        """Begins anew, as if nothing had been paid."""
        self._return = torch.zeros(self._num_envs, dtype=torch.float64)
        self._samples, self._mean, self._squares = 0.0, 0.0, 0.0

    def apply(self, stream: Tensor, ends: Tensor) -> Tensor:
        """Counts one epoch and returns it divided by the deviation; see `Scale`."""
        self._learn(self._returns(stream.double(), ends))
        return stream.double() / self.deviation()

    def deviation(self) -> float:
        """Returns the standard deviation of the return so far.

        A return that does not vary has none: its size stands for it, and 1 where nothing was ever paid.
        """
        if self._samples == 0.0:
            return 1.0
        variance = self._squares / self._samples
        if variance > _ROUNDING * self._mean * self._mean:
            return math.sqrt(variance)
        return abs(self._mean) or 1.0

    def _returns(self, stream: Tensor, ends: Tensor) -> Tensor:
        """Returns the discounted return up to each step, (steps, num_envs), and goes on from its end."""
        if stream.device.type != "cpu":
            return self._returns_there(stream, (~ends).double())
        # By NumPy: a step of few environments takes half of what torch takes, and the sums are the same.
        running, returns = self._return.numpy(), np.empty(stream.shape)
        for reward, goes_on, now in zip(stream.numpy(), (~ends).double().numpy(), returns, strict=True):
            np.multiply(running, self._gamma, out=now)
            now += reward
            running = now * goes_on
        self._return = torch.from_numpy(running)
        return torch.from_numpy(returns)

    def _returns_there(self, stream: Tensor, goes_on: Tensor) -> Tensor:
        """Returns the same, computed on the stream's device."""
        returns = torch.empty_like(stream)
        for step in range(len(stream)):
            returns[step] = self._return * self._gamma + stream[step]
            self._return = returns[step] * goes_on[step]
        return returns

    def _learn(self, returns: Tensor) -> None:
        """Joins the moments of an epoch's returns to those so far (Chan et al.)."""
        samples = float(returns.numel())
        mean = float(returns.mean())
        apart = returns - mean
        total = self._samples + samples
        shift = mean - self._mean
        self._squares += float((apart * apart).sum()) + shift * shift * (self._samples * samples / total)
        self._mean += shift * (samples / total)
        self._samples = total

    def state(self) -> dict[str, Tensor]:
        """Returns the running returns, (num_envs,), and the moments: samples, mean, sum of squared deviations."""
        moments = torch.tensor([self._samples, self._mean, self._squares], dtype=torch.float64)
        return {"return": self._return.clone(), "moments": moments}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes on from `state()` of another object with as many environments.

        Raises:
            ValueError: it is of another number of environments.
        """
        if state["return"].shape != self._return.shape or state["moments"].shape != (3,):
            raise ValueError(f"its returns are of {state['return'].numel()} environments, not of {self._num_envs}")
        self._return = state["return"].clone()
        self._samples, self._mean, self._squares = state["moments"].tolist()


class NoScale:
    """Leaves a stream as it is."""

    def apply(self, stream: Tensor, ends: Tensor) -> Tensor:
        """Returns the stream in double precision."""
        del ends
        return stream.double()

    def forget(self) -> None:
        """Does nothing."""

    def state(self) -> dict[str, Tensor]:
        """Returns nothing."""
        return {}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Does nothing."""
        del state
