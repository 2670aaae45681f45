"""Every task as a gymnasium environment: `gymnasium.make_vec("porse/Over-v0", num_envs=64, reward="human")`.

Call `register_tasks` first. Ended episodes of a vector environment begin anew in the same step (gymnasium's SAME_STEP
mode): the observation is the new episode's, and `infos["final_obs"]` holds the last one of the old.
`gymnasium.make("porse/Over-v0")` gives a single one, whose caller resets it. With `render_mode="rgb_array"` both draw, so that
gymnasium's `RecordVideo` films them; where there is no display, set MUJOCO_GL=egl or osmesa before the first import.
"""

from collections.abc import Callable
from contextlib import ExitStack
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
Pixels = NDArray[np.uint8]


class _Camera:
    """Draws a task's environments; set up when it is first used, and anew for another task."""

    def __init__(self, render_mode: str | None) -> None:
        if render_mode not in (None, "rgb_array"):
            raise TaskError(
                f"expected render_mode to be None or 'rgb_array', found {render_mode!r}; `porse play` has a viewer"
            )
        self._open = ExitStack()
        self._of: Task | None = None
        self._take: Callable[[int], Pixels] | None = None

    def draw(self, task: Task, index: int) -> Pixels:
        """Returns an environment as it is now, `(height, width, 3)`, 8-bit RGB."""
        # Imported here: without a picture, MuJoCo's renderer is not needed.
        from porse.picture import HEIGHT, WIDTH, camera

        if self._take is None or self._of is not task:
            self.close()
            self._take, self._of = self._open.enter_context(camera(task, WIDTH, HEIGHT)), task
        return self._take(index)

    def close(self) -> None:
        """Lets the renderer go."""
        self._open.close()
        self._take, self._of = None, None


def _metadata(task: type[Task] | Task) -> dict[str, Any]:
    return {"render_modes": ["rgb_array"], "render_fps": max(1, round(1.0 / task.CONTROL_DT))}


class TaskVectorEnv(VectorEnv[Floats, Floats, NDArray[Any]]):
    """A task as gymnasium sees it.

    Args:
        task: name of the task.
        num_envs: number of environments.
        reward: "human" for the original's reward, "sparse" for the fitness as a reward.
        threads: native threads of the physics.
        render_mode: "rgb_array" to draw; None for no pictures.

    Raises:
        TaskError: there is no such task, no such reward or no such render mode.
    """

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        reward: Literal["human", "sparse"] = "human",
        threads: int = 1,
        render_mode: str | None = None,
    ) -> None:
        _check_reward(reward)
        self.render_mode, self._camera = render_mode, _Camera(render_mode)
        self._name, self._reward, self._threads = task, reward, threads
        self._task: Task = make_task(task, num_envs, 0, threads)
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP, **_metadata(self._task)}
        self.num_envs = num_envs
        limit = self._task.OBSERVATION_CLIP
        self.single_observation_space = Box(-limit, limit, (self._task.NUM_OBSERVATIONS,), np.float32)
        self.single_action_space = Box(-1.0, 1.0, (self._task.NUM_ACTIONS,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        """Starts new episodes in all environments; with a seed, from the task's state of that seed.

        `options["reset_mask"]`, bool (num_envs,), starts them in the environments that it names, and leaves the others alone.

        Raises:
            TaskError: the mask is not such an array or names none, or there is a seed with it.
        """
        super().reset(seed=seed)
        mask = (options or {}).get("reset_mask")
        if mask is not None:
            self._task.reset(torch.from_numpy(self._checked(mask, seed)))
        elif seed is None:
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
        # Of all environments together, as an array over them, as every value of a vector environment's infos is.
        fitness = {
            "fitness": np.full(self.num_envs, task.fitness()),
            "_fitness": np.ones(self.num_envs, dtype=np.bool_),
        }
        infos: dict[str, Any] = {**fitness}
        if bool(ended.any()):
            infos |= {"final_obs": task.observations().numpy(), "_final_obs": ended.numpy()}
            infos |= {"final_info": {**fitness, "_fitness": ended.numpy()}, "_final_info": ended.numpy()}
            task.reset(ended)
        return task.observations().numpy(), rewards.numpy(), terminated.numpy(), truncated.numpy(), infos

    def render(self) -> tuple[Pixels, ...] | None:
        """Returns a picture of each environment, `(height, width, 3)`; None without a render mode."""
        if self.render_mode is None:
            return None
        return tuple(self._camera.draw(self._task, index) for index in range(self.num_envs))

    def close_extras(self, **_: Any) -> None:
        """Lets the renderer go."""
        self._camera.close()

    def _checked(self, mask: Any, seed: int | None) -> Flags:
        if (
            not isinstance(mask, np.ndarray)
            or mask.dtype != np.bool_
            or mask.shape != (self.num_envs,)
            or not mask.any()
        ):
            raise TaskError(
                f"expected reset_mask to be a bool array ({self.num_envs},) with an environment in it, found {mask!r}; "
                "leave it out to reset all"
            )
        if seed is not None:
            raise TaskError(
                f"expected no seed beside reset_mask, found {seed}; a task has one generator for all its environments"
            )
        return mask


class TaskSingleEnv(gymnasium.Env[Floats, Floats]):
    """A task with one environment as gymnasium sees it; the arguments are those of `TaskVectorEnv`."""

    def __init__(self, task: str, reward: Literal["human", "sparse"] = "human", render_mode: str | None = None) -> None:
        _check_reward(reward)
        self.render_mode, self._camera = render_mode, _Camera(render_mode)
        self._name, self._reward = task, reward
        self._task: Task = make_task(task, 1, 0)
        self.metadata = _metadata(self._task)
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

    def render(self) -> Pixels | None:
        """Returns a picture of the environment, `(height, width, 3)`; None without a render mode."""
        return None if self.render_mode is None else self._camera.draw(self._task, 0)

    def close(self) -> None:
        """Lets the renderer go."""
        self._camera.close()


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
