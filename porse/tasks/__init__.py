"""The tasks, by name. Adding one means adding its class to `TASKS`."""

import difflib

from porse.errors import TaskError
from porse.tasks.anymal import Anymal
from porse.tasks.base import Task
from porse.tasks.franka_cabinet import FrankaCabinet
from porse.tasks.humanoid import Humanoid
from porse.tasks.over import Over
from porse.tasks.quadcopter import Quadcopter

TASKS: dict[str, type[Task]] = {
    "Quadcopter": Quadcopter,
    "Anymal": Anymal,
    "FrankaCabinet": FrankaCabinet,
    "Humanoid": Humanoid,
    "Over": Over,
}


def find_task(name: str) -> type[Task]:
    """Returns the class of the task with that name.

    Raises:
        TaskError: no task has that name.
    """
    if name not in TASKS:
        near = difflib.get_close_matches(name, TASKS, n=3) or sorted(TASKS)
        raise TaskError(
            f"expected the name of a task, found {name!r}; the nearest names are {', '.join(near)}, and `porse tasks` lists all"
        )
    return TASKS[name]


def make_task(name: str, num_envs: int, seed: int, threads: int = 1) -> Task:
    """Returns a new task with its first episodes started.

    Args:
        name: a name in `TASKS`.
        num_envs: number of environments.
        seed: seed of the task's own generator.
        threads: native threads of the physics; changes no result.

    Raises:
        TaskError: no task has that name.
    """
    return find_task(name)(num_envs, seed, threads)
