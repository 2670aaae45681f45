"""Functions inside a function, and lambdas that are given a name, become functions beside it.

TorchScript knows neither. What an inner function reads of the outer one is handed to it as further arguments.
"""

import ast
from collections.abc import Iterator, Mapping

from porse.code.scan import text_of
from porse.functions.verdict import CodeError


def hoist(function: ast.FunctionDef) -> list[ast.FunctionDef]:
    """Takes the inner functions out of `function`, which is changed, and returns them in order.

    Raises:
        CodeError: an inner function is used other than by calling it, or has functions in it itself.
    """
    inner = {f.name: f for f in _take(function)}
    if not inner:
        return []
    outer_names = _bound(function)
    captures = {name: sorted(_read(f) & outer_names - _bound(f) - set(inner)) for name, f in inner.items()}
    for _ in inner:  # an inner function hands on what the inner functions that it calls need
        for name, f in inner.items():
            for called in _read(f) & set(inner):
                captures[name] = sorted({*captures[name], *captures[called]} - _bound(f))
    for name, f in inner.items():
        if f.decorator_list or any(isinstance(n, ast.FunctionDef | ast.Lambda) for n in ast.walk(f) if n is not f):
            raise CodeError(
                "static",
                "an inner function has a decorator or a function in it; put them beside the function",
                f.lineno,
            )
        own = [
            ast.arg(arg=c, annotation=_annotation(c, function, inner), lineno=f.lineno, col_offset=0)
            for c in captures[name]
        ]
        reads_self = any(isinstance(n, ast.Name) and n.id == "self" for n in ast.walk(f))
        first = [ast.arg(arg="self", lineno=f.lineno, col_offset=0)] if reads_self and "self" not in _bound(f) else []
        f.args.args = [*first, *own, *f.args.args]
    for tree in [function, *inner.values()]:
        _Calls(captures).visit(tree)
    return list(inner.values())


def _take(function: ast.FunctionDef) -> Iterator[ast.FunctionDef]:
    """Removes inner functions and named lambdas from a body and yields them."""
    for node in [n for n in ast.walk(function) if isinstance(n, ast.If | ast.For | ast.With) or n is function]:
        assert isinstance(node, ast.If | ast.For | ast.With | ast.FunctionDef)
        kept: list[ast.stmt] = []
        for statement in node.body:
            if isinstance(statement, ast.FunctionDef):
                yield statement
            elif _is_named_lambda(statement):
                yield _function_of(statement)
            else:
                kept.append(statement)
        node.body = kept or [ast.Pass(lineno=function.lineno, col_offset=0)]


def _is_named_lambda(node: ast.stmt) -> bool:
    return (
        isinstance(node, ast.Assign)
        and isinstance(node.value, ast.Lambda)
        and len(node.targets) == 1
        and isinstance(node.targets[0], ast.Name)
    )


def _function_of(node: ast.stmt) -> ast.FunctionDef:
    assert isinstance(node, ast.Assign)
    assert isinstance(node.value, ast.Lambda)
    target = node.targets[0]
    assert isinstance(target, ast.Name)
    body = ast.copy_location(ast.Return(value=node.value.body), node)
    function = ast.FunctionDef(name=target.id, args=node.value.args, body=[body], decorator_list=[], returns=None)
    return ast.copy_location(function, node)


def _bound(function: ast.FunctionDef) -> set[str]:
    """Returns the arguments of a function and the names that it assigns, not looking into inner functions."""
    arguments = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    names = {argument.arg for argument in arguments}
    queue: list[ast.AST] = list(function.body)
    while queue:
        node = queue.pop()
        if isinstance(node, ast.FunctionDef | ast.Lambda):
            continue
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        queue.extend(ast.iter_child_nodes(node))
    return names - {"self"}


def _read(function: ast.FunctionDef) -> set[str]:
    return {n.id for s in function.body for n in ast.walk(s) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load)}


