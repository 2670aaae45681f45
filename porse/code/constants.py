"""Module and class constants: which are taken along, and how a function gets those that it reads."""

import ast
import copy
from collections.abc import Callable, Container, Mapping, Set

from porse.functions.read.contract import words

_NODES = (
    ast.Constant, ast.UnaryOp, ast.unaryop, ast.BinOp, ast.operator, ast.List, ast.Tuple, ast.Dict, ast.Subscript,
    ast.Call, ast.keyword, ast.Name, ast.Attribute, ast.Load,
)  # fmt: skip
_MODULES = words("math torch np numpy")
_OF_EVERY_TASK = words("actions device num_envs obs_buf progress_buf")
"""What `self` has in the tasks, whatever a class around the function sets when it is made."""
_FUNCTIONS = words("abs dict float int len list max min round sum tuple")


def is_constant(value: ast.expr, known: Container[str]) -> bool:
    """Whether a value beside the functions may be offered to them: written out, or computed from constants that are known.

    That is its form alone: where it is used it is held against the same lists as the function.
    """
    if _is_of_class(value, ()):
        return True  # it stands for the class, and is never made
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


def place_constants(
    function: ast.FunctionDef, constants: Mapping[str, ast.expr], bound: Set[str], functions: Container[str]
) -> None:
    """Makes local names, in place, of the constants that a function reads: by name, as `self.X` and as `Class.X`.

    What is made or named of a class, `c = Config()` or `R = Reward`, stands for it; its functions are called by their names.

    Args:
        function: the function.
        constants: the constants in their order.
        bound: names that mean something else in the function.
        functions: names of the functions beside it.
    """
    local = {name: f"{name}_constant" if name in bound else name for name in constants}
    given = {local[name]: value for name, value in constants.items()}
    known = bound | constants.keys()
    holders = {name for name, value in constants.items() if name not in bound and _is_of_class(value, known)}
    kept = []
    for statement in function.body:
        value = statement.value if isinstance(statement, ast.Assign) else None
        target = statement.targets[0] if isinstance(statement, ast.Assign) else None
        if isinstance(target, ast.Name) and value is not None and _is_of_class(value, known):
            holders.add(target.id)
        else:
            kept.append(statement)
    function.body = kept or function.body
    names = _Names(local, bound, holders, functions)
    _rename_results(function, names.is_class, functions)
    for statement in function.body:
        names.visit(statement)
    needed: set[str] = set()
    queue: list[ast.AST] = list(function.body)
    while queue:
        for node in ast.walk(queue.pop()):
            if isinstance(node, ast.Name) and node.id in given and node.id not in needed:
                needed.add(node.id)
                queue.append(_renamed(given[node.id], local))
    function.body[:0] = [
        ast.copy_location(
            ast.Assign(
                targets=[ast.copy_location(ast.Name(id=name, ctx=ast.Store()), value)], value=_renamed(value, local)
            ),
            value,
        )
        for name, value in given.items()
        if name in needed
    ]


def _rename_results(function: ast.FunctionDef, is_class: Callable[[ast.expr], bool], functions: Container[str]) -> None:
    """Gives `reach` in `reach = r.reach(x)`, in place, another name than the function's: `r.reach` will be `reach`."""
    arguments = {node.arg for node in ast.walk(function) if isinstance(node, ast.arg)}
    called = {node.attr for node in ast.walk(function) if isinstance(node, ast.Attribute) and is_class(node.value)}
    for node in ast.walk(function):
        if isinstance(node, ast.Name) and node.id in called - arguments and node.id in functions:
            node.id += "_result"


def _renamed(value: ast.expr, names: Mapping[str, str]) -> ast.expr:
    """Returns a copy of a value with other names of constants."""
    changed = copy.deepcopy(value)
    for node in ast.walk(changed):
        if isinstance(node, ast.Name):
            node.id = names.get(node.id, node.id)
    return changed


def _is_of_class(value: ast.expr, bound: Container[str]) -> bool:
    """Whether a value is a class, by its capital letter, or made of one without arguments."""
    made = value.func if isinstance(value, ast.Call) and not value.args and not value.keywords else value
    return isinstance(made, ast.Name) and made.id[:1].isupper() and not made.id.isupper() and made.id not in bound


class _Names(ast.NodeTransformer):
    """Writes `X` for `self.X` and `Class.X`, and `f(...)` for `Class.f(...)`."""

    def __init__(
        self, constants: Mapping[str, str], bound: Container[str], holders: Container[str], functions: Container[str]
    ) -> None:
        self._constants = constants
        self._bound = bound
        self._holders = holders
        self._functions = functions

    def is_class(self, owner: ast.expr) -> bool:
        """Whether a value is a class, or made of one."""
        name = owner.id if isinstance(owner, ast.Name) else ""
        return name in self._holders or (name[:1].isupper() and name not in self._bound)

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        self.generic_visit(node)
        is_class = self.is_class(node.value)
        is_own = isinstance(node.value, ast.Name) and node.value.id == "self" and node.attr not in _OF_EVERY_TASK
        is_constant = node.attr in self._constants and (is_class or is_own)
        if isinstance(node.ctx, ast.Load) and (is_constant or (is_class and node.attr in self._functions)):
            name = self._constants.get(node.attr, node.attr)
            return ast.copy_location(ast.Name(id=name, ctx=ast.Load()), node)
        return node
