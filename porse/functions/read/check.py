"""The static check: every node, name, attribute and literal of the syntax tree against the allow-list.

It stands before Python runs a function, in a confined process. What it lets through is ordinary Python on tensors; it keeps
out what would reach for the inside of objects, and tells a model early and at the right line what is not offered.
"""

import ast
import difflib
import re
from collections.abc import Collection, Iterable
from typing import NoReturn

from porse.functions.contract import ATTRIBUTES, BUILTINS, ERRORS, HELPERS, MAX_INTEGER, MAX_LOOP, METHODS
from porse.functions.read.extract import Source, arguments, takes_self
from porse.functions.read.runnable import is_module, offered
from porse.functions.verdict import Check, CodeError, words
from porse.helpers import HELPERS_IN_SCOPE

_PLAIN = (
    ast.Return, ast.Assign, ast.AugAssign, ast.If, ast.For, ast.Pass, ast.Break, ast.Continue, ast.Assert, ast.Delete,
    ast.Slice, ast.UnaryOp, ast.BinOp, ast.BoolOp, ast.Compare, ast.IfExp, ast.List, ast.Tuple, ast.Dict, ast.Set, ast.Lambda,
    ast.ListComp, ast.SetComp, ast.GeneratorExp, ast.DictComp, ast.comprehension, ast.JoinedStr, ast.FormattedValue,
    ast.Starred, ast.NamedExpr, ast.Subscript, ast.Nonlocal, ast.expr_context, ast.operator, ast.unaryop, ast.boolop, ast.cmpop,
    ast.Call, ast.keyword, ast.arguments, ast.Import, ast.ImportFrom, ast.alias,
)  # fmt: skip
"""Nodes that may be there; some have a rule of their own in `_Visitor`."""
_REASONS: dict[type[ast.AST], str] = {
    ast.While: "while loops are not allowed, since they may never end; use tensor operations or for over range",
    ast.ClassDef: "classes are not allowed",
    ast.Try: "try is not allowed; guard with torch.where or clamp",
    ast.Raise: "raise is not allowed, but for an error with a text",
    ast.Global: "global is not allowed",
}
_RANDOM = words("torch.rand torch.randn torch.rand_like torch.randn_like torch.randint torch.randperm")
_DEVICES = ("cuda", "cpu", "mps", "xpu", "meta", "hpu")
_KEYWORDS = words("out names generator pin_memory memory_format layout")
_ANNOTATION = (ast.Name, ast.Attribute, ast.Subscript, ast.Tuple, ast.List, ast.BinOp, ast.Constant)


def check_source(source: Source, variables: Collection[str]) -> None:
    """Holds all of a source against the allow-list, and of the task's variables.

    Raises:
        CodeError: something is not on the list; checks "static", "variable" and "device".
    """
    given = source.main.args
    if given.vararg or given.kwarg:
        _refuse("arguments with * or ** are not allowed; name the variables", source.main)
    required = {name for name, default in arguments(source.main).items() if default is None} - {"self"}
    for argument in ast.walk(given):
        if isinstance(argument, ast.arg) and argument.arg in required.difference(variables):
            raise _unknown_variable(argument.arg, variables, argument.lineno)
    for statement in source.tree.body:
        _Visitor(source, variables, statement).visit(statement)


def _refuse(message: str, node: ast.AST, check: Check = "static") -> NoReturn:
    raise CodeError(check, message, getattr(node, "lineno", 0))


def _nearest(name: str, known: Iterable[str]) -> str:
    """Returns the known names that look like `name`, nearest first, "" for none."""
    return ", ".join(difflib.get_close_matches(name, sorted(known), n=4, cutoff=0.5))


def _unknown_variable(name: str, variables: Collection[str], line: int) -> CodeError:
    """Returns the error for a name that the task does not offer."""
    near = _nearest(name, variables)
    hint = f"the nearest are {near}" if near else f"it offers {', '.join(sorted(variables))}"
    return CodeError("variable", f"expected variables of the task, found {name}, which it does not offer; {hint}", line)


def _check_identifier(name: str, node: ast.AST) -> None:
    """Refuses names that are not plain, and those that this package writes itself."""
    if not name.isascii() or name.startswith(("__", "porse_")) or name in ("torch", "math"):
        _refuse(f"the name {name!r} is not allowed here; use a plain ASCII name of your own", node)


def _check_annotation(node: ast.expr | None) -> None:
    """Accepts names of types; no annotation is ever evaluated, and what reads like code is refused so that it is seen."""
    for part in ast.walk(node) if node is not None else ():
        text = part.value if isinstance(part, ast.Constant) and isinstance(part.value, str) else ""
        is_type = isinstance(part, _ANNOTATION) or not isinstance(part, ast.expr)
        if not is_type or not re.fullmatch(r"[\w.,| \[\]]*", text):
            _refuse(f"{type(part).__name__} is not allowed in an annotation", part)


