"""What a training runs on, and its process made ready for it."""

import os

from porse.config import Params
from porse.processes import unlimit_memory
from porse.sim.devices import Device


def made_ready(params: Params) -> Device:
    """Returns the device of the parameters; where it is a GPU, this process is ready for it."""
    device = Device(params.device, params.deterministic)
    if device.is_gpu:
        # With these buffers products have the same bits in every run; cuBLAS reads this when it is first used.
        os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
        # The driver claims memory of this process as it likes, and what a training fills is on the GPU.
        unlimit_memory()
    return device
