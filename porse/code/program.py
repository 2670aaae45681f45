"""The stored source of a function as a program: main function, helpers, constants, and the names of modules.

The source of a candidate goes through here each time it is compiled, since a file from elsewhere is hostile until then.
"""

import ast
from dataclasses import dataclass

from porse.code.constants import is_constant, place_constants
from porse.functions.read.contract import MAX_SOURCE_LINES, MAX_TREE_NODES, MODULES
from porse.code.hoist import hoist
from porse.code.plainly import call_without_self, start_apart, write_plainly
from porse.code.scan import parse_source
from porse.functions.verdict import CodeError

DEFAULT_MODULES = {
    "torch": "torch",
    "math": "math",
    "F": "torch.nn.functional",
    "nn": "torch.nn",
    "np": "numpy",
    "numpy": "numpy",
}


@dataclass(frozen=True)
class Program:
    """A parsed source.

    Attributes:
        main: the function itself, the last one of the source.
        helpers: the other functions by name.
        modules: dotted path for each name that stands for a module or for something imported from one.
    """

    main: ast.FunctionDef
    helpers: dict[str, ast.FunctionDef]
    modules: dict[str, str]


def parse_program(source: str) -> Program:
    """Returns the program of a source.

    Raises:
        CodeError: it holds anything but imports of allowed modules, constants and functions.
    """
    if source.count("\n") > MAX_SOURCE_LINES + 2 or len(source) > 400 * MAX_SOURCE_LINES:
        raise CodeError("syntax", f"expected at most {MAX_SOURCE_LINES} lines of code, found {source.count(chr(10))}")
    functions: dict[str, ast.FunctionDef] = {}
    constants: dict[str, ast.expr] = {}
    modules = dict(DEFAULT_MODULES)
    for node in parse_source(source).body:
        if isinstance(node, ast.FunctionDef):
            if node.decorator_list:
                raise CodeError("static", "decorators are not allowed in a stored function", node.lineno)
            functions.pop(node.name, None)
            functions[node.name] = node
        elif isinstance(node, ast.Import | ast.ImportFrom):
            modules.update(import_names(node))
        elif isinstance(node, ast.Assign | ast.AnnAssign) and constant_of(node)[0]:
            name, value = constant_of(node)
            if value is None or not is_constant(value, constants):
                raise CodeError("static", f"the constant {name} is not computed from numbers alone", node.lineno)
            constants.pop(name, None)
            constants[name] = value
        else:
            raise CodeError("static", f"a {type(node).__name__} statement is not allowed beside functions", node.lineno)
    if not functions:
        raise CodeError("extract", "expected a function, found none")
    *helpers, main = functions.values()
    found = {f.name: f for f in helpers}
    for function in [*helpers, main]:
        start_apart(function)
        for inner in hoist(function):
            if inner.name in found or inner.name == main.name:
                raise CodeError(
                    "static", f"two functions are named {inner.name}; give each a name of its own", inner.lineno
                )
            found[inner.name] = inner
    methods = {name for name, helper in found.items() if helper.args.args and helper.args.args[0].arg == "self"}
    size = 0
    for function in [*found.values(), main]:
        place_constants(function, constants, _bound(function) | modules.keys(), found)
        size += sum(1 for _ in ast.walk(function))
        if size > 2 * MAX_TREE_NODES:
            raise CodeError("syntax", "the functions with the constants that they read are too large", function.lineno)
        call_without_self(function, methods)
        write_plainly(function)
    return Program(main, found, modules)


def constant_of(node: ast.Assign | ast.AnnAssign) -> tuple[str, ast.expr | None]:
    """Returns the name and the value of an assignment to one name, an empty name for any other."""
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    is_one = len(targets) == 1 and isinstance(targets[0], ast.Name) and node.value is not None
    return (targets[0].id, node.value) if is_one and isinstance(targets[0], ast.Name) else ("", None)


def _bound(function: ast.FunctionDef) -> set[str]:
    """Returns the arguments of a function and every name that it assigns."""
    return {
        node.arg if isinstance(node, ast.arg) else node.id
        for node in ast.walk(function)
        if isinstance(node, ast.arg) or (isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store))
    }


def import_names(node: ast.Import | ast.ImportFrom) -> dict[str, str]:
    """Returns what an import line would bind: local name to dotted path. Nothing is imported.

    Raises:
        CodeError: the module is not one of `MODULES`, or everything is imported at once from torch.
    """
    if isinstance(node, ast.ImportFrom):
        module = "." * node.level + (node.module or "")
        pairs = [(alias.asname or alias.name, f"{module}.{alias.name}") for alias in node.names if alias.name != "*"]
    else:
        module = node.names[0].name
        pairs = [(a.asname or a.name.split(".")[0], a.name if a.asname else a.name.split(".")[0]) for a in node.names]
    for path in [module, *(path for _, path in pairs)]:
        if path.split(".")[0] not in MODULES:
            raise CodeError(
                "static", f"the import of {path} is not allowed; only torch, math and typing are offered", node.lineno
            )
    return {name: path for name, path in pairs if path.split(".")[0] in ("torch", "math", "numpy")}
