"""The same humanoid three times: gymnasium's Humanoid-v5 in this project's physics, in EnvPool, and in gymnasium itself.

Model, control step (five substeps of 3 ms), actions, reset noise, reward and ends are gymnasium's. Observations are, too, but for
the contact forces, which this physics does not compute: EnvPool is told to leave them out as well, gymnasium cannot.
Counted is processor time for each environment step, of all processes and threads.
"""

import importlib.util
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import mujoco
import numpy as np
import psutil
import torch

from porse.sim.physics import CpuPhysics

ACTION = 0.4
"""Largest action, by size."""

SUBSTEPS = 5
TIME_LIMIT = 1000

_FIELDS = ("cinert", "cvel", "qfrc_actuator", "xipos")
_HEALTHY = (1.0, 2.0)
"""Between which heights (m) of the pelvis an episode goes on."""
_NOISE = 0.01
_FORWARD, _ALIVE, _EFFORT = 1.25, 5.0, 0.1
"""Weights of the reward."""


class Humanoids(Protocol):
    """Humanoids that are stepped side by side."""

    def step(self, actions: np.ndarray) -> None:
        """Steps each of them with one row of actions, and starts new episodes where some ended."""

    def spent_s(self) -> float:
        """Returns the processor seconds that have been spent so far, of all processes that step them."""


class OwnHumanoids:
    """Humanoids in this project's physics.

    Attributes:
        observations: of the states after the last step, float32 `(num_envs, 270)`.
        rewards: of the last step, `(num_envs,)`.
        ended: whether the last step ended an episode, bool `(num_envs,)`.
    """

    def __init__(self, num_envs: int, threads: int = 1) -> None:
        self._model = mujoco.MjModel.from_xml_path(str(model_file()))
        self._physics = CpuPhysics(self._model, num_envs, threads, _FIELDS)
        self._generator = torch.Generator().manual_seed(0)
        self._ages = torch.zeros(num_envs, dtype=torch.int64)
        self._mass = torch.from_numpy(self._model.body_mass).float()
        self.rewards, self.ended = torch.zeros(num_envs), torch.zeros(num_envs, dtype=torch.bool)
        self._start(torch.arange(num_envs))
        self._place = self._mass_centre()
        self.observations = self._observed()

    def step(self, actions: np.ndarray) -> None:
        """See `Humanoids.step`."""
        physics = self._physics
        physics.ctrl[:] = torch.from_numpy(actions)
        diverged = physics.advance(SUBSTEPS)
        self._ages += 1
        height = physics.qpos[:, 2]
        healthy = (height > _HEALTHY[0]) & (height < _HEALTHY[1])
        place = self._mass_centre()
        speed = (place - self._place) / (SUBSTEPS * self._model.opt.timestep)
        effort = physics.ctrl.square().sum(dim=1)
        self.rewards = _FORWARD * speed + _ALIVE * healthy - _EFFORT * effort
        self.ended = ~healthy | diverged | (self._ages >= TIME_LIMIT)
        ids = self.ended.nonzero().squeeze(-1)
        if len(ids):
            self._start(ids)
            place = self._mass_centre()
        self._place = place
        self.observations = self._observed()

    def spent_s(self) -> float:
        """See `Humanoids.spent_s`."""
        return time.process_time()

    def _start(self, ids: torch.Tensor) -> None:
        physics = self._physics
        physics.restart(ids)
        for state in (physics.qpos, physics.qvel):
            noise = torch.rand(len(ids), state.shape[1], generator=self._generator, dtype=torch.float64)
            state[ids] += _NOISE * (2.0 * noise - 1.0)
        physics.refresh(ids)
        self._ages[ids] = 0

    def _mass_centre(self) -> torch.Tensor:
        """Returns where the centre of mass is along the way forward, m, `(num_envs,)`."""
        return self._physics.read("xipos")[:, :, 0] @ self._mass / self._mass.sum()

    def _observed(self) -> torch.Tensor:
        physics = self._physics
        # The world's own rows are constant, and the first joint has no motor.
        rows = [physics.read(name)[:, 1:].flatten(1) for name in ("cinert", "cvel")]
        torques = physics.read("qfrc_actuator")[:, 6:]
        return torch.cat([physics.positions()[:, 2:], physics.velocities(), *rows, torques], dim=1)


class _EnvPool:
    def __init__(self, num_envs: int) -> None:
        import envpool

        self._envs: Any = envpool.make(
            "Humanoid-v5", env_type="gymnasium", num_envs=num_envs, num_threads=1, seed=0, post_constraint=False
        )
        self._envs.reset()

    def step(self, actions: np.ndarray) -> None:
        self._envs.step(actions)

    def spent_s(self) -> float:
        return time.process_time()


class _Gymnasium:
    def __init__(self, num_envs: int) -> None:
        import gymnasium

        made = [lambda: gymnasium.make("Humanoid-v5")] * num_envs
        self.envs: Any = gymnasium.vector.AsyncVectorEnv(made)
        self.envs.reset(seed=0)
        self._workers = [psutil.Process(process.pid) for process in self.envs.processes]

    def step(self, actions: np.ndarray) -> None:
        self.envs.step(actions.astype(np.float32))

    def spent_s(self) -> float:
        times = [worker.cpu_times() for worker in self._workers]
        return time.process_time() + sum(each.user + each.system for each in times)


def of_envpool(num_envs: int) -> Humanoids:
    """Returns EnvPool's, stepped by one thread."""
    return _EnvPool(num_envs)


@contextmanager
def of_gymnasium(num_envs: int) -> Iterator[Humanoids]:
    """Gives gymnasium's, one process each, which end with the block."""
    made = _Gymnasium(num_envs)
    try:
        yield made
    finally:
        made.envs.close()


def lacking(*packages: str) -> list[str]:
    """Returns those of the packages that are not installed."""
    return [name for name in packages if importlib.util.find_spec(name) is None]


def model_file() -> Path:
    """Returns gymnasium's model of the humanoid."""
    found = importlib.util.find_spec("gymnasium")
    assert found is not None
    assert found.origin is not None
    return Path(found.origin).parent / "envs" / "mujoco" / "assets" / "humanoid.xml"


def step_s(humanoids: Humanoids, drawn: np.ndarray) -> float:
    """Returns the processor seconds of one step of all humanoids.

    Args:
        humanoids: who is stepped.
        drawn: actions, `(steps, num_envs, 17)`.
    """
    begun = humanoids.spent_s()
    for actions in drawn:
        humanoids.step(actions)
    return (humanoids.spent_s() - begun) / len(drawn)