def _annotation(name: str, function: ast.FunctionDef, inner: Mapping[str, ast.FunctionDef]) -> ast.expr | None:
    """Returns the type of a name of the outer function: as declared, or of the plain number or the list that it is."""
    for argument in [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]:
        if argument.arg == name:
            return argument.annotation
    values = [
        n.value
        for n in ast.walk(function)
        if isinstance(n, ast.Assign) and any(isinstance(t, ast.Name) and t.id == name for t in n.targets)
    ]
    declared = [
        n.annotation
        for n in ast.walk(function)
        if isinstance(n, ast.AnnAssign) and isinstance(n.target, ast.Name) and n.target.id == name
    ]
    if declared:
        return declared[0]
    if values and all(isinstance(value, ast.Dict | ast.DictComp) for value in values):
        return _at(function, "Dict[str, torch.Tensor]")
    if values and all(isinstance(value, ast.List | ast.ListComp) for value in values):
        return _declare(name, function, inner)
    kinds = {number_type(value) for value in values}
    kind = kinds.pop() if len(kinds) == 1 else ""
    return ast.Name(id=kind, ctx=ast.Load(), lineno=function.lineno, col_offset=0) if kind else None


def _declare(name: str, function: ast.FunctionDef, inner: Mapping[str, ast.FunctionDef]) -> ast.expr:
    """Returns the type of a list by what is appended to it, tensors if that is not plain, and declares it where it begins."""
    kinds = set()
    for owner in [function, *inner.values()]:
        for node in ast.walk(owner):
            if isinstance(node, ast.Call) and text_of(node.func) == f"{name}.append" and len(node.args) == 1:
                kinds.add(_appended(node.args[0], owner, function))
    kind = (kinds.pop() if len(kinds) == 1 else "") or "torch.Tensor"
    for node in ast.walk(function):
        body: list[ast.stmt] = node.body if isinstance(node, ast.FunctionDef | ast.If | ast.For | ast.With) else []
        for number, statement in enumerate(body):
            if isinstance(statement, ast.Assign) and text_of(statement) == f"{name} = []":
                target = ast.copy_location(ast.Name(id=name, ctx=ast.Store()), statement)
                declared = ast.AnnAssign(
                    target=target, annotation=_at(function, f"List[{kind}]"), value=statement.value, simple=1
                )
                body[number] = ast.copy_location(declared, statement)
    return _at(function, f"List[{kind}]")


def _appended(value: ast.expr, owner: ast.FunctionDef, function: ast.FunctionDef) -> str:
    """Returns the type of a text or number that is appended, also as an argument of the function that appends it."""
    names = [argument.arg for argument in owner.args.args]
    if not isinstance(value, ast.Name) or value.id not in names:
        return "str" if isinstance(value, ast.JoinedStr) or _is_text(value) else number_type(value)
    given = dict(zip(names[::-1], owner.args.defaults[::-1], strict=False))
    if value.id in given:
        return number_type(given[value.id])
    position = names.index(value.id)
    calls = [n for n in ast.walk(function) if isinstance(n, ast.Call) and text_of(n.func) == owner.name]
    kinds = {
        "str" if isinstance(part, ast.JoinedStr) or _is_text(part) else number_type(part)
        for call in calls
        for part in [*call.args[position : position + 1], *(k.value for k in call.keywords if k.arg == value.id)]
    }
    return kinds.pop() if len(kinds) == 1 else ""


def _is_text(value: ast.expr) -> bool:
    return isinstance(value, ast.Constant) and isinstance(value.value, str)


def _at(where: ast.FunctionDef, text: str) -> ast.expr:
    """Returns the tree of a type at the place of a function."""
    tree = ast.parse(text, mode="eval").body
    for node in ast.walk(tree):
        ast.copy_location(node, where)
    return tree


def number_type(node: ast.expr | None) -> str:
    """Returns "int", "float" or "bool" for a plain constant, "" for anything else."""
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        node = node.operand
    if isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float):
        return type(node.value).__name__
    return ""


class _Calls(ast.NodeTransformer):
    """Adds the captured names to every call of an inner function."""

    def __init__(self, captures: dict[str, list[str]]) -> None:
        self.captures = captures

    def visit_Call(self, node: ast.Call) -> ast.AST:
        if isinstance(node.func, ast.Name) and node.func.id in self.captures:
            names = self.captures[node.func.id]
            more = [ast.copy_location(ast.Name(id=name, ctx=ast.Load()), node) for name in names]
            node.args = [*more, *(self.visit(argument) for argument in node.args)]
            node.keywords = [self.visit(keyword) for keyword in node.keywords]
            return node
        return self.generic_visit(node)
