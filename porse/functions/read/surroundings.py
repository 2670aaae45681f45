"""What stands beside the functions of a reply: imports, constants, and statements that no reward has a use for.

None of it is ever executed. Constants and unusual imports that the function needs come along; what only an attack would
write is refused, so that it is seen.
"""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass

from porse.functions.contract import MODULES
from porse.functions.read.scan import Chunk, bracketed, parse_source, regions
from porse.functions.read.source import DEFAULT_MODULES, constant_of, is_constant
from porse.functions.verdict import CodeError, words

Import = ast.Import | ast.ImportFrom

_DECORATORS = re.compile(
    r"@\s*((torch\.)?jit\.(script|script_if_tracing|export)|script|staticmethod|classmethod|"
    r"torch\.(no_grad|inference_mode)(\(\s*\))?)\s*(#.*)?"
)
_HOSTILE = words("""
    __import__ breakpoint builtins classes compile connect cpp_extension ctypes delattr eval exec from_file getattr
    globals hub importlib input load load_library locals open ops os pickle popen remove rmtree save setattr shutil
    socket subprocess sys system unlink urllib urlopen vars
    """)

_MAX_CHARACTERS = 4000
"""Longest statement that is looked at."""


@dataclass(frozen=True)
class Surroundings:
    """The statements beside the functions, those of one line and those that end where their brackets do.

    Attributes:
        imports: line number, text and tree of each import.
        constants: line numbers and texts of each constant, by name; the last one of a name.
        read: the names that each constant reads.
        others: line number, stretch of the reply and tree of every statement.
    """

    imports: list[tuple[int, str, Import]]
    constants: dict[str, list[tuple[int, str]]]
    read: dict[str, set[str]]
    others: list[tuple[int, int, ast.stmt]]

    def imports_of(self, names: set[str]) -> list[tuple[int, str, Import]]:
        """Returns the imports that bind one of `names` otherwise than is usual."""
        return [found for found in self.imports if _unusual(found[2]) & names]


def surroundings(lines: list[str], inside: set[int]) -> Surroundings:
    """Returns what stands beside the functions, whose line numbers are `inside`."""
    found = Surroundings([], {}, {}, [])
    where = regions(lines)
    end = 0
    for number, line in enumerate(lines, start=1):
        text = line.strip()
        if number <= end or number in inside or not text or text.startswith(("#", "@")):
            continue
        block = bracketed(lines, number - 1)
        if inside.isdisjoint(range(number, number + len(block))) and (node := _statement("\n".join(block))):
            end = number + len(block) - 1
        else:
            block, node = [text], _statement(text)
        if node is None:
            continue
        found.others.append((number, where[number - 1], node))
        if isinstance(node, ast.Import | ast.ImportFrom):
            found.imports.append((number, text, node))
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            name, value = constant_of(node)
            if name and value is not None and is_constant(value, found.constants):
                found.constants[name] = list(enumerate(block, start=number))
                found.read[name] = set(names_read(value))
    return found


def refuse_decorators(chunk: Chunk) -> None:
    """Refuses decorators other than the usual ones, which are left out.

    Raises:
        CodeError: there is one; check "static", with the line of the reply.
    """
    for number, text in chunk.decorators:
        if not _DECORATORS.fullmatch(text.strip()):
            raise CodeError("static", f"the decorator {text.strip()} is not allowed; the function needs none", number)


def refuse_hostile(region: int, around: Surroundings) -> None:
    """Refuses imports and statements in the function's own block that only an attack would write.

    Raises:
        CodeError: there is one; check "static", with the line of the reply.
    """
    for number, where, node in around.others:
        if where != region:
            continue
        if isinstance(node, ast.Import | ast.ImportFrom):
            for module in _modules(node):
                if module.split(".")[0] not in MODULES:
                    message = f"the import of {module} is not allowed; only torch, math and typing are offered"
                    raise CodeError("static", message, number)
        hostile = sorted(n for n in names_read(node) if n in _HOSTILE or n.startswith("__"))
        if hostile:
            raise CodeError("static", f"the name {hostile[0]} is not allowed anywhere in the code", number)


def names_read(tree: ast.AST) -> Iterator[str]:
    """Yields every name and attribute that a tree reads."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield node.attr


def _statement(text: str) -> ast.stmt | None:
    try:
        body = parse_source(text).body if len(text) <= _MAX_CHARACTERS else []
    except CodeError:
        return None
    return body[0] if len(body) == 1 else None


def _modules(node: Import) -> list[str]:
    return [alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or "."]


def _unusual(node: Import) -> set[str]:
    """Returns the names that an import binds to something of torch, math or numpy, but for the usual ones."""
    prefix = f"{node.module}." if isinstance(node, ast.ImportFrom) else ""
    pairs = [(alias.asname or alias.name, prefix + alias.name) for alias in node.names]
    return {
        name
        for name, path in pairs
        if path.split(".")[0] in ("torch", "math", "numpy")
        and DEFAULT_MODULES.get(name) != path
        and path != "torch.Tensor"
        and "." not in name
    }
