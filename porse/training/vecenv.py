"""One task, one reward: the vector environment that PPO trains on.

Order of a step: the action moves the task, the reward sees the state that it led to, environments that ended are
reset, and the observations of the states after the reset are returned (rsl_rl's same-step reset). Ends by the time limit
alone are told apart: PPO goes on there with the value of the last state. A step pays nothing: the reward is paid for a
whole epoch at its end.
"""

from tensordict import TensorDict
from torch import Tensor

from porse.tasks.base import Task
from porse.training.fitness import EpochFitness
from porse.training.lengths import EpisodeLengths
from porse.training.reward import EpochMeans, Reward


def observation_groups(observations: Tensor) -> TensorDict:
    """Returns observations `(num_envs, observations)` as rsl_rl wants them: one group, for actor and critic."""
    return TensorDict({"policy": observations}, batch_size=[len(observations)])


class TaskEnv:
    """A task and a reward, and what an epoch is measured by.

    Attributes:
        task: the task that is trained on.
        reward: what pays at the end of an epoch.
        means: the series of the running epoch that the reward does not know.
        fitness: the fitness of the running epoch.
        lengths: of the episodes that ended in the running epoch.
    """

    def __init__(self, task: Task, reward: Reward) -> None:
        self.task, self.reward, self.means = task, reward, EpochMeans()
        self.fitness, self.lengths = EpochFitness(), EpisodeLengths()

    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Moves all environments by one control step.

        Returns:
            Observations after resets, (num_envs, observations), and two of (num_envs,) bool: ends, and those of them that
            are by the time limit alone.

        Raises:
            CandidateFailed: the reward's functions failed.
        """
        self.task.step(actions)
        self.fitness.add(self.task)
        self.reward.see(self.task)
        terminated, timed_out = self.task.terminated(), self.task.timed_out()
        self.means.add({"terminated": terminated})
        ends = terminated | timed_out
        # Where a look at the mask would make the processor wait, it is renewed unseen.
        if self.task.is_asynchronous or bool(ends.any()):
            self.lengths.add(self.task.progress, ends)
            self.task.renew(ends)
        return self.task.observations(), ends, timed_out & ~terminated
