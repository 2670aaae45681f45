"""rsl_rl's PPO with less around it: the same draws, the same sums in the same order, and so the same weights, bit for bit.

Its update goes through tensor dictionaries, autograd and torch's distributions, gathers every minibatch once a pass, and
computes an entropy whatever its weight. Here the rollout is plain tensors, a minibatch is gathered once an epoch with its
observations normalised, and the gradient is written out: what autograd would call, and in which order it would add it up.
Whatever is equal in all rows, all that follows from the deviations of the actions alone, is computed for one row.
`tests/test_lean.py` holds it to the library's own.
"""

import math
from typing import Any

import torch
from rsl_rl.algorithms import PPO
from torch import Tensor

from porse.training.gradients import Layers, of_clamped, of_larger, shorten

_LOG_ROOT_TWO_PI = math.log(math.sqrt(2 * math.pi))
_ENTROPY = 0.5 + 0.5 * math.log(2 * math.pi)
"""Of a normal distribution with deviation 1."""


class LeanPPO(PPO):
    """PPO as `porse.training.ppo.build_ppo` makes it: two networks, one normal distribution, an adaptive learning rate."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._actor, self._critic = Layers(self.actor), Layers(self.critic)
        self._deviation = self.actor.distribution.std_param
        self._seen = self.storage.observations["policy"]
        self._means = torch.zeros_like(self.storage.actions)

    def choose(self, observations: Tensor) -> Tensor:
        """Returns drawn actions, (num_envs, actions), for observations (num_envs, observations), and stores the step."""
        storage, step = self.storage, self.storage.step
        self._seen[step] = observations
        means = self._actor(self._actor.normalise(observations))
        storage.actions[step] = torch.normal(means, self._deviations().expand_as(means))
        storage.values[step] = self._critic(self._critic.normalise(observations))
        self._means[step] = means
        return storage.actions[step]

    def follow(self, ends: Tensor, timed_out: Tensor) -> None:
        """Stores what became of the step: (num_envs,) bool each, and the value that a time limit cut off as its reward."""
        storage, step = self.storage, self.storage.step
        storage.dones[step] = ends.unsqueeze(1)
        storage.rewards[step] = self.gamma * (storage.values[step] * timed_out.unsqueeze(1))
        storage.step += 1

    def finish(self, observations: Tensor) -> None:
        """Computes the returns and advantages of an epoch that has been paid.

        Args:
            observations: of the states that it led to, (num_envs, observations).
        """
        storage, deviations = self.storage, self._deviations()
        storage.distribution_params = (self._means, deviations.expand_as(self._means))
        log_probability = _log_probability(storage.actions - self._means, deviations)
        storage.actions_log_prob = log_probability.sum(dim=-1, keepdim=True)
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
        sums = [0.0, 0.0, 0.0]
        for batch in batches:
            with torch.inference_mode():
                losses = self._learn(*batch)
                for own in gradients:
                    shorten(own, self.max_grad_norm)
            self.optimizer.step()
            sums = [total + loss.item() for total, loss in zip(sums, losses, strict=True)]
        seen = {"policy": self._seen.flatten(0, 1)}
        self.actor.update_normalization(seen)
        self.critic.update_normalization(seen)
        self.storage.clear()
        return dict(zip(("value", "surrogate", "entropy"), (total / len(batches) for total in sums), strict=True))

    def _batches(self) -> list[tuple[Tensor, ...]]:
        """Returns the epoch's minibatches, in the order of `_learn`'s arguments."""
        storage, seen = self.storage, self._seen.flatten(0, 1)
        parts = (
            storage.actions,
            self._means,
            storage.actions_log_prob,
            storage.advantages,
            storage.values,
            storage.returns,
        )
        flat = [self._actor.normalise(seen), self._critic.normalise(seen), *(part.flatten(0, 1) for part in parts)]
        size = len(seen) // self.num_mini_batches
        order = torch.randperm(self.num_mini_batches * size).split(size)
        # Each in memory of its own: in the profile `fast`, a product's bits depend on where its factors begin.
        return [tuple(part.index_select(0, chosen) for part in flat) for chosen in order]

    def _learn(
        self, for_actor: Tensor, for_critic: Tensor, actions: Tensor, old_means: Tensor, old_log: Tensor,
        advantages: Tensor, old_values: Tensor, returns: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:  # fmt: skip
        """Writes the gradients of one minibatch, (samples, ...) each, and returns the losses of value, surrogate, entropy."""
        deviations, clip = self._deviations(), self.clip_param
        whole, of_value, of_entropy = torch.tensor([1.0, self.value_loss_coef, -self.entropy_coef]) / len(actions)
        means = self._actor(for_actor)
        torch.empty_like(means).normal_()  # actions that rsl_rl draws and nobody takes
        away = actions - means
        ratio = torch.exp(_log_probability(away, deviations).sum(dim=-1, keepdim=True) - old_log)
        plain, clipped = -advantages * ratio, -advantages * ratio.clamp(1.0 - clip, 1.0 + clip)
        values = self._critic(for_critic)
        self._adapt(old_means, means, deviations)

        of_plain, of_clipped = of_larger(plain, clipped, whole)
        of_ratio = of_plain * -advantages + of_clamped(of_clipped * -advantages, ratio, 1.0 - clip, 1.0 + clip)
        of_log = of_ratio * ratio
        variances = 2 * deviations**2
        self._actor.learn(of_log / variances * (2 * away))
        of_deviations = -of_log / deviations
        if self.entropy_coef:
            of_deviations = of_entropy / deviations + of_deviations
        of_deviations = of_deviations + -of_log * (-(away**2) / variances / variances) * 2 * (2 * deviations)
        low, high = self.actor.distribution.std_range
        self._deviation.grad.copy_(of_clamped(of_deviations.sum(0), self._deviation, low, high))

        change = values - old_values
        off, off_clipped = values - returns, old_values + change.clamp(-clip, clip) - returns
        of_square, of_square_clipped = of_larger(off**2, off_clipped**2, of_value)
        inside = of_clamped(of_square_clipped * (2 * off_clipped), change, -clip, clip)
        self._critic.learn(of_square * (2 * off) + inside)

        entropy = (_ENTROPY + torch.log(deviations)).sum()
        return torch.max(off**2, off_clipped**2).mean(), torch.max(plain, clipped).mean(), entropy

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


def _log_probability(away: Tensor, deviations: Tensor) -> Tensor:
    """Returns the logarithm of the density of each number of an action, so far away from its mean."""
    return -(away**2) / (2 * deviations**2) - deviations.log() - _LOG_ROOT_TWO_PI