class _Visitor(ast.NodeVisitor):
    """Walks a constant or a function, those in it included."""

    def __init__(self, source: Source, variables: Collection[str], statement: ast.stmt) -> None:
        self._source = source
        self._variables = variables
        self._has_self = isinstance(statement, ast.FunctionDef) and takes_self(statement)
        self._own = {function.name for function in source.functions} | source.constants
        self._classes = source.classes if len(self._own) > 1 else set[str]()
        self._local: set[str] = set()
        for node in ast.walk(statement):
            match node:
                case ast.arg(name) | ast.Name(name, ast.Store()) | ast.FunctionDef(name) if name != "self":
                    self._local.add(name)

    def generic_visit(self, node: ast.AST) -> None:
        """Refuses what is not on the list, and goes on below what is."""
        if not isinstance(node, _PLAIN):
            _refuse(_REASONS.get(type(node), f"{type(node).__name__} is not allowed"), node)
        super().generic_visit(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        _check_identifier(node.name, node)
        if node.decorator_list:
            _refuse("a function has a decorator; it needs none", node)
        _check_annotation(node.returns)
        for part in [node.args, *node.body]:
            self.visit(part)

    def visit_arg(self, node: ast.arg) -> None:
        _check_identifier(node.arg, node)
        _check_annotation(node.annotation)

    def visit_Expr(self, node: ast.Expr) -> None:
        if not isinstance(node.value, ast.Constant):  # a docstring
            self.visit(node.value)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        _check_annotation(node.annotation)
        for part in filter(None, (node.target, node.value)):
            self.visit(part)

    def visit_With(self, node: ast.With) -> None:
        for item in node.items:
            path = self._path(getattr(item.context_expr, "func", item.context_expr))
            if path not in ("torch.no_grad", "torch.inference_mode") or item.optional_vars:
                _refuse("with is not allowed", node)
        for statement in node.body:
            self.visit(statement)

    def visit_Raise(self, node: ast.Raise) -> None:
        match node:
            case ast.Raise(ast.Call(ast.Name(name), given, []), None) if name in ERRORS:
                for part in given:
                    self.visit(part)
            case _:
                _refuse(_REASONS[ast.Raise], node)

    def visit_Constant(self, node: ast.Constant) -> None:
        """Refuses odd and huge literals, and devices."""
        match node.value:
            case bytes() | complex():
                _refuse(f"a {type(node.value).__name__} constant is not allowed", node)
            case int(number) if abs(number) > MAX_INTEGER:
                _refuse(f"an integer constant is larger than {MAX_INTEGER}", node)
            case str(text) if text.split(":")[0].strip().lower() in _DEVICES:
                message = f"the device {text!r} is written into the code; use the device of an input, x.device"
                _refuse(message, node, "device")

    def visit_Name(self, node: ast.Name) -> None:
        name, is_read = node.id, isinstance(node.ctx, ast.Load)
        path = self._source.modules.get(name, "")
        if name == "self" and not isinstance(node.ctx, ast.Store):
            if not self._has_self:
                _refuse("self is read, but is not the first argument", node)
        elif name in self._local or not is_read:
            _check_identifier(name, node)
        elif name in self._own:
            return
        elif is_module(offered(path)):
            _refuse(f"the module {name} stands alone; name a function of it", node)
        elif path:
            self._check_path(path, node)
        elif name not in {*self._variables, *BUILTINS, *HELPERS_IN_SCOPE, "getattr", *self._classes}:
            near = _nearest(name, {*self._variables, *self._local, *BUILTINS, *HELPERS})
            hint = f"; the nearest known names are {near}" if near else ""
            _refuse(f"the name {name} is not defined and not allowed{hint}", node, "variable")

    def _check_path(self, path: str, node: ast.expr) -> None:
        if offered(path) is None or is_module(offered(path)):
            _refuse(f"{path} is not on the list of allowed functions", node)

    def visit_Attribute(self, node: ast.Attribute) -> None:
        if not isinstance(node.ctx, ast.Load):
            _refuse(f"the attribute .{node.attr} cannot be assigned", node)
        if isinstance(node.value, ast.Name) and node.value.id == "self":
            self.visit(node.value)
            if node.attr not in {*self._variables, *self._own, *HELPERS_IN_SCOPE}:
                raise _unknown_variable(node.attr, self._variables, node.lineno)
        elif path := self._path(node):
            self._check_path(path, node)
        elif node.attr in ("cuda", "cpu"):
            _refuse(f".{node.attr}() is not allowed: keep tensors on the inputs' device", node, "device")
        elif node.attr not in {*ATTRIBUTES, *METHODS, *self._own}:
            _refuse(f"the attribute .{node.attr} is not on the list of allowed methods", node)
        else:
            self.visit(node.value)

    def visit_Call(self, node: ast.Call) -> None:
        path = self._path(node.func)
        if path in _RANDOM:
            _refuse(f"{path} is not allowed: there are no random draws", node)
        if path == "torch.jit.annotate" and len(node.args) == 2 and not node.keywords:
            _check_annotation(node.args[0])
            self.visit(node.args[1])
            return
        self.generic_visit(node)
        if isinstance(node.func, ast.Name) and node.func.id == "range":
            for part in ast.walk(node):
                if isinstance(part, ast.Constant) and isinstance(part.value, int) and abs(part.value) > MAX_LOOP:
                    _refuse(f"a loop of more than {MAX_LOOP} rounds is not allowed", node)

    def visit_keyword(self, node: ast.keyword) -> None:
        """Refuses keywords that would write somewhere, or that have no meaning in a reward."""
        if node.arg is None:
            _refuse("** in a call is not allowed", node)
        if node.arg in _KEYWORDS or not node.arg.isascii():
            _refuse(f"the keyword {node.arg} is not allowed", node)
        self.visit(node.value)

    def _path(self, node: ast.expr) -> str:
        """Returns the dotted path of an attribute chain that starts at a module's name, "" for anything else."""
        match node:
            case ast.Name(name) if name not in self._local:
                return self._source.modules.get(name, "")
            case ast.Attribute(owner, name) if path := self._path(owner):
                return f"{path}.{name}"
        return ""
