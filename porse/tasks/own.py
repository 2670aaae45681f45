"""Tasks of one's own: a class outside the package, named "module:Class" as in `my_tasks.cart:CartPole`.

The module is found from the project's root, the folder that commands and stages run in. It is its user's own code and is
imported as such; generated functions never come this way. What it raises is a TaskError with the place in it.
"""

import difflib
import functools
import importlib
import importlib.util
import inspect
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
from torch import Tensor

from porse.errors import PorseError, TaskError, lacks_memory
from porse.tasks.base import Task
from porse.variables import Variable

_NEEDED = (
    "NAME", "DESCRIPTION", "NUM_OBSERVATIONS", "NUM_ACTIONS", "EPISODE_LENGTH", "TIME_LIMIT", "CONTROL_DT", "SUBSTEPS",
    "VARIABLES",
)  # fmt: skip
"""Class attributes that have no default."""

_TRIED = 3
"""Environments that a class is tried on: a mask can then name some that are neither all, nor the first, nor one alone."""


def find_own_task(name: str) -> type[Task]:
    """Returns the class that "module:Class" names, after a first reset and step of it.

    Raises:
        TaskError: there is no such module or class, it is not a complete task, or its code raises an error.
    """
    module_name, _, class_name = name.partition(":")
    if not all(part.isidentifier() for part in [*module_name.split("."), class_name]):
        raise TaskError(
            f'expected a task of your own to be named "module:Class", as in my_tasks.cart:CartPole, found {name!r}; '
            "write the module with dots and without .py"
        )
    root = str(Path.cwd())
    if root not in sys.path:
        # Last, so that a file of the project's root never takes the place of an installed package.
        sys.path.append(root)
    with _answered_for(name, "be imported"):
        exists = _exists(module_name)
    if not exists:
        raise TaskError(
            f"expected the module {module_name} of the task {name!r} below {root}, found none; run from the project's "
            f"root, with the class in {module_name.replace('.', '/')}.py there"
        )
    with _answered_for(name, "be imported"):
        module = importlib.import_module(module_name)
    found = getattr(module, class_name, None)
    if found is None:
        classes = [key for key, value in vars(module).items() if inspect.isclass(value)]
        near = difflib.get_close_matches(class_name, classes, n=3) or sorted(classes)
        raise TaskError(
            f"expected the class {class_name} in {module.__file__}, found none; it has {', '.join(near) or 'no class'}"
        )
    if not (inspect.isclass(found) and issubclass(found, Task)):
        raise TaskError(
            f"expected {name} to be a class on porse.tasks.base.Task, found {found!r}; derive it from that class"
        )
    missing = [*sorted(found.__abstractmethods__), *(key for key in _NEEDED if not hasattr(found, key))]
    if missing:
        raise TaskError(f"expected {name} to say all that a task is, found no {', '.join(missing)}; add them")
    _try_out(name, found)
    return found


def start_own_task(name: str, make: Callable[[], Task]) -> Task:
    """Returns what `make` makes, a new task of the class that `name` names, checked.

    Raises:
        TaskError: it is not what its class says, or its code raises an error.
    """
    with _answered_for(name, "start its episodes"):
        task = make()
        check_task(task)
    return task


@functools.cache
def _try_out(name: str, found: type[Task]) -> None:
    """Takes one step and one reset with a class, once in a process: what is wrong there is wrong for every caller.

    Raises:
        TaskError: the class is not what it says, or its code raises an error.
    """
    with _answered_for(name, "give a scene that MuJoCo compiles"):
        controls = found.scene().compile().nu
    task = start_own_task(name, lambda: found(_TRIED, 0, 1))
    says = (
        f"take a step with actions {(_TRIED, found.NUM_ACTIONS)}, by its NUM_ACTIONS, in a scene with nu = {controls}"
    )
    with _answered_for(name, says):
        task.step(torch.zeros(_TRIED, found.NUM_ACTIONS))
        check_task(task)
    with _answered_for(name, "start an episode anew"):
        task.reset(torch.arange(_TRIED) > 0)
        check_task(task)


