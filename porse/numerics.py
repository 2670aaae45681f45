"""Floating point that can be trusted: one thread, one instruction set, and a record of what ran.

PyTorch, MKL and NumPy's OpenBLAS choose their code paths when they are first loaded, so `apply` must be called before torch
and NumPy are imported. PyArrow imports NumPy, and parameters are sometimes read after it: `prepare` sets what NumPy needs
before any profile is known.
Profile `portable` gives the same bits on x86-64 CPUs of all vendors: ATen and OpenBLAS are held at AVX2, and MKL at the one
path that it keeps on every CPU. Profile `fast` leaves the choice to the libraries: the same bits on one kind of CPU only.
Both use one thread, since the number of threads changes sums. Not covered by any switch: MKL's vector maths (square
root, pow(x, 0.5), arc cosine, arc sine), which the project's own code avoids.
"""

import os
import platform
import sys
from importlib import metadata
from pathlib import Path
from typing import Literal

from porse.errors import ParamsError

Profile = Literal["portable", "fast"]

_ONE_THREAD = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_DYNAMIC": "FALSE"}
_BEFORE_NUMPY = {"OPENBLAS_CORETYPE": "Haswell", "OPENBLAS_NUM_THREADS": "1"}
ENVIRONMENT: dict[Profile, dict[str, str]] = {
    "portable": {**_ONE_THREAD, **_BEFORE_NUMPY, "ATEN_CPU_CAPABILITY": "avx2", "MKL_CBWR": "COMPATIBLE"},
    "fast": _ONE_THREAD,
}
"""Environment variables of each profile."""

_NEEDED: dict[Profile, set[str]] = {"portable": {"avx2", "fma"}, "fast": set()}
"""Instructions that each profile makes libraries use, by the names that Linux has for them."""
_CPU_INFO = Path("/proc/cpuinfo")

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


def prepare() -> None:
    """Sets what NumPy must find when it is loaded, whatever the profile; nothing on a CPU without these kernels.

    For a program that reads its parameters after it imported NumPy. `apply` tells whether it was called in time.
    """
    if "numpy" not in sys.modules and _NEEDED["portable"] <= cpu_flags():
        os.environ.update(_BEFORE_NUMPY)


def applied() -> Profile:
    """Returns the profile of this process: `portable` if all its variables are set."""
    return (
        "portable" if all(os.environ.get(name) == value for name, value in ENVIRONMENT["portable"].items()) else "fast"
    )


def apply(profile: Profile) -> None:
    """Sets the environment variables of `profile` for this process and its children.

    Raises:
        ParamsError: torch or NumPy is loaded already and its variables are not as the profile wants them; or the profile
            needs instructions that this CPU does not have.
    """
    wanted = ENVIRONMENT[profile]
    lacking = sorted(_NEEDED[profile] - cpu_flags())
    if lacking:
        raise ParamsError(
            f"expected a CPU with {' and '.join(sorted(_NEEDED[profile]))} for numerics: {profile}, found one without {' and '.join(lacking)} ({cpu_model()});"
            " it would end with an illegal instruction: take another machine, or set numerics: fast, which ends with other bits"
        )
    differ = [name for name, value in wanted.items() if os.environ.get(name) != value]
    for library, late in (("torch", differ), ("numpy", [name for name in differ if name in _BEFORE_NUMPY])):
        if late and library in sys.modules:
            raise ParamsError(
                f"expected the numeric profile {profile} to be set before {library} is loaded, found {library} loaded and {', '.join(late)}"
                " set otherwise; call porse.numerics.apply first, or start the process with these variables set"
            )
    os.environ.update(wanted)


def manifest() -> dict[str, str]:
    """Returns what a result may depend on besides the parameters: versions, CPU, switches. Never tracked."""
    found = {f"package {name}": metadata.version(name) for name in _PACKAGES}
    switches = {name: os.environ.get(name, "") for name in ENVIRONMENT["portable"]}
    machine = {"python": platform.python_version(), "machine": platform.machine(), "cpu": cpu_model()}
    return {**machine, **found, **switches}


def cpu_flags() -> set[str]:
    """Returns the instructions of this CPU; all that may be needed where the system does not list them as x86 Linux does."""
    found = _cpu_lines("flags")
    return set(found[0].split()) if found else set.union(*_NEEDED.values())


def cpu_model() -> str:
    """Returns the CPU's own name where the system tells it."""
    names = _cpu_lines("model name")
    return names[0] if names else platform.processor()


def _cpu_lines(name: str) -> list[str]:
    """Returns what the system says under a name, once for each CPU; nothing where it does not say it."""
    try:
        lines = _CPU_INFO.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
    return [line.split(":", 1)[1].strip() for line in lines if line.split(":", 1)[0].strip() == name and ":" in line]
