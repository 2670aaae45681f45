"""Many simulations of one model behind one small interface.

`Physics` is what tasks use: live views of states and controls, one call that advances every simulation, and copies of
derived fields. `CpuPhysics` does it with MuJoCo's own batch, `porse.sim.warp.WarpPhysics` on a GPU. A simulation that blows
up never ends the program: `advance` says which ones did, and the caller starts them again.
"""

import ctypes
from abc import ABC, abstractmethod
from dataclasses import dataclass

import mujoco
import numpy as np
import torch
from mujoco.batch import Batch, SimulationError
from numpy.typing import NDArray
from torch import Tensor

from porse.sim import skeleton
from porse.sim.stages import PASSIVE, second_pass

SPEED_LIMIT = 1e4
"""Generalised speed (m/s or rad/s) above which a simulation counts as blown up; no task moves at a tenth of it."""

Floats = NDArray[np.float64]

_BAD = [
    mujoco.mjtWarning.mjWARN_BADQPOS.value,
    mujoco.mjtWarning.mjWARN_BADQVEL.value,
    mujoco.mjtWarning.mjWARN_BADQACC.value,
    mujoco.mjtWarning.mjWARN_BADCTRL.value,
]

_NONE = mujoco.mjtStage.mjSTAGE_NONE.value
_VELOCITIES = mujoco.mjtStage.mjSTAGE_VEL.value

_QUIET = ctypes.CDLL(None).strlen
"""A warning handler that does nothing: it must be a C function of one string, since native threads call it."""


@dataclass(frozen=True)
class Capacity:
    """Room that a back end sets aside before it begins.

    Attributes:
        contacts: of each simulation, on average; geoms whose bounds overlap count as well.
        rows: of the constraint solver, of each simulation at most.
    """

    contacts: int
    rows: int


class Physics(ABC):
    """`num_envs` simulations of `model`.

    Attributes:
        model: the compiled model, shared by all simulations.
        num_envs: number of simulations.
        device: of all tensors.
        real: the type of the live tensors, of `kept` and of `fastest`.
        asynchronous: whether the device works behind the processor, which would wait for it with every look at a number. A
            rollout must not ask there which simulations did something: masks stay masks, and ids are those of all.
        qpos: positions `(num_envs, nq)`, live: a write is the state at the next call. Quaternions are MuJoCo's.
        qvel: velocities `(num_envs, nv)`, live.
        ctrl: controls `(num_envs, nu)`, live.
        force: external wrench on each body, force then torque, world frame, `(num_envs, nbody, 6)`, live.
        mocap_pos: positions of the bodies that only a task moves, `(num_envs, nmocap, 3)`, live.
        mocap_quat: their orientations, MuJoCo's order, `(num_envs, nmocap, 4)`, live.
        kept: the share of its velocity that each degree of freedom keeps when a step begins, `(nv,)`, or None
            where nothing is dragged (see `porse.sim.drag`). Outer forces are for whoever writes them to scale.
        fastest: the highest speed with which each degree of freedom begins a step, `(nv,)`, or None for no bound.
    """

    model: mujoco.MjModel
    num_envs: int
    device: torch.device = torch.device("cpu")
    real: torch.dtype = torch.float64
    asynchronous: bool = False
    qpos: Tensor
    qvel: Tensor
    ctrl: Tensor
    force: Tensor
    mocap_pos: Tensor
    mocap_quat: Tensor
    kept: Tensor | None = None
    fastest: Tensor | None = None

    @abstractmethod
    def advance(self, substeps: int) -> Tensor:
        """Advances all simulations and returns which ones blew up, bool `(num_envs,)`.

        Their states are undefined; but on an asynchronous back end they are back in the states that `keep_start` has kept.
        """

    @abstractmethod
    def restart(self, ids: Tensor) -> None:
        """Puts the simulations `ids` (int64) into the model's initial state; derived fields wait for `refresh`."""

    @abstractmethod
    def refresh(self, ids: Tensor) -> None:
        """Computes the derived fields that depend on positions and velocities, for the simulations `ids`."""

    @abstractmethod
    def read(self, field: str, ids: Tensor | None = None) -> Tensor:
        """Returns a float32 copy of a derived field that was named when the physics was made.

        Args:
            field: name of the `MjData` field.
            ids: the simulations (int64) to read, or None for all.

        Returns:
            `(num_envs, ...)` or `(len(ids), ...)`.
        """

    def positions(self) -> Tensor:
        """Returns a float32 copy of `qpos`."""
        return self.qpos.to(torch.float32, copy=True)

    def velocities(self) -> Tensor:
        """Returns a float32 copy of `qvel`."""
        return self.qvel.to(torch.float32, copy=True)

    @abstractmethod
    def state(self) -> Tensor:
        """Returns a copy of everything that an exact continuation needs, of type `real`, `(num_envs, n)`."""

    @abstractmethod
    def load_state(self, state: Tensor) -> None:
        """Continues from what `state` returned. Derived fields stay as they are."""

    def keep_start(self) -> None:  # noqa: B027  who sees that one did starts it again by itself
        """Keeps the present states for simulations that blow up."""

    def check(self) -> None:  # noqa: B027  a back end that makes room as it goes has nothing to check
        """Checks that no simulation ran out of room since the last check.

        Raises:
            TaskError: one did; the text names the figure to raise.
        """


