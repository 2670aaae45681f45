"""Theta_random of an iteration: a policy with fresh networks of the task's sizes."""

from porse.checkpoint import Checkpoint
from porse.config import Params
from porse.identity import seed_for
from porse.tasks import find_task
from porse.training.trainer import draw_policy


def random_policy(params: Params, iteration: int | str) -> Checkpoint:
    """Returns theta_random, drawn from the seed named by the run's seed and the iteration."""
    task = find_task(params.task)
    seed = seed_for(params.seed, "policy", iteration)
    return draw_policy(task.NUM_OBSERVATIONS, task.NUM_ACTIONS, params.train, seed)
