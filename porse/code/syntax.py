"""Questions about a function's syntax tree that both the check and the writer ask."""

import ast
from collections.abc import Iterable, Iterator, Mapping

from porse.code.program import Program, import_names


def local_names(function: ast.FunctionDef) -> set[str]:
    """Returns the arguments of a function and every name that it binds."""
    return {argument.arg for argument in all_arguments(function)} | assigned_names(function)


def assigned_names(function: ast.FunctionDef) -> set[str]:
    """Returns every name that a function assigns."""
    return {n.id for n in ast.walk(function) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}


def all_arguments(function: ast.FunctionDef) -> list[ast.arg]:
    """Returns the arguments of a function but `self`, in order."""
    arguments = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    return [a for i, a in enumerate(arguments) if not (i == 0 and a.arg == "self")]


def defaults(function: ast.FunctionDef) -> dict[str, ast.expr]:
    """Returns the default values of arguments by name."""
    positional = [*function.args.posonlyargs, *function.args.args]
    found = dict(zip([a.arg for a in positional][::-1], function.args.defaults[::-1], strict=False))
    pairs = zip(function.args.kwonlyargs, function.args.kw_defaults, strict=True)
    found.update({a.arg: value for a, value in pairs if value is not None})
    return found


def given_values(
    program: Program, helper: ast.FunctionDef, argument: ast.arg
) -> list[tuple[ast.expr, ast.FunctionDef]]:
    """Returns the default value of a helper's argument and what its calls give it, each with the function it stands in."""
    position, default = all_arguments(helper).index(argument), defaults(helper).get(argument.arg)
    found = [(default, helper)] if default is not None else []
    for function in [*program.helpers.values(), program.main]:
        for node in ast.walk(function):
            if isinstance(node, ast.Call) and getattr(node.func, "id", getattr(node.func, "attr", "")) == helper.name:
                named = [keyword.value for keyword in node.keywords if keyword.arg == argument.arg]
                found += [(value, function) for value in named or node.args[position : position + 1]]
    return found


def assigned_values(function: ast.FunctionDef, name: str) -> Iterator[ast.expr]:
    """Yields every value that a function assigns to a name."""
    for node in ast.walk(function):
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AugAssign) else []
        )
        if isinstance(node, ast.Assign | ast.AugAssign) and any(
            isinstance(t, ast.Name) and t.id == name for t in targets
        ):
            yield node.value


def modules_of(program: Program, function: ast.FunctionDef) -> dict[str, str]:
    """Returns the dotted path of each name that stands for a module in a function, its own imports included."""
    modules = dict(program.modules)
    for node in ast.walk(function):
        if isinstance(node, ast.Import | ast.ImportFrom):
            modules.update(import_names(node))
    return modules


def module_path(node: ast.expr, modules: Mapping[str, str], local: Iterable[str]) -> str:
    """Returns the dotted path of an attribute chain that starts at a module's name, "" for anything else."""
    names: list[str] = []
    while isinstance(node, ast.Attribute):
        names.insert(0, node.attr)
        node = node.value
    if isinstance(node, ast.Name) and node.id in modules and node.id not in local:
        return ".".join([modules[node.id], *names])
    return ""
