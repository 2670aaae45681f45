"""What has to stay finite in a training, asked once an epoch: it costs some hundredths of a per cent of one."""

import torch
from rsl_rl.algorithms import PPO
from torch import Tensor

from porse.training.reward import CandidateFailed


def finite(what: str, values: Tensor) -> None:
    """Returns when all values are finite.

    Raises:
        CandidateFailed: they are not; `what` begins the sentence.
    """
    if not bool(torch.isfinite(values).all()):
        share = 1.0 - torch.isfinite(values).float().mean().item()
        raise CandidateFailed(f"{what} not finite in {share:.1%} of the values")


def check_policy(ppo: PPO) -> None:
    """Returns when the weights are finite and the deviations of the actions are positive.

    rsl_rl draws with at least 1e-6 whatever the deviation is: it cannot grow again from below.

    Raises:
        CandidateFailed: they are not.
    """
    weights = [*ppo.actor.named_parameters(), *ppo.critic.named_parameters()]
    for name, weight in weights:
        finite(f"its weights {name} were", weight.detach())
    deviation = ppo.actor.distribution.std_param.detach()
    if not bool((deviation > 0.0).all()):
        raise CandidateFailed(f"the deviation of its actions fell to {deviation.min().item():.3g}")
