"""What the class of a task of one's own says of itself, read from its text.

Parameters are read before anything else: importing the module here would load torch before the numeric profile is set,
and run its code for every command that only reads `params.yaml`.
"""

import ast
from pathlib import Path

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
        tree = ast.parse(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ParamsError(
            f"expected the module of task {task!r} at {path}, found no such file; mend its name or add it"
        ) from None
    except (SyntaxError, UnicodeDecodeError, ValueError) as error:
        raise ParamsError(f"expected Python in {path}, found: {error}; mend the file") from None
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == name]
    stated = _stated(classes[-1].body) if classes else {}
    lacking = [key for key in _NAMES if stated.get(key, 0) < 1]
    if lacking:
        raise ParamsError(
            f"expected the class {name} in {path} to state {', '.join(lacking)} as a whole number, since the values that "
            f"are null in params.yaml follow from it, found none; write the number into the class, write the values into "
            f"{preset}, or into params.yaml"
        )
    return Sizes(*(stated[key] for key in _NAMES))


def _stated(body: list[ast.stmt]) -> dict[str, int]:
    """Returns the whole numbers that are assigned to names in a class."""
    found: dict[str, int] = {}
    for node in body:
        targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        value = node.value if isinstance(node, ast.Assign | ast.AnnAssign) else None
        if isinstance(value, ast.Constant) and type(value.value) is int:
            found |= {target.id: value.value for target in targets if isinstance(target, ast.Name)}
    return found
