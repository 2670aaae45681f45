"""The stored source of a function: main function, helpers, constants, and the names of modules. Nothing of it is run here."""

import ast
import warnings
from collections.abc import Container
from dataclasses import dataclass

from porse.functions.contract import MAX_TREE_DEPTH, MAX_TREE_NODES, MODULES
from porse.functions.verdict import CodeError, words

Import = ast.Import | ast.ImportFrom

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
        tree: its constants and functions, in their order; the main function comes last.
        functions: the functions.
        constants: the names of the module's and the classes' constants.
        modules: dotted path for each name that stands for a module or for something imported from one.
        classes: the names that are read as classes.
    """

    tree: ast.Module
    functions: list[ast.FunctionDef]
    constants: set[str]
    modules: dict[str, str]
    classes: set[str]

    @property
    def main(self) -> ast.FunctionDef:
        """The function itself."""
        return self.functions[-1]

    @property
    def last_line(self) -> int:
        """The line of the last return of the main function."""
        lines = (node.lineno for node in ast.walk(self.main) if isinstance(node, ast.Return))
        return max(lines, default=self.main.lineno)


def parse_source(text: str) -> ast.Module:
    """Returns the syntax tree of a text, at most so large and so deep.

    Raises:
        CodeError: it is no Python, or too large; check "syntax" with the line of the text.
    """
    hidden = next((c for c in text if c != "\n" and not c.isprintable()), "")
    if hidden:
        line = text[: text.index(hidden)].count("\n") + 1
        raise CodeError("syntax", f"the code holds the invisible character U+{ord(hidden):04X}; write plain text", line)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(text)
    except SyntaxError as error:
        raise CodeError("syntax", f"{error.msg}: {(error.text or '').strip()[:200]}", error.lineno or 1) from None
    except (ValueError, RecursionError, MemoryError):
        raise CodeError("syntax", "it is too deeply nested, or holds a null character", 1) from None
    count = 0
    rest: list[tuple[ast.AST, int]] = [(tree, 0)]
    while rest:  # without recursion, which could go too deep itself
        node, depth = rest.pop()
        count += 1
        if count > MAX_TREE_NODES or depth > MAX_TREE_DEPTH:
            raise CodeError("syntax", "the code is too large or too deeply nested", getattr(node, "lineno", 1))
        rest += [(child, depth + 1) for child in ast.iter_child_nodes(node)]
    return tree


def parse(text: str) -> Source:
    """Returns the parts of a source.

    Raises:
        CodeError: it holds anything but imports of allowed modules, constants and functions.
    """
    tree = parse_source(text)
    body: list[ast.stmt] = []
    constants: set[str] = set()
    for node in tree.body:
        name, value = constant_of(node)
        if value is not None:
            if name in _OF_EVERY_TASK:
                continue
            if not is_constant(value, constants):
                raise CodeError("static", f"the constant {name} is not computed from numbers alone", node.lineno)
            constants.add(name)
        elif not isinstance(node, ast.FunctionDef | Import):
            raise CodeError("static", f"a {type(node).__name__} statement is not allowed beside functions", node.lineno)
        body.append(node)
    functions = [node for node in body if isinstance(node, ast.FunctionDef)]
    if not functions:
        raise CodeError("extract", "expected a function, found none")
    modules, classes = dict(DEFAULT_MODULES), set[str]()
    for inner in ast.walk(tree):
        if isinstance(inner, Import):
            modules.update(import_names(inner))
        elif isinstance(inner, ast.Name) and is_class(inner):
            classes.add(inner.id)
    return Source(ast.Module(body, []), functions, constants, modules, classes)


def constant_of(node: ast.stmt | None) -> tuple[str, ast.expr | None]:
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


def arguments(function: ast.FunctionDef) -> dict[str, ast.expr | None]:
    """Returns the arguments of a function by name, each with its default; `self` is one of them."""
    given = function.args
    names = [argument.arg for argument in [*given.posonlyargs, *given.args, *given.kwonlyargs]]
    required = len(given.posonlyargs) + len(given.args) - len(given.defaults)
    return dict(zip(names, [*[None] * required, *given.defaults, *given.kw_defaults], strict=True))


def takes_self(function: ast.FunctionDef) -> bool:
    """Whether `self` is a function's first argument."""
    return next(iter(arguments(function)), "") == "self"
