"""rsl_rl's PPO, built from the parameters, with clipped observations and the two changes that bit-identity needs.

Adam is the fused one, and the running deviation of the observations is taken by `rsqrt`: PyTorch's square root, which the
unfused Adam and rsl_rl's normaliser use, goes through MKL's vector maths and differs between CPU vendors.
"""

from itertools import chain

import torch
from rsl_rl.models import MLPModel
from rsl_rl.modules import EmpiricalNormalization
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict
from torch import Tensor

from porse.config import TrainParams
from porse.training.lean import LeanPPO

_GROUPS = {"actor": ["policy"], "critic": ["policy"]}


class ClippedNormalization(EmpiricalNormalization):
    """rsl_rl's running normalisation, clipped, and with a square root that is the same on every CPU.

    Args:
        width: numbers in an observation.
        clip: normalised values are cut off at this size.
    """

    _mean: Tensor
    _var: Tensor
    _std: Tensor

    def __init__(self, width: int, clip: float) -> None:
        super().__init__(width)
        self.clip = clip

    def forward(self, x: Tensor) -> Tensor:
        """Returns observations (samples, observations) in deviations from their mean, clipped."""
        return torch.clamp((x - self._mean) / (self._std + self.eps), -self.clip, self.clip)

    @torch.jit.unused
    def update(self, x: Tensor) -> None:
        """Learns from a batch (samples, observations)."""
        super().update(x)
        self._std = torch.rsqrt(self._var).reciprocal()


def build_ppo(observations: TensorDict, num_actions: int, params: TrainParams) -> LeanPPO:
    """Returns PPO with fresh networks drawn from torch's global generator, which the caller has seeded."""
    distribution = {"class_name": "GaussianDistribution", "init_std": params.init_std}
    actor = _network(observations, "actor", num_actions, params, distribution)
    critic = _network(observations, "critic", 1, params, None)
    num_envs = observations.batch_size[0]
    device = str(observations["policy"].device)
    storage = RolloutStorage("rl", num_envs, params.steps_per_epoch, observations, [num_actions], device)
    ppo = LeanPPO(
        actor,
        critic,
        storage,
        num_learning_epochs=params.passes,
        num_mini_batches=params.minibatches,
        clip_param=params.clip,
        gamma=params.gamma,
        lam=params.gae_lambda,
        value_loss_coef=params.value_coefficient,
        entropy_coef=params.entropy,
        learning_rate=params.learning_rate,
        max_grad_norm=params.max_grad_norm,
        schedule="adaptive",
        desired_kl=params.desired_kl,
        device=device,
    )
    parameters = chain(ppo.actor.parameters(), ppo.critic.parameters())
    ppo.optimizer = torch.optim.Adam(parameters, lr=params.learning_rate, fused=True)
    return ppo


def _network(
    observations: TensorDict, role: str, outputs: int, params: TrainParams, distribution: dict[str, object] | None
) -> MLPModel:
    network = MLPModel(
        observations,
        _GROUPS,
        role,
        outputs,
        hidden_dims=list(params.hidden),
        activation=params.activation,
        obs_normalization=params.normalise_observations,
        distribution_cfg=distribution,
    )
    if params.normalise_observations:
        network.obs_normalizer = ClippedNormalization(network.obs_dim, params.observation_clip)
    return network
