"""Numbers that stand for the same thing get one type: TorchScript types a list by its elements, and Python does not.

`{"reach": 1, "lift": 0.5}` would hold no numbers that one can count with.
"""

import ast
from collections.abc import Mapping, Sequence
from typing import TypeGuard

from porse.code.annotations import number_kind, type_text, value_type
from porse.functions.read.contract import MAX_INTEGER
from porse.code.program import Program
from porse.code.syntax import all_arguments, defaults, given_values
from porse.variables import Variable


def give_numbers_one_type(program: Program, variables: Mapping[str, Variable]) -> None:
    """Makes floats, in place, of integers that stand beside floats in a list, a dictionary or `1 if x else 0.5`.

    So are the integers that a helper is given where it is given floats too, or says that it wants some.
    """
    for tree in [*program.helpers.values(), program.main]:
        _make_rows(tree)
        for node in ast.walk(tree):
            _make_alike(_siblings(node))
    _make_components(program.main, variables)
    for helper in program.helpers.values():
        _make_arguments_alike(program, helper, variables)


def _make_rows(tree: ast.AST) -> None:
    """Makes lists of rows that a loop goes through, `for w, x in ((1, a), (0.5, b))`: TorchScript takes no tuple of them."""
    for node in ast.walk(tree):
        if isinstance(node, ast.For | ast.comprehension) and isinstance(node.iter, ast.Tuple):
            rows = node.iter.elts
            if rows and all(isinstance(row, ast.Tuple | ast.List) for row in rows):
                node.iter = ast.copy_location(ast.List(elts=rows, ctx=ast.Load()), node.iter)


def _siblings(node: ast.AST) -> Sequence[ast.expr]:
    """Returns the expressions below a node that want one type."""
    if isinstance(node, ast.List) and isinstance(node.ctx, ast.Load):
        return node.elts
    if isinstance(node, ast.Dict):
        return node.values
    if isinstance(node, ast.IfExp):
        return [node.body, node.orelse]
    is_dict = isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "dict"
    return [keyword.value for keyword in node.keywords] if is_dict and isinstance(node, ast.Call) else []


def _make_components(main: ast.FunctionDef, variables: Mapping[str, Variable]) -> None:
    """Makes tensors, in place, of the numbers among the components that a reward returns."""
    returned = [node.value.elts[1] for node in ast.walk(main) if isinstance(node, ast.Return) and _is_pair(node.value)]
    names = {value.id for value in returned if isinstance(value, ast.Name)}
    dictionaries = [value for value in returned if isinstance(value, ast.Dict)]
    for node in ast.walk(main):
        if not isinstance(node, ast.Assign | ast.AnnAssign):
            continue
        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
        owner = target.value if isinstance(target, ast.Subscript) else target
        if isinstance(owner, ast.Name) and owner.id in names and node.value is not None:
            if isinstance(node.value, ast.Dict):
                dictionaries.append(node.value)
            elif isinstance(target, ast.Subscript):
                node.value = _tensor(node.value, main, variables)
    for dictionary in dictionaries:
        dictionary.values = [_tensor(value, main, variables) for value in dictionary.values]


def _is_pair(value: ast.expr | None) -> TypeGuard[ast.Tuple]:
    return isinstance(value, ast.Tuple) and len(value.elts) == 2


def _tensor(value: ast.expr, function: ast.FunctionDef, variables: Mapping[str, Variable]) -> ast.expr:
    if value_type(value, function, variables) not in ("int", "float"):
        return value
    torch_tensor = ast.Attribute(value=ast.Name(id="torch", ctx=ast.Load()), attr="tensor", ctx=ast.Load())
    return ast.fix_missing_locations(ast.copy_location(ast.Call(func=torch_tensor, args=[value], keywords=[]), value))


def _make_arguments_alike(program: Program, helper: ast.FunctionDef, variables: Mapping[str, Variable]) -> None:
    """Gives each argument of a helper one type of number, over its default and all its calls."""
    for argument in all_arguments(helper):
        values = given_values(program, helper, argument)
        _make_alike([value for value, _ in values])
        kinds = {value_type(value, function, variables) for value, function in values}
        is_declared = argument.annotation is not None and type_text(argument.annotation) == "float"
        is_number = argument.arg in defaults(helper) or "" not in kinds
        if is_declared or (is_number and "float" in kinds):
            for value, _ in values:
                if _kind(value) == "int":
                    _make_float(value)


def _make_alike(values: Sequence[ast.expr]) -> None:
    if not values:
        return
    if all(isinstance(value, ast.Tuple) for value in values):
        rows = [value.elts for value in values if isinstance(value, ast.Tuple)]
        if len({len(row) for row in rows}) == 1:
            for column in zip(*rows, strict=True):
                _make_alike(column)
    elif all(isinstance(value, ast.List) for value in values):
        _make_alike([element for value in values if isinstance(value, ast.List) for element in value.elts])
    elif {_kind(value) for value in values} == {"int", "float"}:
        for value in values:
            if _kind(value) == "int":
                _make_float(value)


def _kind(node: ast.expr) -> str:
    """Returns "int" or "float" for a number that is written out, or arithmetic of some, "" for anything else."""
    kind = number_kind(node, _kind)
    return kind if kind in ("int", "float") else ""


def _make_float(node: ast.expr) -> None:
    for number in ast.walk(node):
        whole = number.value if isinstance(number, ast.Constant) else None
        if isinstance(number, ast.Constant) and isinstance(whole, int) and abs(whole) <= MAX_INTEGER:
            number.value = float(whole)  # a larger one is refused later
