"""rsl_rl's PPO with less around it: the same draws, the same sums in the same order, and so the same weights, bit for bit.

The library's update goes through tensor dictionaries, autograd and torch's distributions, gathers and normalises every
minibatch anew in each pass, and computes an entropy whatever its weight. Here a minibatch is gathered and normalised once an
epoch, the rollout is plain tensors, and the gradient is written out: the operators that autograd would call, added up in its
order. What is equal in all rows, which is all that follows from the deviations of the actions alone, is computed for one.
`tests/test_lean.py` compares it with the library on the same data.
"""

import math
from typing import Any

import torch
from rsl_rl.algorithms import PPO
from torch import Tensor

from porse.training.gradients import Layers, of_clamped, of_larger, shorten
from porse.training.vecenv import observation_groups

_LOG_ROOT_TWO_PI = math.log(math.sqrt(2 * math.pi))
_ENTROPY = 0.5 + 0.5 * math.log(2 * math.pi)
"""Of a normal distribution with deviation 1."""


class LeanPPO(PPO):
    """PPO as `porse.training.ppo.build_ppo` makes it: two networks, one normal distribution, an adaptive learning rate."""

    learning_rate: float

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._actor, self._critic = Layers(self.actor), Layers(self.critic)
        self._deviation = self.actor.distribution.std_param
        self._seen = self.storage.observations["policy"]
        self._means = torch.zeros_like(self.storage.actions)

    def choose(self, observations: Tensor) -> Tensor:
        """Returns drawn actions, (num_envs, actions), for observations (num_envs, observations), and stores both."""
        storage, step = self.storage, self.storage.step
        means = self._actor(self._actor.normalise(observations))
        self._seen[step], self._means[step] = observations, means
        storage.actions[step] = torch.normal(means, self._deviations().expand_as(means))
        storage.values[step] = self._critic(self._critic.normalise(observations))
        return storage.actions[step]

    def follow(self, ends: Tensor, timed_out: Tensor) -> None:
        """Stores what became of the step, (num_envs,) bool each; its reward is the value that a time limit cut off."""
        storage, step = self.storage, self.storage.step
        storage.dones[step] = ends.unsqueeze(1)
        storage.rewards[step] = self.gamma * (storage.values[step] * timed_out.unsqueeze(1))
        storage.step += 1

    def finish(self, observations: Tensor) -> None:
        """Computes returns and advantages, once the epoch has been paid.

        Args:
            observations: of the states that it led to, (num_envs, observations).
        """
        storage, deviations = self.storage, self._deviations()
        storage.distribution_params = (self._means, deviations.expand_as(self._means))
        exponents = _exponents(storage.actions - self._means, deviations)
        storage.actions_log_prob = _log_probability(exponents, deviations)
        values = torch.cat([storage.values, self._critic(self._critic.normalise(observations)).unsqueeze(0)])
        kept = (1.0 - storage.dones.float()) * self.gamma
        surprises = storage.rewards + kept * values[1:] - storage.values
        advantage, kept = torch.zeros(()), kept * self.lam
        for step in reversed(range(len(kept))):
            advantage = surprises[step] + kept[step] * advantage
            storage.returns[step] = advantage + storage.values[step]
        advantages = storage.returns - storage.values
        storage.advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)

    def update(self) -> dict[str, float]:
        """Learns from the stored epoch; returns the mean losses, named as rsl_rl does."""
        for weight in self.optimizer.param_groups[0]["params"]:
            weight.grad = torch.zeros_like(weight)
        gradients = [[weight.grad for weight in network.parameters()] for network in (self.actor, self.critic)]
        with torch.inference_mode():
            batches = self._batches() * self.num_learning_epochs
        sums = {"value": 0.0, "surrogate": 0.0, "entropy": 0.0}
        for for_actor, for_critic in batches:
            with torch.inference_mode():
                losses = {**self._teach_actor(*for_actor), **self._teach_critic(*for_critic)}
                for own in gradients:
                    shorten(own, self.max_grad_norm)
            self.optimizer.step()
            sums = {name: total + losses[name].item() for name, total in sums.items()}
        seen = observation_groups(self._seen.flatten(0, 1))
        self.actor.update_normalization(seen)
        self.critic.update_normalization(seen)
        self.storage.clear()
        return {name: total / len(batches) for name, total in sums.items()}

    def _batches(self) -> list[tuple[list[Tensor], list[Tensor]]]:
        """Returns an epoch's minibatches: what `_teach_actor` takes and what `_teach_critic` takes, (samples, ...) each."""
        storage, seen = self.storage, self._seen.flatten(0, 1)
        for_actor = storage.actions, self._means, storage.actions_log_prob, storage.advantages
        for_critic = storage.values, storage.returns
        whole = [
            [network.normalise(seen), *(part.flatten(0, 1) for part in parts)]
            for network, parts in ((self._actor, for_actor), (self._critic, for_critic))
        ]
        size = len(seen) // self.num_mini_batches
        order = torch.randperm(self.num_mini_batches * size).split(size)
        # Each in memory of its own: in the profile `fast`, a product's bits depend on where its factors begin.
        actor, critic = ([[part.index_select(0, rows) for part in parts] for rows in order] for parts in whole)
        return list(zip(actor, critic, strict=True))

    def _teach_actor(
        self, seen: Tensor, actions: Tensor, old_means: Tensor, old_log: Tensor, advantages: Tensor
    ) -> dict[str, Tensor]:
        """Writes the actor's gradients for one minibatch, adapts the learning rate, and returns surrogate and entropy."""
        means, deviations, clip = self._actor(seen), self._deviations(), self.clip_param
        # rsl_rl draws actions here and drops them; the generator has to go on as there.
        torch.empty_like(means).normal_()
        self._adapt(old_means, means, deviations)
        away = actions - means
        exponents = _exponents(away, deviations)
        ratio = torch.exp(_log_probability(exponents, deviations) - old_log)
        costs, low, high = -advantages, 1.0 - clip, 1.0 + clip
        plain, clipped = costs * ratio, costs * ratio.clamp(low, high)

        of_plain, of_clipped = of_larger(plain, clipped, torch.tensor(1.0) / len(actions))
        of_log = (of_plain * costs + of_clamped(of_clipped * costs, ratio, low, high)) * ratio
        variances = 2 * deviations**2
        self._actor.learn(of_log / variances * (2 * away))
        of_deviations = -of_log / deviations
        if self.entropy_coef:
            of_deviations = torch.tensor(-self.entropy_coef) / len(actions) / deviations + of_deviations
        of_deviations = of_deviations + -of_log * (exponents / variances) * 2 * (2 * deviations)
        of_deviations = of_clamped(of_deviations.sum(0), self._deviation, *self.actor.distribution.std_range)
        self._deviation.grad.copy_(of_deviations)
        return {"surrogate": torch.max(plain, clipped).mean(), "entropy": (_ENTROPY + deviations.log()).sum()}

    def _teach_critic(self, seen: Tensor, old_values: Tensor, returns: Tensor) -> dict[str, Tensor]:
        """Writes the critic's gradients for one minibatch, and returns the loss of value."""
        values, clip = self._critic(seen), self.clip_param
        change = values - old_values
        off, off_clipped = values - returns, old_values + change.clamp(-clip, clip) - returns
        squares = off**2, off_clipped**2
        of_square, of_clipped = of_larger(*squares, torch.tensor(self.value_loss_coef) / len(values))
        self._critic.learn(of_square * (2 * off) + of_clamped(of_clipped * (2 * off_clipped), change, -clip, clip))
        return {"value": torch.max(*squares).mean()}

    def _adapt(self, old_means: Tensor, means: Tensor, deviations: Tensor) -> None:
        """Adapts the learning rate to the divergence of the policy from the one that acted."""
        ratio = (self.storage.distribution_params[1][0, 0] / deviations).pow(2)
        apart = ((old_means - means) / deviations).pow(2)
        divergence = (0.5 * (ratio + apart - 1 - ratio.log())).sum(dim=-1).mean()
        if divergence > self.desired_kl * 2.0:
            self.learning_rate = max(1e-5, self.learning_rate / 1.5)
        elif divergence < self.desired_kl / 2.0 and divergence > 0.0:
            self.learning_rate = min(1e-2, self.learning_rate * 1.5)
        self.optimizer.param_groups[0]["lr"] = self.learning_rate

    def _deviations(self) -> Tensor:
        """Returns the deviations of the actions, (actions,)."""
        return self._deviation.clamp(*self.actor.distribution.std_range)


def _exponents(away: Tensor, deviations: Tensor) -> Tensor:
    """Returns the exponents of a normal density, of numbers so far away from their mean."""
    return -(away**2) / (2 * deviations**2)


def _log_probability(exponents: Tensor, deviations: Tensor) -> Tensor:
    """Returns the logarithm of the density of actions, (..., 1), of the exponents of their numbers, (..., actions)."""
    return (exponents - deviations.log() - _LOG_ROOT_TWO_PI).sum(dim=-1, keepdim=True)