@contextmanager
def _answered_for(name: str, expected: str) -> Iterator[None]:
    """Says of an error in a user's code what was expected, what was raised, and where; a lack of memory is no fault of it.

    Args:
        name: "module:Class".
        expected: what the code should do, as a verb with all that belongs to it.

    Raises:
        TaskError: the code within the context raises an error.
    """
    try:
        yield
    except PorseError:
        raise
    except Exception as error:
        if lacks_memory(error):
            raise
        # The text of a SyntaxError has the place in it.
        said = " ".join(str(error.msg if isinstance(error, SyntaxError) else error).split())
        raise TaskError(
            f"expected {name} to {expected}, found {type(error).__name__}: {said}{_place(error, name)}; mend it"
        ) from error


def _place(error: Exception, name: str) -> str:
    """Returns ", at FILE:LINE" of the user's own code that raised an error; empty where it raised none."""
    if isinstance(error, SyntaxError) and error.filename:
        return f", at {_shown(error.filename)}:{error.lineno}"
    package = name.partition(":")[0].partition(".")[0]
    places = [
        f", at {_shown(frame.f_code.co_filename)}:{line}"
        for frame, line in traceback.walk_tb(error.__traceback__)
        if frame.f_globals.get("__name__", "").partition(".")[0] == package
    ]
    return places[-1] if places else ""


def _shown(file: str) -> str:
    """Returns the path of a file from the project's root, or as it is if it lies elsewhere."""
    path, root = Path(file), Path.cwd()
    return str(path.relative_to(root) if path.is_relative_to(root) else path)


def _exists(module_name: str) -> bool:
    """Returns whether a module can be found, without importing it; its packages are imported."""
    try:
        return importlib.util.find_spec(module_name) is not None
    except ModuleNotFoundError as error:
        # Only a missing package of the module's own is an answer; a broken import inside one is an error of its own.
        if error.name is None or not f"{module_name}.".startswith(f"{error.name}."):
            raise
        return False


def check_task(task: Task) -> None:
    """Checks that a new task holds what its class says.

    Raises:
        TaskError: a size, a type or a variable differs; the text names every difference.
    """
    wrong = list(_differences(task))
    if wrong:
        raise TaskError(f"expected {task.NAME} to be as its class says, found: {'; '.join(wrong)}; mend the class")


def _differences(task: Task) -> Iterator[str]:
    """Yields what differs, as sentences without a full stop."""
    envs = task.num_envs
    for variable in task.VARIABLES:
        if not hasattr(task, variable.name):
            yield f"no attribute {variable.name} after a reset, which _measure has to set"
        else:
            yield from _variable_differences(variable, getattr(task, variable.name), envs)
    tensors = (
        ("compute_observations", task.compute_observations(), (envs, task.NUM_OBSERVATIONS), torch.float32),
        ("sparse_reward", task.sparse_reward(), (envs,), torch.float32),
        ("human_reward", task.human_reward(), (envs,), torch.float32),
        ("failed", task.failed(), (envs,), torch.bool),
    )
    for name, value, shape, kind in tensors:
        if not isinstance(value, Tensor):
            yield f"{name} returns {value!r} in place of {shape} of {kind}"
        elif tuple(value.shape) != shape or value.dtype != kind:
            yield f"{name} returns {tuple(value.shape)} of {value.dtype} in place of {shape} of {kind}"
    fitness = task.fitness()
    if not isinstance(fitness, float):
        yield f"fitness returns {fitness!r}, which is not a float"


def _variable_differences(variable: Variable, value: object, envs: int) -> Iterator[str]:
    if variable.kind != "tensor":
        if type(value).__name__ != variable.kind:
            yield f"{variable.name} is {value!r}, which is no {variable.kind}"
        return
    shape = (envs, *variable.shape)
    if not isinstance(value, Tensor) or tuple(value.shape) != shape:
        found = tuple(value.shape) if isinstance(value, Tensor) else value
        yield f"{variable.name} has the shape {found} in place of {shape}"
    elif value.dtype not in (torch.float32, torch.int64):
        yield f"{variable.name} is {value.dtype}, neither torch.float32 nor torch.int64"
