"""Every task as a gymnasium environment: `gymnasium.make_vec("porse/Over-v0", num_envs=64, reward="human")`.

Call `register_tasks` first. Ended episodes of a vector environment begin anew in the same step (gymnasium's SAME_STEP
mode): the observation is the new episode's, and `infos["final_obs"]` holds the last one of the old.
`gymnasium.make("porse/Over-v0")` gives a single one, whose caller resets it.
"""

from functools import partial
from typing import Any, Literal

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from porse.errors import TaskError
from porse.tasks import TASKS, make_task
from porse.tasks.base import Task

Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]


class TaskVectorEnv(VectorEnv[Floats, Floats, NDArray[Any]]):
    """A task as gymnasium sees it.

    Args:
        task: name of the task.
        num_envs: number of environments.
        reward: "human" for the original's reward, "sparse" for the fitness as a reward.
        threads: native threads of the physics.

    Raises:
        TaskError: there is no such task or no such reward.
    """

    def __init__(
        self, task: str, num_envs: int = 1, reward: Literal["human", "sparse"] = "human", threads: int = 1
    ) -> None:
        _check_reward(reward)
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}
        self._name, self._reward, self._threads = task, reward, threads
        self._task: Task = make_task(task, num_envs, 0, threads)
        self.num_envs = num_envs
        limit = self._task.OBSERVATION_CLIP
        self.single_observation_space = Box(-limit, limit, (self._task.NUM_OBSERVATIONS,), np.float32)
        self.single_action_space = Box(-1.0, 1.0, (self._task.NUM_ACTIONS,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        """Starts new episodes in all environments; with a seed, from the task's state of that seed."""
        super().reset(seed=seed)
        if seed is None:
            self._task.reset(torch.ones(self.num_envs, dtype=torch.bool))
        else:
            self._task = make_task(self._name, self.num_envs, seed, self._threads)
        return self._task.observations().numpy(), {}

    def step(self, actions: Floats) -> tuple[Floats, Floats, Flags, Flags, dict[str, Any]]:
        """Advances all environments by one control step."""
        task = self._task
        task.step(torch.as_tensor(np.asarray(actions, dtype=np.float32)))
        rewards = task.human_reward() if self._reward == "human" else task.sparse_reward()
        terminated = task.terminated()
        truncated = task.timed_out() & ~terminated
        ended = terminated | truncated
        infos: dict[str, Any] = {"fitness": task.fitness()}
        if bool(ended.any()):
            infos |= {"final_obs": task.observations().numpy(), "_final_obs": ended.numpy()}
            task.reset(ended)
        return task.observations().numpy(), rewards.numpy(), terminated.numpy(), truncated.numpy(), infos


class TaskSingleEnv(gymnasium.Env[Floats, Floats]):
    """A task with one environment as gymnasium sees it; the arguments are those of `TaskVectorEnv`."""

    def __init__(self, task: str, reward: Literal["human", "sparse"] = "human") -> None:
        _check_reward(reward)
        self.metadata = {"render_modes": []}
        self._name, self._reward = task, reward
        self._task: Task = make_task(task, 1, 0)
        limit = self._task.OBSERVATION_CLIP
        self.observation_space = Box(-limit, limit, (self._task.NUM_OBSERVATIONS,), np.float32)
        self.action_space = Box(-1.0, 1.0, (self._task.NUM_ACTIONS,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        """Starts a new episode; with a seed, from the task's state of that seed."""
        super().reset(seed=seed)
        if seed is None:
            self._task.reset(torch.ones(1, dtype=torch.bool))
        else:
            self._task = make_task(self._name, 1, seed)
        return self._task.observations()[0].numpy(), {}

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Advances the environment by one control step."""
        task = self._task
        task.step(torch.as_tensor(np.asarray(action, dtype=np.float32))[None])
        reward = float(task.human_reward() if self._reward == "human" else task.sparse_reward())
        terminated = bool(task.terminated())
        truncated = bool(task.timed_out()) and not terminated
        return task.observations()[0].numpy(), reward, terminated, truncated, {"fitness": task.fitness()}


def _check_reward(reward: str) -> None:
    if reward not in ("human", "sparse"):
        raise TaskError(f"A task pays the reward 'human' or 'sparse', and {reward!r} was asked for. Name one of them.")


def register_tasks() -> None:
    """Registers every task with gymnasium as `porse/NAME-v0`; a second call changes nothing."""
    for name in TASKS:
        if f"porse/{name}-v0" not in gymnasium.registry:
            gymnasium.register(
                id=f"porse/{name}-v0",
                entry_point=partial(TaskSingleEnv, name),
                vector_entry_point=partial(TaskVectorEnv, name),
            )
