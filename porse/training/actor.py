"""A policy as it acts once it is trained: its mean action."""

from collections.abc import Callable
from pathlib import Path

from torch import Tensor

from porse.checkpoint import read_checkpoint
from porse.config import TrainParams
from porse.tasks.base import Task
from porse.training.ppo import build_ppo
from porse.training.snapshot import load_policy
from porse.training.vecenv import observation_groups

Actor = Callable[[Tensor], Tensor]
"""Observations `(num_envs, observations)` -> actions `(num_envs, actions)`."""


def policy_actor(task: Task, checkpoint: Path, params: TrainParams) -> Actor:
    """Returns the mean action of the policy in a file; nothing is drawn, and its observation statistics stay as they are.

    Raises:
        CheckpointError: the file is missing, damaged, or of other networks.
    """
    content = read_checkpoint(checkpoint)
    ppo = build_ppo(observation_groups(task.observations()), task.NUM_ACTIONS, params)
    load_policy(ppo, content, task.NAME, checkpoint)
    ppo.eval_mode()
    return lambda observations: ppo.actor(observation_groups(observations))
