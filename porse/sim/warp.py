"""The GPU back end: MuJoCo Warp, in single precision, its arrays shared with torch.

One physics step, and the derived fields after the last one, are recorded as CUDA graphs on a GPU; between them and around
them torch works on the same memory and the same stream, so nothing is copied and the processor waits for nothing. On Warp's
CPU device everything is the same without graphs: tests compare it with MuJoCo itself there, on a machine without a GPU.
"""

import copy
from collections.abc import Callable, Iterator
from typing import Any

import mujoco
import mujoco_warp as mjw
import torch
import warp as wp
from torch import Tensor

from porse.errors import TaskError
from porse.sim.physics import SPEED_LIMIT, Capacity, Physics

_MOST_DENSE = 60
"""Degrees of freedom up to which MuJoCo Warp has dense matrices."""

_STATE = ("time", "qpos", "qvel", "act", "qacc_warmstart", "ctrl", "xfrc_applied", "mocap_pos", "mocap_quat")
"""What one step hands to the next."""

_OF_A_STEP = ("qfrc_actuator", "qfrc_passive", "qfrc_constraint", "sensordata")
"""Derived fields that a step leaves, and that states do not give back."""

_LACKS = {
    "contacts": mjw.OverflowType.BROADPHASE | mjw.OverflowType.NARROWPHASE | mjw.OverflowType.CCD,
    "rows": mjw.OverflowType.NEFC | mjw.OverflowType.NJMAX_NNZ,
}
"""Which figure of a capacity each overflow is of."""


