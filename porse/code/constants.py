"""Module and class constants: which are taken along, and how a function gets those that it reads."""

import ast
import copy
from collections.abc import Container, Mapping

from porse.code.contract import words

_NODES = (
    ast.Constant, ast.UnaryOp, ast.unaryop, ast.BinOp, ast.operator, ast.List, ast.Tuple, ast.Dict, ast.Subscript,
    ast.Call, ast.keyword, ast.Name, ast.Attribute, ast.Load,
)  # fmt: skip
_MODULES = words("math torch np numpy")
_FUNCTIONS = words("abs dict float int len list max min round sum tuple")


def is_constant(value: ast.expr, known: Container[str]) -> bool:
    """Whether a value beside the functions may be offered to them: written out, or computed from constants that are known.

    That is its form alone: where it is used it is held against the same lists as the function.
    """
    for node in ast.walk(value):
        if not isinstance(node, _NODES):
            return False
        if isinstance(node, ast.Name) and node.id not in _MODULES | _FUNCTIONS and node.id not in known:
            return False
        if isinstance(node, ast.Attribute) and not isinstance(node.value, ast.Name):
            return False
        if isinstance(node, ast.Call) and not isinstance(node.func, ast.Name | ast.Attribute):
            return False
    return True


def place_constants(function: ast.FunctionDef, constants: Mapping[str, ast.expr], bound: Container[str]) -> None:
    """Makes local names, in place, of the constants that a function reads: by name, as `self.X` and as `Class.X`.

    Args:
        function: the function.
        constants: the constants in their order.
        bound: names that mean something else in the function.
    """
    given = {name: value for name, value in constants.items() if name not in bound}
    for statement in function.body:
        _Names(given, bound).visit(statement)
    needed: set[str] = set()
    queue: list[ast.AST] = list(function.body)
    while queue:
        for node in ast.walk(queue.pop()):
            if isinstance(node, ast.Name) and node.id in given and node.id not in needed:
                needed.add(node.id)
                queue.append(given[node.id])
    function.body[:0] = [
        ast.copy_location(
            ast.Assign(
                targets=[ast.copy_location(ast.Name(id=name, ctx=ast.Store()), value)], value=copy.deepcopy(value)
            ),
            value,
        )
        for name, value in given.items()
        if name in needed
    ]


class _Names(ast.NodeTransformer):
    """Writes `X` for `self.X` and `Class.X`."""

    def __init__(self, constants: Container[str], bound: Container[str]) -> None:
        self._constants = constants
        self._bound = bound

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        self.generic_visit(node)
        owner = node.value.id if isinstance(node.value, ast.Name) else ""
        is_holder = owner == "self" or (owner[:1].isupper() and owner not in self._bound)
        if is_holder and node.attr in self._constants and isinstance(node.ctx, ast.Load):
            return ast.copy_location(ast.Name(id=node.attr, ctx=ast.Load()), node)
        return node
