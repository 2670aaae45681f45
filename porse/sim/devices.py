"""The devices that physics runs on, and the back end of each."""

import importlib.util
from dataclasses import dataclass

import mujoco
import torch

from porse.errors import TaskError
from porse.sim.physics import Capacity, CpuPhysics, Physics


@dataclass(frozen=True)
class Device:
    """What physics runs on.

    Attributes:
        name: `cpu` is MuJoCo itself, in double precision; `cuda:0` and so on are MuJoCo Warp on a GPU, in single precision;
            and `warp-cpu` is the same on the processor, for tests.
        deterministic: whether a GPU gives the same bits in every run; `cpu` always does.
    """

    name: str = "cpu"
    deterministic: bool = True

    @property
    def torch(self) -> torch.device:
        """The device of the tensors."""
        return torch.device("cpu" if self.name in ("cpu", "warp-cpu") else self.name)

    @property
    def is_gpu(self) -> bool:
        """Whether it is a GPU."""
        return self.torch.type != "cpu"


CPU = Device()


def make_physics(
    model: mujoco.MjModel, num_envs: int, threads: int, fields: tuple[str, ...], device: Device, capacity: Capacity
) -> Physics:
    """Returns the simulations on a device.

    Args:
        model: the compiled model.
        num_envs: number of simulations.
        threads: native threads of the CPU back end.
        fields: derived `MjData` fields that will be read.
        device: where.
        capacity: room for contacts, on a back end that has to know before.

    Raises:
        TaskError: the device's packages are not installed, or there is no such device.
    """
    if device.name == "cpu":
        return CpuPhysics(model, num_envs, threads, fields)
    missing = [name for name in ("warp", "mujoco_warp") if importlib.util.find_spec(name) is None]
    if missing:
        raise TaskError(
            f"expected MuJoCo Warp for device: {device.name}, found no package {missing[0]}; install it with "
            "`make gpu` (pip install 'porse[gpu]'), or set device: cpu"
        )
    if device.is_gpu and not torch.cuda.is_available():
        raise TaskError(
            f"expected a GPU for device: {device.name}, found none that PyTorch {torch.__version__} can use; install "
            "PyTorch for CUDA and the driver (docs/gpu.md), or set device: cpu"
        )
    from porse.sim.warp import WarpPhysics

    return WarpPhysics(model, num_envs, fields, device.torch, device.deterministic, capacity)
