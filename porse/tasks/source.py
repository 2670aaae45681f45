"""A task's observation code as prompts show it."""

import inspect
import textwrap
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from porse.tasks.base import Task


def observation_source(task: "type[Task]") -> str:
    """Returns the helpers, then the class with its variables as comments and its real `compute_observations`."""
    lines = [
        f"class {task.NAME}:",
        f"    # {task.NUM_ACTIONS} actions in [-1, 1], control step {task.CONTROL_DT:g} s.",
        "    # First dimension num_envs, float32, quaternions (x, y, z, w), unless said.",
    ]
    for v in task.VARIABLES:
        shape = ", ".join(("num_envs", *map(str, v.shape)))
        kind = f"({shape}{',' if not v.shape else ''})" if v.kind == "tensor" else v.kind
        if v.kind == "tuple":
            kind = f"tuple of {v.shape[0]} ints"
        frame = "" if v.frame == "-" else f", {v.frame} frame"
        lines.append(f"    # self.{v.name}: {kind}, {v.unit}{frame}: {v.meaning}")
    source = textwrap.dedent(inspect.getsource(task.compute_observations))
    helpers = [inspect.getsource(helper) for helper in task.OBSERVATION_HELPERS]
    return "\n\n".join([*helpers, "\n".join(lines) + "\n\n" + textwrap.indent(source, "    ")])
