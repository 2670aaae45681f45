"""The stored source of a function: main function, helpers, constants, and the names of modules. Nothing of it is run here."""

import ast
from collections.abc import Container
from dataclasses import dataclass
from functools import cached_property

from porse.functions.contract import MAX_SOURCE_LINES, MODULES
from porse.functions.read.scan import parse_source
from porse.functions.verdict import CodeError, words

Import = ast.Import | ast.ImportFrom
Assignment = ast.Assign | ast.AnnAssign

DEFAULT_MODULES = {
    "torch": "torch", "math": "math", "F": "torch.nn.functional", "nn": "torch.nn", "np": "numpy", "numpy": "numpy",
}  # fmt: skip
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
        functions: its functions, the main one last.
        constants: the module's and the classes' constants by name, in their order.
        modules: dotted path for each name that stands for a module or for something imported from one.
    """

    functions: tuple[ast.FunctionDef, ...]
    constants: dict[str, Assignment]
    modules: dict[str, str]

    @property
    def main(self) -> ast.FunctionDef:
        """The function itself."""
        return self.functions[-1]

    @cached_property
    def tree(self) -> ast.Module:
        """The constants, then the functions."""
        return ast.Module(body=[*self.constants.values(), *self.functions], type_ignores=[])

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
    constants: dict[str, Assignment] = {}
    modules = dict(DEFAULT_MODULES)
    tree = parse_source(text)
    for node in tree.body:
        if isinstance(node, ast.FunctionDef):
            if node.decorator_list:
                raise CodeError("static", "decorators are not allowed in a stored function", node.lineno)
            functions.pop(node.name, None)
            functions[node.name] = node
        elif isinstance(node, Assignment) and constant_of(node)[0]:
            name, value = constant_of(node)
            if name in _OF_EVERY_TASK:
                continue
            if value is None or not is_constant(value, constants):
                raise CodeError("static", f"the constant {name} is not computed from numbers alone", node.lineno)
            constants.pop(name, None)
            constants[name] = node
        elif not isinstance(node, Import):
            raise CodeError("static", f"a {type(node).__name__} statement is not allowed beside functions", node.lineno)
    if not functions:
        raise CodeError("extract", "expected a function, found none")
    for inner in ast.walk(tree):
        if isinstance(inner, Import):
            modules.update(import_names(inner))
    return Source(tuple(functions.values()), constants, modules)


def constant_of(node: ast.stmt) -> tuple[str, ast.expr | None]:
    """Returns the name and the value of an assignment to one name, an empty name for any other statement."""
    match node:
        case (
            ast.Assign(targets=[ast.Name(id=name)], value=value) | ast.AnnAssign(target=ast.Name(id=name), value=value)
        ):
            return (name, value) if value is not None else ("", None)
    return "", None


def is_constant(value: ast.expr, known: Container[str]) -> bool:
    """Whether a value beside the functions may be offered to them: written out, or computed from constants that are known.

    That is its form alone: where it is used it is held against the same lists as the function.
    """
    for node in ast.walk(value) if not is_class(value) else ():
        match node:
            case ast.Name(id=name) if name not in _OFFERED and name not in known:
                return False
            case ast.Attribute(value=owner) if not isinstance(owner, ast.Name):
                return False
            case ast.Call(func=called) if not isinstance(called, ast.Name | ast.Attribute):
                return False
        if not isinstance(node, _NODES):
            return False
    return True


def is_class(value: ast.expr) -> bool:
    """Whether a value is a class, by its capital letter, or made of one without arguments."""
    made = value.func if isinstance(value, ast.Call) and not value.args and not value.keywords else value
    return isinstance(made, ast.Name) and made.id[:1].isupper() and not made.id.isupper()


def import_names(node: Import) -> dict[str, str]:
    """Returns what an import line would bind of torch, math and numpy: local name to dotted path. Nothing is imported.

    Raises:
        CodeError: the module is not one of `MODULES`.
    """
    names = {}
    module = "." * node.level + (node.module or "") if isinstance(node, ast.ImportFrom) else ""
    for alias in node.names:
        path = f"{module}.{alias.name}" if module else alias.name
        root = path.split(".")[0]
        if root not in MODULES:
            message = f"the import of {module or path} is not allowed; only torch, math and typing are offered"
            raise CodeError("static", message, node.lineno)
        if root in ("torch", "math", "numpy") and alias.name != "*":
            is_whole = module or alias.asname
            names[alias.asname or (alias.name if module else root)] = path if is_whole else root
    return names


def all_arguments(function: ast.FunctionDef) -> list[ast.arg]:
    """Returns the arguments of a function but `self`, in order."""
    arguments = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    return arguments[1:] if arguments and arguments[0].arg == "self" else arguments


def takes_self(function: ast.FunctionDef) -> bool:
    """Whether `self` is a function's first argument."""
    return bool(function.args.args) and function.args.args[0].arg == "self"


def defaults(function: ast.FunctionDef) -> dict[str, ast.expr]:
    """Returns the default values of arguments by name."""
    given = function.args
    found = dict(zip([a.arg for a in [*given.posonlyargs, *given.args]][::-1], given.defaults[::-1], strict=False))
    pairs = zip(given.kwonlyargs, given.kw_defaults, strict=True)
    return found | {a.arg: value for a, value in pairs if value is not None}