class CpuPhysics(Physics):
    """The CPU back end, on `mujoco.batch.Batch`: the same bits at any number of threads."""

    def __init__(self, model: mujoco.MjModel, num_envs: int, threads: int, fields: tuple[str, ...]) -> None:
        """Makes the simulations.

        Args:
            model: the compiled model.
            num_envs: number of simulations.
            threads: native threads that step them; does not change any result.
            fields: derived `MjData` fields that `read` will be asked for; a step is followed by what they need (see
                `porse.sim.stages`).
        """
        if mujoco.get_mju_user_warning() is None:
            # By default MuJoCo prints each bad state and appends it to a file in the working directory.
            mujoco.set_mju_user_warning(_QUIET)
        self.model = model
        self.num_envs = num_envs
        self._batch = Batch(model, num_envs, threads)
        after = second_pass(model, fields)
        self._stage = _VELOCITIES if after.is_whole else _NONE
        self._fields = {name: self._batch.bind(name) for name in after.stepped}
        self._bones = Batch(skeleton.skeleton_of(model), num_envs, threads) if after.posed else None
        self._poses: list[tuple[Floats, Floats]] = []
        if self._bones is not None:
            self._fields |= {name: self._bones.bind(name) for name in after.posed}
            self._poses = [(self._bones.bind(name), self._batch.bind(name)) for name in skeleton.STATE]
        self._springs = after.springs
        if self._springs is not None:
            self._fields[PASSIVE] = np.zeros((num_envs, model.nv))
        self._initial = self._batch.state[0].copy()
        self.qpos = torch.from_numpy(self._batch.bind("qpos"))
        self.qvel = torch.from_numpy(self._batch.bind("qvel"))
        self.ctrl = torch.from_numpy(self._batch.bind("ctrl"))
        self.force = torch.from_numpy(self._batch.bind("xfrc_applied"))
        self.mocap_pos = torch.from_numpy(self._batch.bind("mocap_pos"))
        self.mocap_quat = torch.from_numpy(self._batch.bind("mocap_quat"))

    def advance(self, substeps: int) -> Tensor:
        """See `Physics.advance`."""
        raised: list[int] = []
        if self.kept is None and self.fastest is None:
            raised += self._step(substeps, self._stage)
        elif self.kept is None and self.fastest is not None and self._stage == _NONE:
            raised += self._step_bounded(substeps, self.fastest)
        else:
            for left in reversed(range(substeps)):
                if self.kept is not None:
                    self.qvel *= self.kept
                if self.fastest is not None:
                    torch.clamp(self.qvel, -self.fastest, self.fastest, out=self.qvel)
                raised += self._step(1, _NONE if left else self._stage)
        return torch.from_numpy(self._bad(raised + self._derive()))

    def _step_bounded(self, substeps: int, fastest: Tensor) -> list[int]:
        """Steps where each step begins at the highest speeds at most, and returns the simulations that raised an error.

        Few simulations become faster than that. All take all steps in one call, which leaves one simulation's data in the
        caches from step to step, and those that became faster take them again, one by one.
        """
        torch.clamp(self.qvel, -fastest, fastest, out=self.qvel)
        start = self._batch.state.copy()
        speeds = np.empty((self.num_envs, substeps, self.model.nv))
        failed: list[int] = []
        try:
            self._batch.rollout(substeps, record=["qvel"], out={"qvel": speeds})
        except SimulationError as error:
            failed += error.ids
        slow = (np.abs(speeds[:, :-1]) <= fastest.numpy()).all(axis=(1, 2))
        # A simulation with a warning has stopped, with speeds that are not its own.
        slow &= ~self._batch.warning[:, :, 1].any(axis=1)
        slow[failed] = False
        again = np.flatnonzero(~slow)
        raised: list[int] = []
        if len(again):
            self._batch.state[again], self._batch.warning[again] = start[again], 0
            for _ in range(substeps):
                self.qvel[again] = torch.clamp(self.qvel[again], -fastest, fastest)
                raised += self._step(1, _NONE, again)
        return raised

    def _step(self, substeps: int, stage: int, rows: NDArray[np.int64] | None = None) -> list[int]:
        """Steps some simulations or all, and returns those that raised an error."""
        try:
            self._batch.step(rows, nstep=substeps, stage=stage)
        except SimulationError as error:
            return list(error.ids)
        return []

    def _derive(self, rows: NDArray[np.int64] | None = None) -> list[int]:
        """Computes what stepping has not, for some simulations or all, and returns those that raised an error."""
        some = slice(None) if rows is None else rows
        if self._springs is not None:
            forces = self._springs.forces(self.qpos.numpy()[some], self.qvel.numpy()[some])
            self._fields[PASSIVE][some] = forces
        if self._bones is None:
            return []
        for theirs, ours in self._poses:
            theirs[some] = ours[some]
        try:
            self._bones.forward(rows, stage=_VELOCITIES)
        except SimulationError as error:
            return list(error.ids)
        return []

    def _bad(self, raised: list[int]) -> NDArray[np.bool_]:
        """Returns which simulations are in no state to go on."""
        slowest, fastest = torch.aminmax(self.qvel)
        # Comparisons with NaN are false.
        fine = float(slowest) >= -SPEED_LIMIT and float(fastest) <= SPEED_LIMIT
        bad = np.zeros(self.num_envs, np.bool_) if fine else ~(np.abs(self.qvel.numpy()).max(axis=1) <= SPEED_LIMIT)
        # MuJoCo resets a simulation whose state is bad and goes on, so its warning counters are the evidence.
        warning = self._batch.warning
        if warning.any():
            bad |= warning[:, _BAD, 1].any(axis=1)
            warning[:] = 0
        if raised:
            bad[raised] = True
        return bad

    def restart(self, ids: Tensor) -> None:
        """See `Physics.restart`."""
        self._batch.state[ids.numpy()] = self._initial

    def refresh(self, ids: Tensor) -> None:
        """See `Physics.refresh`."""
        if self._stage == _VELOCITIES:
            self._batch.forward(ids.numpy(), stage=_VELOCITIES)
        self._derive(ids.numpy())

    def read(self, field: str, ids: Tensor | None = None) -> Tensor:
        """See `Physics.read`."""
        values = self._fields[field] if ids is None else self._fields[field][ids.numpy()]
        return torch.from_numpy(values.astype(np.float32))

    def state(self) -> Tensor:
        """See `Physics.state`."""
        return torch.from_numpy(self._batch.state.copy())

    def load_state(self, state: Tensor) -> None:
        """See `Physics.load_state`."""
        self._batch.state[:] = state.numpy()
