"""The modules that a Python file imports, read from its text: directly or through others, at the top or in a function.

A module that is only named, in a text such as `"porse.warm.server"`, counts as imported: child processes are told in this way
what to run. Imports under `if TYPE_CHECKING:` do not count.
"""

import ast
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

from porse.documents import parse_python


def imported_files(start: Path, homes: Mapping[str, Path], lists: frozenset[Path]) -> set[Path]:
    """Returns `start` and the files that it imports, directly or not.

    Args:
        start: a Python file.
        homes: top-level packages that are followed, each with the folder that it lies in; what others import is theirs.
        lists: files that name modules without importing them.

    Raises:
        ParamsError: one of the files is no Python.
    """
    found = {start}
    todo = [start]
    while todo:
        path = todo.pop()
        names = set() if path in lists else _names_in(path.read_bytes(), str(path))
        imported = {file for name in names for file in _files(name, homes)}
        todo.extend(imported - found)
        found |= imported
    return found


def _files(name: str, homes: Mapping[str, Path]) -> Iterator[Path]:
    """Yields the files that importing a dotted name runs; what the name has beyond a module is not a file."""
    parts = name.split(".")
    if parts[0] not in homes:
        return
    for depth in range(1, len(parts) + 1):
        base = homes[parts[0]].joinpath(*parts[:depth])
        for path in (base.with_suffix(".py"), base / "__init__.py"):
            if path.is_file():
                yield path


@cache
def _names_in(content: bytes, where: str) -> frozenset[str]:
    names: set[str] = set()
    _collect(parse_python(content, where), names)
    return frozenset(names)


def _collect(node: ast.AST, names: set[str]) -> None:
    """Adds what is imported at a node or below it."""
    if isinstance(node, ast.Import):
        names.update(alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
        names.add(node.module)
        names.update(f"{node.module}.{alias.name}" for alias in node.names)
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        name = node.value.partition(":")[0]
        if "." in name and all(part.isidentifier() for part in name.split(".")):
            names.add(name)
    elif isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
        for statement in node.orelse:
            _collect(statement, names)
        return
    for child in ast.iter_child_nodes(node):
        _collect(child, names)
