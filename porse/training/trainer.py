"""Trains one policy for a number of epochs, from a policy or from a checkpoint, to a checkpoint.

Split anywhere, a training gives the same bits: epochs 1..2H at once, or 1..H, a checkpoint, a new process, H+1..2H.
PPO draws from torch's global generator, so a training owns its process while it runs.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from porse.checkpoint import Checkpoint, policy_checkpoint, read_checkpoint, write_checkpoint
from porse.config import TrainParams
from porse.errors import CheckpointError
from porse.identity import seed_for
from porse.tasks.base import Task
from porse.training.finite import check_policy, finite
from porse.training.ppo import build_ppo
from porse.training.reason import reason_of
from porse.training.reward import Reward
from porse.training.snapshot import (
    arrays,
    load_optimizer,
    load_policy,
    optimizer_arrays,
    policy_arrays,
    same_names,
    tensors,
)
from porse.training.vecenv import TaskEnv, observation_groups

Progress = Callable[[int, float], None]
"""Told after each epoch: the epoch and the fitness."""


@dataclass(frozen=True)
class EpochRow:
    """One value of one series at one epoch."""

    epoch: int
    series: str
    value: float


def draw_policy(num_observations: int, num_actions: int, params: TrainParams, seed: int) -> Checkpoint:
    """Returns a random policy of the task's sizes, theta_random, drawn from `seed`."""
    torch.manual_seed(seed)
    observations = observation_groups(torch.zeros(params.num_envs, num_observations))
    return policy_checkpoint(policy_arrays(build_ppo(observations, num_actions, params)))


def draws(device: torch.device) -> Tensor:
    """Returns the state of the global generator that draws on a device."""
    return torch.get_rng_state() if device.type == "cpu" else torch.cuda.get_rng_state(device)


def set_draws(device: torch.device, state: Tensor) -> None:
    """Goes on from what `draws` returned."""
    if device.type == "cpu":
        torch.set_rng_state(state)
    else:
        torch.cuda.set_rng_state(state, device)


class Trainer:
    """One training: a task, a reward, PPO, and the epochs done so far.

    Args:
        task: a fresh task.
        reward: what pays.
        params: PPO's parameters.
        seed: names the training's draws; used when it starts from a policy.
    """

    def __init__(self, task: Task, reward: Reward, params: TrainParams, seed: int) -> None:
        self._params, self._seed = params, seed
        self._env = TaskEnv(task, reward)
        torch.use_deterministic_algorithms(True)
        torch.manual_seed(seed_for(seed, "ppo"))
        self.epoch = 0
        self._ppo = build_ppo(observation_groups(task.observations()), task.NUM_ACTIONS, params)

    def load(self, path: Path) -> None:
        """Goes on from the file at `path`: a policy starts at epoch 0, a checkpoint where it was written.

        Where it starts, episodes are staggered: an epoch is shorter than an episode, and would else show one phase of it.

        Raises:
            CheckpointError: the file is missing, damaged, or of other networks.
        """
        checkpoint = read_checkpoint(path)
        load_policy(self._ppo, checkpoint, self._env.task.NAME, path)
        if checkpoint.scalars["kind"] == "policy":
            self._env.task.stagger(seed_for(self._seed, "ages"))
            return
        try:
            load_optimizer(self._ppo, checkpoint)
            task, reward = self._env.task, self._env.reward
            task.load_state(same_names(tensors(checkpoint, "task"), task.state()))
            paid = same_names(tensors(checkpoint, "reward"), reward.state())
            reward.load_state({name: value.to(task.device) for name, value in paid.items()})
            set_draws(task.device, tensors(checkpoint, "ppo")["generator"])
        except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
            raise CheckpointError(
                f"expected the state of a training of {self._env.task.NAME} in {path}, found another ({reason_of(error)}); delete it and run `porse repro`"
            ) from error
        self.epoch = checkpoint.scalars["epoch"]

    def save(self, path: Path) -> None:
        """Writes a checkpoint to `path`."""
        content = {**policy_arrays(self._ppo), **optimizer_arrays(self._ppo)}
        content |= arrays({"generator": draws(self._env.task.device)}, "ppo")
        content |= arrays(self._env.task.state(), "task") | arrays(self._env.reward.state(), "reward")
        scalars = {"kind": "checkpoint", "epoch": self.epoch, "learning_rate": float(self._ppo.learning_rate)}
        write_checkpoint(path, Checkpoint(content, scalars))

    def train(self, until: int, progress: Progress, before: Callable[[int], None]) -> list[EpochRow]:
        """Trains until epoch `until` is done and returns what was written down.

        Args:
            until: the last epoch.
            progress: told after each epoch.
            before: told before each epoch which it is.

        Raises:
            CandidateFailed: the reward's functions failed, or a number that has to be finite is not; the rows of earlier
                epochs are lost with it.
        """
        rows: list[EpochRow] = []
        self._ppo.train_mode()
        observations = self._env.task.observations()
        while self.epoch < until:
            before(self.epoch + 1)
            with torch.inference_mode():
                for _ in range(self._params.steps_per_epoch):
                    observations, ends, timed_out = self._env.step(self._ppo.choose(observations))
                    self._ppo.follow(ends, timed_out)
                paid = self._pay()
                self._ppo.finish(observations)
            # An update with numbers that are not finite would spoil the weights.
            self._env.task.check()
            finite("its returns were", self._ppo.storage.returns)
            losses = self._ppo.update()
            finite("its losses were", torch.tensor(list(losses.values())))
            check_policy(self._ppo)
            self.epoch += 1
            fitness = self._env.fitness.take()
            finite("its fitness was", torch.tensor(fitness))
            series = {"fitness": fitness, **paid, **self._env.means.take(), **self._env.lengths.take()}
            rows += [EpochRow(self.epoch, name, value) for name, value in series.items()]
            progress(self.epoch, fitness)
        return rows

    def _pay(self) -> dict[str, float]:
        """Pays for the epoch that was just rolled out, and returns the series about it.

        The storage has the value of the last state where an episode met the time limit already, and zero elsewhere.
        """
        storage = self._ppo.storage
        payment = self._env.reward.pay(self.epoch + 1, storage.dones.squeeze(-1).bool())
        storage.rewards += payment.total.unsqueeze(-1)
        return payment.series
