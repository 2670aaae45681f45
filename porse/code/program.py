"""The stored source of a function as a program: main function, helpers, constants, and the names of modules.

The source of a candidate goes through here each time it is compiled, since a file from elsewhere is hostile until then.
"""

import ast
from dataclasses import dataclass

from porse.code.contract import MAX_SOURCE_LINES, MODULES
from porse.code.hoist import hoist
from porse.code.scan import parse_source
from porse.code.verdict import CodeError

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
        constants: module-level numbers, texts, lists and dictionaries of them, and tensors, by name.
        modules: dotted path for each name that stands for a module or for something imported from one.
    """

    main: ast.FunctionDef
    helpers: dict[str, ast.FunctionDef]
    constants: dict[str, ast.expr]
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
        elif isinstance(node, ast.Assign) and len(node.targets) == 1 and isinstance(node.targets[0], ast.Name):
            constants[node.targets[0].id] = node.value
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.value is not None:
            constants[node.target.id] = node.value
        else:
            raise CodeError("static", f"a {type(node).__name__} statement is not allowed beside functions", node.lineno)
    if not functions:
        raise CodeError("extract", "expected a function, found none")
    *helpers, main = functions.values()
    found = {f.name: f for f in helpers}
    for function in [*helpers, main]:
        for inner in hoist(function):
            if inner.name in found or inner.name == main.name:
                raise CodeError(
                    "static", f"two functions are named {inner.name}; give each a name of its own", inner.lineno
                )
            found[inner.name] = inner
    return Program(main, found, constants, modules)


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
