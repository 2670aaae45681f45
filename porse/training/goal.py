"""The goal reward R_g: a generated function, or one that the task brings along."""

from collections.abc import Callable, Mapping
from typing import Any

from torch import Tensor

from porse.functions.run.execute import Function
from porse.tasks.base import Task

Goal = Callable[[Task, Mapping[str, Any]], tuple[Tensor, Mapping[str, Tensor]]]
"""Task and variables of a state -> reward (num_envs,) and its components by name. Raises CodeError."""


def generated(function: Function) -> Goal:
    """Returns the goal reward that a generated function computes from the variables."""

    def goal(task: Task, variables: Mapping[str, Any]) -> tuple[Tensor, Mapping[str, Tensor]]:
        del task
        total, *components = function(variables)
        return total, dict(zip(function.names, components, strict=True))

    return goal


def human(task: Task, variables: Mapping[str, Any]) -> tuple[Tensor, Mapping[str, Tensor]]:
    """Returns the reward that people wrote for the task, without components."""
    del variables
    return task.human_reward(), {}


def sparse(task: Task, variables: Mapping[str, Any]) -> tuple[Tensor, Mapping[str, Tensor]]:
    """Returns the task's fitness as a reward, without components."""
    del variables
    return task.sparse_reward(), {}
