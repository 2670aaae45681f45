"""The code that a reply holds of one function, parsed. Nothing of it is run here."""

import ast
from dataclasses import dataclass


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


def arguments(function: ast.FunctionDef) -> dict[str, ast.expr | None]:
    """Returns the arguments of a function by name, each with its default; `self` is one of them."""
    given = function.args
    names = [argument.arg for argument in [*given.posonlyargs, *given.args, *given.kwonlyargs]]
    required = len(given.posonlyargs) + len(given.args) - len(given.defaults)
    return dict(zip(names, [*[None] * required, *given.defaults, *given.kw_defaults], strict=True))


def takes_self(function: ast.FunctionDef) -> bool:
    """Whether `self` is a function's first argument."""
    return next(iter(arguments(function)), "") == "self"
