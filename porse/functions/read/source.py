"""The code that a reply holds of one function, parsed. Nothing of it is run here."""

import ast
import warnings
from dataclasses import dataclass

from porse.functions.contract import MAX_TREE_DEPTH, MAX_TREE_NODES
from porse.functions.verdict import CodeError


@dataclass(frozen=True)
class Source:
    """The needed code of a reply: unusual imports, constants, helpers and at last the function itself.

    Attributes:
        text: all that, dedented; the text of a candidate.
        lines: for each line of `text`, the line of the reply, counted from 1.
        tree: the same, parsed; its nodes have the lines of the reply.
        constants: the names of the module's and the classes' constants.
        modules: dotted path for each name that stands for a module or for something imported from one.
        classes: the names that are read as classes.
    """

    text: str
    lines: tuple[int, ...]
    tree: ast.Module
    constants: frozenset[str]
    modules: dict[str, str]
    classes: frozenset[str]

    @property
    def functions(self) -> list[ast.FunctionDef]:
        """The functions, in their order."""
        return [node for node in self.tree.body if isinstance(node, ast.FunctionDef)]

    @property
    def main(self) -> ast.FunctionDef:
        """The function itself."""
        return self.functions[-1]

    @property
    def last_line(self) -> int:
        """The line of the last return of the main function."""
        lines = (node.lineno for node in ast.walk(self.main) if isinstance(node, ast.Return))
        return max(lines, default=self.main.lineno)


def parse_source(text: str) -> ast.Module:
    """Returns the syntax tree of a text, at most so large and so deep.

    Raises:
        CodeError: it is no Python, or too large; check "syntax" with the line of the text.
    """
    hidden = next((c for c in text if c != "\n" and not c.isprintable()), "")
    if hidden:
        line = text[: text.index(hidden)].count("\n") + 1
        raise CodeError("syntax", f"the code holds the invisible character U+{ord(hidden):04X}; write plain text", line)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(text)
    except SyntaxError as error:
        raise CodeError("syntax", f"{error.msg}: {(error.text or '').strip()[:200]}", error.lineno or 1) from None
    except (ValueError, RecursionError, MemoryError):
        raise CodeError("syntax", "it is too deeply nested, or holds a null character", 1) from None
    count = 0
    rest: list[tuple[ast.AST, int]] = [(tree, 0)]
    while rest:  # without recursion, which could go too deep itself
        node, depth = rest.pop()
        count += 1
        if count > MAX_TREE_NODES or depth > MAX_TREE_DEPTH:
            raise CodeError("syntax", "the code is too large or too deeply nested", getattr(node, "lineno", 1))
        rest += [(child, depth + 1) for child in ast.iter_child_nodes(node)]
    return tree


def arguments(function: ast.FunctionDef) -> dict[str, ast.expr | None]:
    """Returns the arguments of a function by name, each with its default; `self` is one of them."""
    given = function.args
    names = [argument.arg for argument in [*given.posonlyargs, *given.args, *given.kwonlyargs]]
    required = len(given.posonlyargs) + len(given.args) - len(given.defaults)
    return dict(zip(names, [*[None] * required, *given.defaults, *given.kw_defaults], strict=True))


def takes_self(function: ast.FunctionDef) -> bool:
    """Whether `self` is a function's first argument."""
    return next(iter(arguments(function)), "") == "self"
