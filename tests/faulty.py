"""A quadcopter that breaks the process it lives in, at the step and in the way that a plan says. For tests.

The plan is a JSON file that the environment names: seed of the task -> [way, step, marker]. Where there is a marker, a file's
name, the process breaks once: the file stands when it has.
"""

import ctypes
import json
import os
import signal
import sys
import time
from pathlib import Path

from porse.tasks.quadcopter import Quadcopter

PLAN_VARIABLE = "FAULTY_PLAN"


class Faulty(Quadcopter):
    """Reach and hover near a point, if nothing happens."""

    NAME = "Faulty"

    def __init__(self, num_envs, seed, threads):
        plan = json.loads(Path(os.environ[PLAN_VARIABLE]).read_text())
        self._way, self._at, self._marker = plan.get(str(seed), ["", 0, ""])
        self._steps = 0
        super().__init__(num_envs, seed, threads)

    def step(self, actions):
        super().step(actions)
        self._steps += 1
        if self._way and self._steps == self._at and not (self._marker and Path(self._marker).exists()):
            if self._marker:
                Path(self._marker).touch()
            WAYS[self._way]()

    def fitness(self):
        return float("nan") if self._way == "fitness" and self._steps >= self._at else super().fitness()


def _raises():
    raise KeyError("no such rotor in /some/where/rotors.py")


def _fills_the_memory():
    taken = []
    while True:
        taken.append(bytearray(2**24))


def _prints_and_ends():
    print("rotor 3 is gone", flush=True)
    os._exit(3)


def _signal(number):
    return lambda: os.kill(os.getpid(), number)


WAYS = {
    "kill": _signal(signal.SIGKILL),
    "fpe": _signal(signal.SIGFPE),
    "ill": _signal(signal.SIGILL),
    "segv": lambda: ctypes.string_at(0),
    "stop": _signal(signal.SIGSTOP),
    "sleep": lambda: time.sleep(10**6),
    "raise": _raises,
    "exit": lambda: sys.exit(7),
    "end": _prints_and_ends,
    "memory": _fills_the_memory,
    "pipes": lambda: os.closerange(3, 1024),
    "fitness": lambda: None,
}
