"""rsl_rl's own runner on one of the tasks, with the settings of a training: what `porse.training.trainer` is compared with."""

import contextlib
import io
from typing import Any

import torch
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict
from torch import Tensor

from porse.config import TrainParams
from porse.tasks.base import Task
from porse.training.vecenv import observation_groups


class HumanEnv(VecEnv):
    """A task that pays its human reward, as rsl_rl wants an environment."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self.num_envs, self.num_actions = task.num_envs, task.NUM_ACTIONS
        self.max_episode_length, self.device = task.TIME_LIMIT, task.device
        self.cfg: dict[str, Any] = {}

    @property
    def episode_length_buf(self) -> Tensor:
        """Steps of the running episodes, `(num_envs,)`."""
        return self._task.progress

    def get_observations(self) -> TensorDict:
        """Returns the observations now."""
        return observation_groups(self._task.observations())

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict]:
        """See `VecEnv.step`: episodes that ended begin again in the same step."""
        task = self._task
        task.step(actions)
        rewards, terminated, timed_out = task.human_reward(), task.terminated(), task.timed_out()
        ends = terminated | timed_out
        if bool(ends.any()):
            task.renew(ends)
        return self.get_observations(), rewards, ends, {"time_outs": (timed_out & ~terminated).float()}


def stock_runner(task: Task, train: TrainParams) -> OnPolicyRunner:
    """Returns the runner, which logs and saves nothing.

    Args:
        task: what it trains on.
        train: the settings; Adam and the normaliser of observations are the library's own, which do not clip.
    """
    network = {
        "class_name": "MLPModel",
        "hidden_dims": list(train.hidden),
        "activation": train.activation,
        "obs_normalization": train.normalise_observations,
    }
    distribution = {"class_name": "GaussianDistribution", "init_std": train.init_std}
    algorithm = {
        "class_name": "PPO",
        "num_learning_epochs": train.passes,
        "num_mini_batches": train.minibatches,
        "clip_param": train.clip,
        "gamma": train.gamma,
        "lam": train.gae_lambda,
        "value_loss_coef": train.value_coefficient,
        "entropy_coef": train.entropy,
        "learning_rate": train.learning_rate,
        "max_grad_norm": train.max_grad_norm,
        "schedule": "adaptive",
        "desired_kl": train.desired_kl,
    }
    settings: dict[str, Any] = {
        "num_steps_per_env": train.steps_per_epoch,
        "save_interval": 1,
        "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
        "actor": {**network, "distribution_cfg": distribution},
        "critic": network,
        "algorithm": algorithm,
    }
    torch.manual_seed(0)
    # It prints its networks.
    with contextlib.redirect_stdout(io.StringIO()):
        return OnPolicyRunner(HumanEnv(task), settings, log_dir=None, device=str(task.device))
