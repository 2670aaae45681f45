"""What every task is: a MuJoCo scene with actions, observations, variables, fitness and a human reward.

A task here is a vector of `num_envs` environments. One control step is

    task.step(actions)          # physics, measurements, fitness
    task.present()              # what generated functions read: the state after the step
    done = task.terminated() | task.timed_out()
    task.reset(done)
    task.observations()         # of the new episode where one began

Nothing draws from a global generator, and `state` holds everything that a bit-exact continuation needs.
"""

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar

import mujoco
import torch
from torch import Tensor

from porse.errors import TaskError
from porse.sim.devices import CPU, Device, make_physics
from porse.sim.physics import Capacity
from porse.tasks.source import observation_source
from porse.variables import Variable

Value = Tensor | int | float | tuple[int, ...] | torch.device


class Task(ABC):
    """A vector of environments of one task.

    Subclasses say how the scene is built (`scene`), how an episode starts (`_start`), what an action does (`_act`),
    what is measured (`_measure`: one attribute for each variable), what is observed (`compute_observations`), and
    what success is. Attributes named in `VARIABLES` hold the state after the last step or reset.

    Attributes:
        NAME: the task's name.
        FAMILY: "isaac" or "bidex", after the suite that it comes from; "own" for a task of your own.
        DESCRIPTION: the task text that prompts show.
        STARTS: how an episode starts, in words for prompts: a clause with a subject; empty: prompts say nothing of it.
        ENDS: what ends an episode before the time limit, a clause such as "as soon as the cup is at 0.3 m or lower", or
            "never"; empty: prompts tell the time limit alone.
        FITNESS: what fitness measures, with its unit, in words for prompts; empty: prompts say nothing of it.
        NUM_OBSERVATIONS: width of an observation.
        NUM_ACTIONS: width of an action; each lies in [-1, 1].
        EPISODE_LENGTH: control steps of the longest episode.
        TIME_LIMIT: `progress` at which a whole episode has timed out.
        CONTROL_DT: control step in seconds.
        SUBSTEPS: physics steps in a control step.
        OBSERVATION_CLIP: observations are clipped to +- this; infinity for none.
        FIELDS: derived MuJoCo fields that the measurements read.
        MEASURED: attributes that neither the physics state nor the other saved state gives back, saved as they are: a row
            for each environment.
        CAPACITY: room for contacts on a GPU; too little is an error that names the figure.
        VARIABLES: what generated functions may read.
        OBSERVATION_HELPERS: functions that `compute_observations` calls and prompts show with it.
        OVER_EPISODES: whether `fitness` is a statistic over the episodes that ended, and an epoch's fitness what it is at
            the epoch's end; else it is of the present state, and an epoch's is its mean over the steps.
        num_envs: number of environments.
        progress: steps of the running episodes, int64 `(num_envs,)`.
        head_start: by how many steps the time limit comes sooner for them, int64 `(num_envs,)`; 0 for a whole episode.
        blown_up: simulations that diverged so far; each was started again. A tensor of one number on a GPU.
    """

    NAME: ClassVar[str]
    FAMILY: ClassVar[str] = "own"
    DESCRIPTION: ClassVar[str]
    STARTS: ClassVar[str] = ""
    ENDS: ClassVar[str] = ""
    FITNESS: ClassVar[str] = ""
    NUM_OBSERVATIONS: ClassVar[int]
    NUM_ACTIONS: ClassVar[int]
    EPISODE_LENGTH: ClassVar[int]
    TIME_LIMIT: ClassVar[int]
    CONTROL_DT: ClassVar[float]
    SUBSTEPS: ClassVar[int]
    OBSERVATION_CLIP: ClassVar[float] = float("inf")
    FIELDS: ClassVar[tuple[str, ...]] = ()
    MEASURED: ClassVar[tuple[str, ...]] = ()
    CAPACITY: ClassVar[Capacity] = Capacity(contacts=64, rows=256)
    VARIABLES: ClassVar[tuple[Variable, ...]]
    OBSERVATION_HELPERS: ClassVar[tuple[Callable[..., Tensor], ...]] = ()
    OVER_EPISODES: ClassVar[bool] = False

    def __init_subclass__(cls, **named: Any) -> None:
        """Lets a class that only says what `fitness` is have it in `mean_fitness`, too, whatever the classes above it say.

        So a class that says both asks for its own `mean_fitness` by name in `fitness`: a class below it may call that one.
        """
        super().__init_subclass__(**named)
        if "fitness" in vars(cls) and "mean_fitness" not in vars(cls):
            cls.mean_fitness = Task.mean_fitness  # type: ignore[method-assign]

    def __init__(self, num_envs: int, seed: int, threads: int, device: Device = CPU) -> None:
        """Builds the scene and starts every episode.

        Args:
            num_envs: number of environments.
            seed: seed of the task's own generator, from which every reset draws.
            threads: native threads of the physics; changes no result.
            device: of the physics. On a GPU, this and all other methods are called within `placed`.

        Raises:
            TaskError: `num_envs` or `threads` is not positive, or the device is not there.
        """
        if num_envs < 1 or threads < 1:
            raise TaskError(
                f"{self.NAME} needs at least one environment and one thread, and was given num_envs={num_envs} and "
                f"threads={threads}. Give both as positive whole numbers."
            )
        self.num_envs = num_envs
        self.device = device.torch
        self.control_dt = self.CONTROL_DT
        self.blown_up: int | Tensor = 0
        self.progress = torch.zeros(num_envs, dtype=torch.int64)
        self.head_start = torch.zeros(num_envs, dtype=torch.int64)
        self.actions = torch.zeros(num_envs, self.NUM_ACTIONS)
        self._generator = torch.Generator(self.device).manual_seed(seed)
        self._diverged = torch.zeros(num_envs, dtype=torch.bool)
        self._all = torch.arange(num_envs)
        scene = self.scene()
        scene.option.timestep = self.CONTROL_DT / self.SUBSTEPS
        self._physics = make_physics(scene.compile(), num_envs, threads, self.FIELDS, device, self.CAPACITY)
        self._prepare()
        self._begin(self._all)
        self._physics.keep_start()

    # What a task defines.

    @classmethod
    @abstractmethod
    def scene(cls) -> mujoco.MjSpec:
        """Returns the scene as a MuJoCo specification; its time step is set by `CONTROL_DT` and `SUBSTEPS`."""

    def _prepare(self) -> None:  # noqa: B027  a small task has nothing to prepare
        """Looks up indices in the compiled model and makes the buffers that live as long as the task."""

    @abstractmethod
    def _start(self, ids: Tensor) -> None:
        """Writes start states, drawn from the task's generator, into the restarted simulations `ids`."""

    @abstractmethod
    def _act(self) -> None:
        """Turns `actions` into controls."""

    @abstractmethod
    def _measure(self) -> None:
        """Sets the attributes named in `VARIABLES` from the physics, after a step."""

    def _measure_started(self, ids: Tensor) -> None:
        """Sets the same attributes after the episodes `ids` began; the other rows keep their values."""
        del ids
        self._measure()

    def _record(self) -> None:  # noqa: B027  a fitness of the present state keeps nothing
        """Keeps the fitness statistic, after a step."""

    @abstractmethod
    def compute_observations(self) -> Tensor:
        """Returns the observations before clipping, `(num_envs, NUM_OBSERVATIONS)`."""

    def failed(self) -> Tensor:
        """Returns nowhere: only the time limit ends an episode."""
        return torch.zeros(self.num_envs, dtype=torch.bool)

    @abstractmethod
    def fitness(self) -> float:
        """Returns the task's fitness statistic now."""

    def mean_fitness(self) -> Tensor:
        """Returns `fitness` as a tensor of one number, which stays on the device where a task computes it there."""
        return torch.tensor(self.fitness(), dtype=torch.float64)

    @abstractmethod
    def sparse_reward(self) -> Tensor:
        """Returns the fitness as a reward of each step, float32 `(num_envs,)`."""

    def episode_outcome(self, mean_sparse_reward: Tensor) -> Tensor:
        """Returns what the running episodes are worth if they end now, `(num_envs,)`: here their mean fitness.

        Args:
            mean_sparse_reward: the mean of `sparse_reward` over the steps of each, `(num_envs,)`.
        """
        return mean_sparse_reward

    def human_reward(self) -> Tensor:
        """Returns the reward that people wrote for the original task, float32 `(num_envs,)`; else the sparse one."""
        return self.sparse_reward()

    # What callers use.

    def step(self, actions: Tensor) -> None:
        """Advances every environment by one control step.

        Args:
            actions: `(num_envs, NUM_ACTIONS)`; clamped to [-1, 1].

        Raises:
            TaskError: `actions` has another shape.
        """
        if actions.shape != (self.num_envs, self.NUM_ACTIONS):
            raise TaskError(
                f"{self.NAME} expects actions of shape {(self.num_envs, self.NUM_ACTIONS)} (num_envs, NUM_ACTIONS), "
                f"and step was given {tuple(actions.shape)}. Give one row for each environment."
            )
        self.actions = actions.detach().to(torch.float32).clamp(-1.0, 1.0)
        self._act()
        self._diverged = self._physics.advance(self.SUBSTEPS)
        if self._physics.asynchronous:
            # The physics has put them where they first began.
            self.blown_up = self.blown_up + self._diverged.sum()
        else:
            self._for_some(self._restart_diverged, self._diverged)
        self.progress += 1
        self._measure()
        self._for_some(self._measure_started, self._diverged)
        self._record()

    def observations(self) -> Tensor:
        """Returns the observations now, float32 `(num_envs, NUM_OBSERVATIONS)`, in fresh memory."""
        return self.compute_observations().clamp(-self.OBSERVATION_CLIP, self.OBSERVATION_CLIP)

    def terminated(self) -> Tensor:
        """Returns which episodes ended by the task's rule or because the simulation blew up, bool `(num_envs,)`."""
        return self.failed() | self._diverged

    def timed_out(self) -> Tensor:
        """Returns which episodes reached the time limit, bool `(num_envs,)`."""
        return self.progress + self.head_start >= self.TIME_LIMIT

    def variables(self) -> dict[str, Value]:
        """Returns every variable of `VARIABLES` by name. Tensors are copies: no caller can change the task by them."""
        return dict(self.present())

    def present(self) -> Mapping[str, Value]:
        """Returns the variables, each as it is when it is asked for first, and copied only then.

        A function reads a few of some twenty, and to copy the others would take as long as to compute it.
        """
        return _Present(self)

    def reset(self, mask: Tensor) -> None:
        """Starts a new episode where `mask` (bool `(num_envs,)`) is set, and touches no other environment."""
        self._for_some(self._begin, mask)

    def check(self) -> None:
        """Checks that the physics had room for all contacts since the last check; it may wait for the device.

        Raises:
            TaskError: it had not.
        """
        self._physics.check()

    def stagger(self, seed: int) -> None:
        """Gives each running episode a head start from 0 up to the time limit, as if it had begun so long ago.

        All phases of an episode are then met in every step, instead of one after the other. States and `progress` stay as
        they are: no function takes a beginning for an end. Each head start is uniform by itself; together they are spread
        evenly, one in each of `num_envs` equal stretches of an episode. Drawn apart from each other they would leave gaps and
        crowds, which come back with every episode for as long as nothing else ends one.

        Args:
            seed: of the draw, which leaves the task's own generator alone.
        """
        generator = torch.Generator().manual_seed(seed)
        stretches = torch.randperm(self.num_envs, generator=generator, device="cpu")
        within = torch.randint(self.TIME_LIMIT, (self.num_envs,), generator=generator, device="cpu")
        # Whole numbers all the way: the dividend is uniform on 0 to num_envs TIME_LIMIT - 1.
        self.head_start = ((stretches * self.TIME_LIMIT + within) // self.num_envs).to(self.device)

    def renew(self, mask: Tensor) -> None:
        """Resets episodes that ended, in a training: what `stagger` has spread stays so.

        Where fitness is of the present state, an episode that follows a failure has the time that the failed one had left.
        Otherwise a policy that stops failing would leave episodes that all began a little while ago, in phase again for good.
        A statistic over episodes looks back over all phases by itself, and its episodes have their whole time.
        """
        ages = self.progress + self.head_start
        self.reset(mask)
        if not self.OVER_EPISODES:
            self.head_start = torch.where(mask & (ages < self.TIME_LIMIT), ages, self.head_start)

    @property
    def is_asynchronous(self) -> bool:
        """Whether the device works behind the processor, which a look at any number would make wait."""
        return self._physics.asynchronous

    @property
    def obs_buf(self) -> Tensor:
        """The observations before clipping, `(num_envs, NUM_OBSERVATIONS)`."""
        return self.compute_observations()

    @property
    def progress_buf(self) -> Tensor:
        """`progress` under the name of the original environments."""
        return self.progress

    def state(self) -> dict[str, Tensor]:
        """Returns copies of everything that a bit-exact continuation in another process needs."""
        saved = {
            "physics": self._physics.state(),
            "generator": self._generator.get_state(),
            "blown_up": torch.tensor(int(self.blown_up), device="cpu"),
            "diverged": self._diverged.clone(),
            "progress": self.progress.clone(),
            "head_start": self.head_start.clone(),
            "actions": self.actions.clone(),
        }
        return saved | {f"measured/{name}": getattr(self, name).clone() for name in self.MEASURED}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Continues from what `state` returned.

        Raises:
            TaskError: the state is of another task, another number of environments or another version.
        """
        self._check_state(state)
        self._physics.load_state(state["physics"].to(self.device))
        self._generator.set_state(state["generator"].cpu())
        self.blown_up = int(state["blown_up"])
        self._diverged = self._copied(state["diverged"])
        self.progress = self._copied(state["progress"])
        self.head_start = self._copied(state["head_start"])
        self.actions = self._copied(state["actions"])
        for name in self.MEASURED:
            setattr(self, name, self._copied(state[f"measured/{name}"]))
        self._remeasure()

    @classmethod
    def observation_source(cls) -> str:
        """Returns the observation code as prompts show it: the variables, then the real `compute_observations`."""
        return observation_source(cls)

    # What the base does for itself.

    def _begin(self, ids: Tensor) -> None:
        """Starts new episodes in the environments `ids`, and touches no other."""
        self._physics.restart(ids)
        self._start(ids)
        if self.FIELDS:
            self._physics.refresh(ids)
        self.progress[ids] = 0
        self.head_start[ids] = 0
        self.actions[ids] = 0.0
        self._diverged[ids] = False
        self._measure_started(ids)

    def _for_some(self, do: Callable[[Tensor], None], mask: Tensor) -> None:
        """Does for the environments of `mask` what `do` does for ids.

        Where nobody may ask which they are, it is done for all, and the others get back what they had: what `state` saves,
        which gives all the rest.
        """
        if not self._physics.asynchronous:
            ids = mask.nonzero()
            if len(ids):
                do(ids.squeeze(-1))
            return
        names = ("progress", "head_start", "actions", "_diverged", *self.MEASURED)
        physics, values = self._physics.state(), {name: getattr(self, name).clone() for name in names}
        do(self._all)
        self._physics.load_state(torch.where(mask.unsqueeze(-1), self._physics.state(), physics))
        for name, before in values.items():
            rows = mask.view(-1, *[1] * (before.dim() - 1))
            setattr(self, name, torch.where(rows, getattr(self, name), before))
        self._remeasure()

    def _copied(self, value: Tensor) -> Tensor:
        """Returns a tensor in memory of its own, on the task's device."""
        return value.to(self.device, copy=True)

    def _remeasure(self) -> None:
        """Sets the variables after a state was loaded."""
        self._measure()

    def _restart_diverged(self, ids: Tensor) -> None:
        """Starts the diverged simulations `ids` again; `terminated` reports them until the caller resets them."""
        self.blown_up += len(ids)
        self._physics.restart(ids)
        self._start(ids)
        if self.FIELDS:
            self._physics.refresh(ids)

    def _check_state(self, state: Mapping[str, Tensor]) -> None:
        """Raises a TaskError when `state` does not have this task's keys and shapes."""
        own = self.state()
        found = {name: tuple(value.shape) for name, value in state.items()}
        expected = {name: tuple(value.shape) for name, value in own.items()}
        if found != expected:
            wrong = sorted(k for k in found.keys() | expected.keys() if found.get(k) != expected.get(k))
            raise TaskError(
                f"The state of {self.NAME} with {self.num_envs} environments differs from the one to load in {wrong[0]}"
                f" (expected {expected.get(wrong[0])}, found {found.get(wrong[0])}). Load a state that the same task "
                "with the same number of environments wrote."
            )

    def _uniform(self, low: float, high: float, *shape: int) -> Tensor:
        """Returns float32 draws from U[low, high) of the task's generator."""
        return low + (high - low) * torch.rand(*shape, generator=self._generator, device=self.device)


class _Present(Mapping[str, Value]):
    """A task's variables by name."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._names = _names(type(task))
        self._copies: dict[str, Value] = {}

    def __getitem__(self, name: str) -> Value:
        if name not in self._copies:
            if name not in self._names:
                raise KeyError(name)
            value = getattr(self._task, name)
            self._copies[name] = value.clone() if isinstance(value, Tensor) else value
        return self._copies[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


@functools.cache
def _names(kind: type[Task]) -> tuple[str, ...]:
    return tuple(variable.name for variable in kind.VARIABLES)