class WarpPhysics(Physics):
    """Simulations on a GPU, or on Warp's CPU device. See `Physics`.

    Args:
        model: the compiled model.
        num_envs: number of simulations.
        fields: derived `MjData` fields that `read` will be asked for.
        device: of the tensors.
        deterministic: whether a GPU gives the same bits in every run.
        capacity: room for contacts and rows of the solver.
    """

    asynchronous = True
    real = torch.float32

    def __init__(
        self,
        model: mujoco.MjModel,
        num_envs: int,
        fields: tuple[str, ...],
        device: torch.device,
        deterministic: bool,
        capacity: Capacity,
    ) -> None:
        wp.config.log_level = wp.LOG_WARNING
        if device.type == "cpu":
            # There it is for tests, and kernels that nobody optimises are compiled many times as fast.
            wp.config.optimization_level, wp.config.cpu_compiler_flags = 0, ""
        wp.init()
        self.model, self.num_envs, self.device = model, num_envs, device
        self._capacity, self._warp = capacity, wp.device_from_torch(device)
        ours = copy.copy(model)
        if ours.nv > _MOST_DENSE:
            ours.opt.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
        # Two boxes meet as they do in MuJoCo itself then: in all their points, where the other way has one now and then.
        ours.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_NATIVECCD
        with wp.ScopedDevice(self._warp):
            self._model = mjw.put_model(ours)
            self._model.opt.warn_overflow = 0  # `check` says it
            # Warp's CPU device does one thing after the other, always in the same order.
            wanted = deterministic and device.type != "cpu"
            self._model.opt.deterministic = mjw.DeterminismType.ALL if wanted else mjw.DeterminismType.NONE
            self._data = mjw.make_data(ours, nworld=num_envs, nconmax=capacity.contacts, njmax=capacity.rows)
        self._state = {name: view for name in _STATE if (view := self._view(name)).numel()}
        self._initial = {name: view[0].clone() for name, view in self._state.items()}
        self._start = {name: view.clone() for name, view in self._state.items()}
        self._fields = {name: self._view(name) for name in fields}
        self._overflow = self._view("overflow")
        self._graphs: dict[Callable[..., None], Any] = {}
        self.qpos, self.qvel, self.ctrl = self._view("qpos"), self._view("qvel"), self._view("ctrl")
        self.force = self._view("xfrc_applied")
        self.mocap_pos, self.mocap_quat = self._view("mocap_pos"), self._view("mocap_quat")

    def _view(self, name: str) -> Tensor:
        """Returns an array of the simulations as a tensor, on the same memory."""
        return wp.to_torch(getattr(self._data, name), requires_grad=False)

    def advance(self, substeps: int) -> Tensor:
        """See `Physics.advance`."""
        for _ in range(substeps):
            if self.kept is not None:
                self.qvel.mul_(self.kept)
            if self.fastest is not None:
                self.qvel.clamp_(-self.fastest, self.fastest)
            self._run(mjw.step)
        fine = (self.qvel.abs().amax(dim=1) <= SPEED_LIMIT) & self.qpos.isfinite().all(dim=1)
        for name, view in self._state.items():
            view.copy_(torch.where(_rows(fine, view), view, self._start[name]))
        if self._fields:
            for name in _OF_A_STEP:
                if name in self._fields:
                    self._fields[name].masked_fill_(_rows(~fine, self._fields[name]), 0.0)
            self._run(_derive)
        return ~fine

    def _run(self, launch: Callable[..., None]) -> None:
        """Launches kernels on the device, in torch's order of things."""
        if self.device.type == "cpu":
            with wp.ScopedDevice(self._warp):
                launch(self._model, self._data)
            return
        if launch not in self._graphs:
            self._graphs[launch] = self._recorded(launch)
        stream = wp.stream_from_torch(torch.cuda.current_stream(self.device))
        wp.capture_launch(self._graphs[launch], stream=stream)

    def _recorded(self, launch: Callable[..., None]) -> Any:
        """Returns kernels as one CUDA graph, and leaves the simulations as they are."""
        torch.cuda.synchronize(self.device)
        state = self.state()
        with wp.ScopedDevice(self._warp):
            # Kernels are compiled and loaded in a first launch, which a recording cannot do.
            launch(self._model, self._data)
            wp.synchronize_device(self._warp)
            with wp.ScopedCapture(device=self._warp) as recording:
                launch(self._model, self._data)
        self.load_state(state)
        torch.cuda.synchronize(self.device)
        return recording.graph

    def restart(self, ids: Tensor) -> None:
        """See `Physics.restart`."""
        for name, view in self._state.items():
            if len(ids) == self.num_envs:
                view.copy_(self._initial[name].expand_as(view))
            else:
                view[ids] = self._initial[name]

    def refresh(self, ids: Tensor) -> None:
        """See `Physics.refresh`; those of the others are computed with them, and stay what they were."""
        del ids
        self._run(_derive)

    def read(self, field: str, ids: Tensor | None = None) -> Tensor:
        """See `Physics.read`."""
        values = self._fields[field]
        return values.clone() if ids is None else values[ids]

    def state(self) -> Tensor:
        """See `Physics.state`."""
        return torch.cat([view.reshape(self.num_envs, -1) for view in self._state.values()], dim=1)

    def load_state(self, state: Tensor) -> None:
        """See `Physics.load_state`."""
        widths = [view[0].numel() for view in self._state.values()]
        for view, part in zip(self._state.values(), state.split(widths, dim=1), strict=True):
            view.copy_(part.reshape(view.shape))

    def keep_start(self) -> None:
        """See `Physics.keep_start`."""
        for name, view in self._state.items():
            self._start[name].copy_(view)

    def check(self) -> None:
        """See `Physics.check`; waits for the device."""
        lacking = list(self._lacking())
        self._overflow.zero_()
        if lacking:
            raise TaskError(
                f"expected room for all contacts of {self.num_envs} simulations in the task's CAPACITY, found too little: "
                f"raise {' and '.join(lacking)} in the task's class"
            )

    def _lacking(self) -> Iterator[str]:
        seen = self._overflow.tolist()
        for figure, bits in _LACKS.items():
            if any(int(bits) & found for found in seen):
                yield f"{figure} above {getattr(self._capacity, figure)}"


def _derive(model: Any, data: Any) -> None:
    """Computes the fields that follow from positions and velocities."""
    mjw.fwd_kinematics(model, data)
    mjw.fwd_velocity(model, data)


def _rows(mask: Tensor, like: Tensor) -> Tensor:
    """Returns a mask of simulations that broadcasts to a tensor with one row for each."""
    return mask.view(-1, *[1] * (like.dim() - 1))
