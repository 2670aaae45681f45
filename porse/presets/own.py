"""What the class of a task of one's own says of itself, read from its text.

Parameters are read before anything else: importing the module here would load torch before the numeric profile is set,
and run its code for every command that only reads `params.yaml`.
"""

import ast
from pathlib import Path

from porse.documents import parse_python
from porse.errors import ParamsError
from porse.presets.rules import Sizes
from porse.task_names import module_file

_NAMES = ("EPISODE_LENGTH", "NUM_OBSERVATIONS", "NUM_ACTIONS")


def sizes_of(task: str, root: Path, preset: Path) -> Sizes:
    """Returns the sizes that the class "module:Class" states as numbers.

    Args:
        task: the name.
        root: where the module is found from.
        preset: the file that would make them unnecessary; errors name it.

    Raises:
        ParamsError: there is no such module or class, or it does not state them as whole numbers of at least 1.
    """
    module, _, name = task.partition(":")
    path = module_file(root, module)
    try:
        tree = parse_python(path.read_bytes(), str(path))
    except FileNotFoundError:
        raise ParamsError(
            f"expected the module of task {task!r} at {path}, found no such file; correct its name or add it"
        ) from None
    classes = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
    stated = _stated(name, classes)
    lacking = [key for key in _NAMES if stated.get(key, 0) < 1]
    if lacking:
        raise ParamsError(
            f"expected the class {name} in {path} to state {', '.join(lacking)} as a whole number, since the values that "
            f"are null in params.yaml follow from it, found none; write the number into the class, write the values into "
            f"{preset}, or into params.yaml"
        )
    return Sizes(*(stated[key] for key in _NAMES))


def _stated(name: str, classes: dict[str, ast.ClassDef]) -> dict[str, int]:
    """Returns the whole numbers that are assigned to names in a class, or in a base of it that the module defines."""
    found: dict[str, int] = {}
    if name not in classes:
        return found
    own = classes[name]
    others = {other: node for other, node in classes.items() if other != name}
    for base in reversed(own.bases):
        found |= _stated(base.id, others) if isinstance(base, ast.Name) else {}
    for node in own.body:
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for target in targets:
                if isinstance(target, ast.Name):
                    # What is computed there is no longer what a base says.
                    found.pop(target.id, None)
                    if isinstance(node.value, ast.Constant) and type(node.value.value) is int:
                        found[target.id] = node.value.value
    return found
