"""The machine that the bench ran on, and the environment of the processes that it starts."""

import os
from importlib import metadata
from typing import Any

from porse import numerics
from porse.training.limits import cpus

_PEERS = ("gymnasium", "envpool")

BUSY = 0.3
"""From this load average on there is other work, and time on the clock is not to be trusted."""


def machine() -> dict[str, Any]:
    """Returns the CPU, its cores, the load average of the last minute, and versions; an empty text where a package is not there.

    The switches of the numeric profile are not among them: suites that it matters to have both.
    """
    found = {name: value for name, value in numerics.manifest().items() if not name.isupper()}
    peers = {f"package {name}": _version(name) for name in _PEERS}
    return {**found, "cores": cpus(), "load average": round(os.getloadavg()[0], 2), **peers}


def plain_environment() -> dict[str, str]:
    """Returns this process's environment without the switches of any numeric profile, for one that chooses its own."""
    return {name: value for name, value in os.environ.items() if name not in numerics.ENVIRONMENT["portable"]}


def described(found: dict[str, Any]) -> list[str]:
    """Returns what `machine` found as lines for people, with a warning where the machine is busy."""
    versions = [f"{name.removeprefix('package ')} {found[name]}" for name in found if name.startswith("package ")]
    load = found["load average"]
    lines = [
        f"machine  {found['cpu']}, {found['cores']} cores, load average {load}",
        f"versions Python {found['python']}, {', '.join(version for version in versions if version.split()[1:])}",
    ]
    if load >= BUSY:
        lines.append(
            f"warning  a load average of {load} says that this machine has other work: ratios of processor time change little, but "
            "figures on the clock are not to be trusted"
        )
    return lines


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ""
