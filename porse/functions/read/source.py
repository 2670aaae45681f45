"""The stored source of a function: main function, helpers, constants, and the names of modules. Nothing of it is run here."""

import ast
from collections.abc import Container, Iterator
from dataclasses import dataclass

from porse.functions.contract import MAX_SOURCE_LINES, MODULES
from porse.functions.read.scan import parse_source
from porse.functions.verdict import CodeError, words

DEFAULT_MODULES = {
    "torch": "torch",
    "math": "math",
    "F": "torch.nn.functional",
    "nn": "torch.nn",
    "np": "numpy",
    "numpy": "numpy",
}
_NODES = (
    ast.Constant, ast.UnaryOp, ast.unaryop, ast.BinOp, ast.operator, ast.BoolOp, ast.boolop, ast.List, ast.Tuple, ast.Dict,
    ast.Subscript, ast.Call, ast.keyword, ast.Name, ast.Attribute, ast.Load,
)  # fmt: skip
_OF_EVERY_TASK = words("actions device num_envs obs_buf progress_buf")
"""What the tasks have, whatever a class around the function sets when it is made."""
_OFFERED = words("math torch np numpy abs dict float int len list max min round sum tuple")


@dataclass(frozen=True)
class Source:
    """A parsed source.

    Attributes:
        main: the function itself, the last one of the source.
        helpers: the other functions by name.
        constants: the module's and the classes' constants by name, in their order.
        modules: dotted path for each name that stands for a module or for something imported from one.
    """

    main: ast.FunctionDef
    helpers: dict[str, ast.FunctionDef]
    constants: dict[str, ast.Assign | ast.AnnAssign]
    modules: dict[str, str]

    @property
    def functions(self) -> list[ast.FunctionDef]:
        """All functions, the main one last."""
        return [*self.helpers.values(), self.main]

    @property
    def last_line(self) -> int:
        """The line of the last return of the main function."""
        lines = (node.lineno for node in ast.walk(self.main) if isinstance(node, ast.Return))
        return max(lines, default=self.main.lineno)


def parse(text: str) -> Source:
    """Returns the parts of a source.

    Raises:
        CodeError: it holds anything but imports of allowed modules, constants and functions.
    """
    if text.count("\n") > MAX_SOURCE_LINES + 2 or len(text) > 400 * MAX_SOURCE_LINES:
        raise CodeError("syntax", f"expected at most {MAX_SOURCE_LINES} lines of code, found {text.count(chr(10))}")
    functions: dict[str, ast.FunctionDef] = {}
    constants: dict[str, ast.Assign | ast.AnnAssign] = {}
    modules = dict(DEFAULT_MODULES)
    for node in parse_source(text).body:
        if isinstance(node, ast.FunctionDef):
            if node.decorator_list:
                raise CodeError("static", "decorators are not allowed in a stored function", node.lineno)
            functions.pop(node.name, None)
            functions[node.name] = node
        elif isinstance(node, ast.Import | ast.ImportFrom):
            modules.update(import_names(node))
        elif isinstance(node, ast.Assign | ast.AnnAssign) and constant_of(node)[0]:
            name, value = constant_of(node)
            if name in _OF_EVERY_TASK:
                continue
            if value is None or not is_constant(value, constants):
                raise CodeError("static", f"the constant {name} is not computed from numbers alone", node.lineno)
            constants.pop(name, None)
            constants[name] = node
        else:
            raise CodeError("static", f"a {type(node).__name__} statement is not allowed beside functions", node.lineno)
    if not functions:
        raise CodeError("extract", "expected a function, found none")
    *helpers, main = functions.values()
    for inner in (node for function in functions.values() for node in ast.walk(function)):
        if isinstance(inner, ast.Import | ast.ImportFrom):
            modules.update(import_names(inner))
    return Source(main, {helper.name: helper for helper in helpers}, constants, modules)


def constant_of(node: ast.Assign | ast.AnnAssign) -> tuple[str, ast.expr | None]:
    """Returns the name and the value of an assignment to one name, an empty name for any other."""
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    is_one = len(targets) == 1 and isinstance(targets[0], ast.Name) and node.value is not None
    return (targets[0].id, node.value) if is_one and isinstance(targets[0], ast.Name) else ("", None)


def is_constant(value: ast.expr, known: Container[str]) -> bool:
    """Whether a value beside the functions may be offered to them: written out, or computed from constants that are known.

    That is its form alone: where it is used it is held against the same lists as the function.
    """
    if isinstance(value, ast.Name | ast.Call) and is_class(value):
        return True
    for node in ast.walk(value):
        if not isinstance(node, _NODES):
            return False
        if isinstance(node, ast.Name) and node.id not in _OFFERED and node.id not in known:
            return False
        if isinstance(node, ast.Attribute) and not isinstance(node.value, ast.Name):
            return False
        if isinstance(node, ast.Call) and not isinstance(node.func, ast.Name | ast.Attribute):
            return False
    return True


def is_class(value: ast.expr) -> bool:
    """Whether a value is a class, by its capital letter, or made of one without arguments."""
    made = value.func if isinstance(value, ast.Call) and not value.args and not value.keywords else value
    return isinstance(made, ast.Name) and made.id[:1].isupper() and not made.id.isupper()


def import_names(node: ast.Import | ast.ImportFrom) -> dict[str, str]:
    """Returns what an import line would bind: local name to dotted path. Nothing is imported.

    Raises:
        CodeError: the module is not one of `MODULES`.
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


def all_arguments(function: ast.FunctionDef) -> list[ast.arg]:
    """Returns the arguments of a function but `self`, in order."""
    arguments = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    return [a for i, a in enumerate(arguments) if not (i == 0 and a.arg == "self")]


def takes_self(function: ast.FunctionDef) -> bool:
    """Whether `self` is a function's first argument."""
    return bool(function.args.args) and function.args.args[0].arg == "self"


def defaults(function: ast.FunctionDef) -> dict[str, ast.expr]:
    """Returns the default values of arguments by name."""
    positional = [*function.args.posonlyargs, *function.args.args]
    found = dict(zip([a.arg for a in positional][::-1], function.args.defaults[::-1], strict=False))
    pairs = zip(function.args.kwonlyargs, function.args.kw_defaults, strict=True)
    found.update({a.arg: value for a, value in pairs if value is not None})
    return found


def bound_names(function: ast.FunctionDef) -> Iterator[str]:
    """Yields every name that a function binds, those of functions in it included: arguments, assignments, functions."""
    for node in ast.walk(function):
        if isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.FunctionDef) and node is not function:
            yield node.name


def module_path(node: ast.expr, modules: dict[str, str], local: Container[str]) -> str:
    """Returns the dotted path of an attribute chain that starts at a module's name, "" for anything else."""
    names: list[str] = []
    while isinstance(node, ast.Attribute):
        names.insert(0, node.attr)
        node = node.value
    if isinstance(node, ast.Name) and node.id in modules and node.id not in local:
        return ".".join([modules[node.id], *names])
    return ""
