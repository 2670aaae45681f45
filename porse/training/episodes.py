"""What a policy is worth once it is trained: whole episodes of its mean action, and what becomes of each."""

from dataclasses import dataclass

import torch

from porse.tasks.base import Task
from porse.training.actor import Actor


@dataclass(frozen=True)
class Episode:
    """One whole episode.

    Attributes:
        steps: control steps that it took.
        outcome: what it came to, see `Task.episode_outcome`.
    """

    steps: int
    outcome: float


def play_episodes(task: Task, actor: Actor) -> list[Episode]:
    """Returns the first episode of every environment, played to its end; what environments do afterwards counts nowhere.

    As many episodes as ended first, of however many, would hold too many short ones: here each environment gives one.

    Args:
        task: a fresh task, whose episodes are all of age 0.
        actor: what acts.
    """
    steps, paid = torch.zeros(task.num_envs, dtype=torch.int64), torch.zeros(task.num_envs, dtype=torch.float64)
    outcomes = torch.zeros(task.num_envs, dtype=torch.float64)
    playing = torch.ones(task.num_envs, dtype=torch.bool)
    with torch.inference_mode():
        while bool(playing.any()):
            task.step(actor(task.observations()))
            steps += playing
            paid += torch.where(playing, task.sparse_reward().double(), 0.0)
            ends = task.terminated() | task.timed_out()
            worth = task.episode_outcome(paid / steps)
            outcomes = torch.where(playing & ends, worth.double(), outcomes)
            playing &= ~ends
            # An environment goes on, as a simulation that was left alone might run away.
            task.reset(ends)
    return [Episode(*pair) for pair in zip(steps.tolist(), outcomes.tolist(), strict=True)]
