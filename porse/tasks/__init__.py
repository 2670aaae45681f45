"""The tasks, by name. `porse/task_names.py` lists them; one of your own is named "module:Class".

A task's module is imported when it is asked for: a run depends on the code of its own task and of no other.
"""

import importlib
from collections.abc import Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING

from porse.errors import TaskError
from porse.task_names import TASK_CLASSES, is_own, near_tasks

if TYPE_CHECKING:
    from porse.sim.devices import Device
    from porse.tasks.base import Task

__all__ = ["TASKS", "find_task", "make_task"]


class _Tasks(Mapping[str, type["Task"]]):
    """The classes of the package's tasks by name, each imported when it is looked up."""

    def __getitem__(self, name: str) -> type["Task"]:
        module, _, class_name = TASK_CLASSES[name].partition(":")
        return getattr(importlib.import_module(module), class_name)

    def __iter__(self) -> Iterator[str]:
        return iter(TASK_CLASSES)

    def __len__(self) -> int:
        return len(TASK_CLASSES)

    def __contains__(self, name: object) -> bool:
        return name in TASK_CLASSES


TASKS: Mapping[str, type["Task"]] = _Tasks()


def find_task(name: str) -> type["Task"]:
    """Returns the class of the task with that name: a name in `TASKS`, or "module:Class" for a task of your own.

    Raises:
        TaskError: no task has that name, or a task of your own cannot take a first step.
    """
    if is_own(name):
        from porse.tasks.own import find_own_task

        return find_own_task(name)
    if name not in TASKS:
        raise TaskError(f"expected the name of a task, found {name!r}; {near_tasks(name)} (`porse tasks`)")
    return TASKS[name]


def make_task(name: str, num_envs: int, seed: int, threads: int = 1, device: "Device | None" = None) -> "Task":
    """Returns a new task with its first episodes started.

    Args:
        name: a name in `TASKS`, or "module:Class".
        num_envs: number of environments.
        seed: seed of the task's own generator.
        threads: native threads of the physics; changes no result.
        device: of the physics; the CPU where there is none. On a GPU, call it and the task within `porse.sim.placement.placed`.

    Raises:
        TaskError: no task has that name, a task of your own is not what its class says, or the device is not there.
    """
    if device is None or device.name == "cpu":
        # A task of one's own may know nothing of devices.
        make = partial(find_task(name), num_envs, seed, threads)
    else:
        from porse.sim.placement import unplaced

        with unplaced():
            found = find_task(name)
        make = partial(found, num_envs, seed, threads, device)
    if is_own(name):
        from porse.tasks.own import start_own_task

        return start_own_task(name, make)
    return make()
