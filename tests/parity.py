"""How far MuJoCo Warp is from MuJoCo itself, task by task: `python tests/parity.py [TASK ...]` prints the table of docs/gpu.md.

On Warp's CPU device, in single precision, beside the CPU back end in double precision: the same start states, the same
drawn actions. The first run compiles Warp's kernels, which takes minutes; they are kept in Warp's cache.
"""

import sys
from dataclasses import dataclass

import torch

from porse.sim.devices import Device
from porse.tasks import TASKS, make_task

ENVS = 2
AFTER = (1, 10)
"""Control steps after which states are compared."""


@dataclass(frozen=True)
class Apart:
    """Largest differences over all environments.

    Attributes:
        positions: of `qpos` (m, rad, and quaternions as they are).
        velocities: of `qvel` (m/s, rad/s).
        observations: of what the policy sees.
        fastest: largest speed of a degree of freedom then, for comparison.
    """

    positions: float
    velocities: float
    observations: float
    fastest: float


def apart(name: str) -> list[Apart]:
    """Returns the differences of a task after each number of steps in `AFTER`."""
    ours = make_task(name, ENVS, seed=0)
    theirs = make_task(name, ENVS, seed=0, device=Device("warp-cpu"))
    generator = torch.Generator().manual_seed(1)
    found = []
    for step in range(1, max(AFTER) + 1):
        actions = 2.0 * torch.rand(ENVS, ours.NUM_ACTIONS, generator=generator) - 1.0
        ours.step(actions)
        theirs.step(actions)
        theirs.check()
        if step in AFTER:
            pairs = (
                (ours._physics.qpos, theirs._physics.qpos),
                (ours._physics.qvel, theirs._physics.qvel),
                (ours.observations(), theirs.observations()),
            )
            differences = [float((a - b).abs().max()) for a, b in pairs]
            found.append(Apart(*differences, fastest=float(ours._physics.qvel.abs().max())))
    return found


def main() -> None:
    """Prints the table."""
    print("| task | after | positions | velocities | observations | fastest |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name in sys.argv[1:] or TASKS:
        for steps, a in zip(AFTER, apart(name), strict=True):
            figures = f"{a.positions:.1e} | {a.velocities:.1e} | {a.observations:.1e} | {a.fastest:.1f}"
            print(f"| {name} | {steps} | {figures} |", flush=True)


if __name__ == "__main__":
    main()
