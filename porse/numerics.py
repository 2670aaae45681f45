"""Floating point that can be trusted: one thread, one instruction set, and a record of what ran.

PyTorch and MKL choose their code paths when they are first loaded, so `apply` must be called before torch is imported.
Profile `portable` gives the same bits on x86-64 CPUs of all vendors: ATen is held at AVX2, and MKL at the one path
that it keeps on every CPU. Profile `fast` leaves the choice to the libraries: the same bits on one kind of CPU only.
Both use one thread, since the number of threads changes sums. Not covered by any switch: MKL's vector maths (square
root, pow(x, 0.5), arc cosine, arc sine), which the project's own code avoids.
"""

import os
import platform
import sys
from importlib import metadata
from typing import Literal

from porse.errors import ParamsError

Profile = Literal["portable", "fast"]

_ONE_THREAD = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_DYNAMIC": "FALSE"}
ENVIRONMENT: dict[Profile, dict[str, str]] = {
    "portable": {**_ONE_THREAD, "ATEN_CPU_CAPABILITY": "avx2", "MKL_CBWR": "COMPATIBLE"},
    "fast": _ONE_THREAD,
}
"""Environment variables of each profile."""

_PACKAGES = (
    "torch",
    "mujoco",
    "numpy",
    "rsl-rl-lib",
    "tensordict",
    "llvmlite",
    "pyarrow",
    "safetensors",
    "dvc",
    "diskcache",
)


def apply(profile: Profile) -> None:
    """Sets the environment variables of `profile` for this process and its children.

    Raises:
        ParamsError: torch is loaded already and the variables are not as the profile wants them.
    """
    wanted = ENVIRONMENT[profile]
    differ = [name for name, value in wanted.items() if os.environ.get(name) != value]
    if differ and "torch" in sys.modules:
        raise ParamsError(
            f"expected the numeric profile {profile} to be set before torch is loaded, found torch loaded and {', '.join(differ)}"
            " set otherwise; call porse.numerics.apply first, or start the process with these variables set"
        )
    os.environ.update(wanted)


def manifest() -> dict[str, str]:
    """Returns what a result may depend on besides the parameters: versions, CPU, switches. Never tracked."""
    found = {f"package {name}": metadata.version(name) for name in _PACKAGES}
    switches = {name: os.environ.get(name, "") for name in ENVIRONMENT["portable"]}
    machine = {"python": platform.python_version(), "machine": platform.machine(), "cpu": _cpu_model()}
    return {**machine, **found, **switches}


def _cpu_model() -> str:
    """Returns the CPU's own name where the system tells it."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    except OSError:
        names = []
    return names[0] if names else platform.processor()
