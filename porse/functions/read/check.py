"""The static check: every node, name, attribute and literal of the syntax tree against the allow-list.

It stands before Python runs a function, in a confined process. What it lets through is ordinary Python on tensors; it keeps
out what would reach for the inside of objects, and tells a model early and at the right line what is not offered.
"""

import ast
import re
from collections.abc import Mapping

from porse.functions.contract import ATTRIBUTES, BUILTINS, METHODS
from porse.functions.read.allowed import (
    check_identifier,
    check_keyword,
    check_literal,
    check_range,
    check_text,
    path_allowed,
    unknown_name,
    unknown_variable,
)
from porse.functions.read.prelude import HELPERS_IN_SCOPE
from porse.functions.read.source import (
    Source,
    all_arguments,
    bound_names,
    defaults,
    is_class,
    module_path,
    takes_self,
)
from porse.functions.verdict import CodeError, words
from porse.variables import Variable

_PLAIN = (
    ast.Return, ast.Assign, ast.AugAssign, ast.If, ast.For, ast.Pass, ast.Break, ast.Continue, ast.Assert, ast.Delete,
    ast.Slice, ast.UnaryOp, ast.BinOp, ast.BoolOp, ast.Compare, ast.IfExp, ast.List, ast.Tuple, ast.Dict, ast.Set,
    ast.ListComp, ast.SetComp, ast.GeneratorExp, ast.DictComp, ast.comprehension, ast.JoinedStr, ast.FormattedValue,
    ast.Starred, ast.NamedExpr, ast.Subscript, ast.Nonlocal, ast.expr_context, ast.operator, ast.unaryop, ast.boolop, ast.cmpop,
)  # fmt: skip
"""Nodes that need no rule of their own; the others have a method of `_FunctionCheck`, or are refused."""
_REASONS: dict[type[ast.AST], str] = {
    ast.While: "while loops are not allowed, since they may never end; use tensor operations or for over range",
    ast.ClassDef: "classes are not allowed",
    ast.Try: "try is not allowed; guard with torch.where or clamp",
    ast.Raise: "raise is not allowed, but for an error with a text",
    ast.Global: "global is not allowed",
}
_RANDOM = frozenset(f"torch.{name}" for name in ("rand", "randn", "rand_like", "randn_like", "randint", "randperm"))
_ANNOTATION = (
    ast.Name, ast.Attribute, ast.Subscript, ast.Tuple, ast.List, ast.BinOp, ast.BitOr, ast.Constant, ast.Load,
)  # fmt: skip
_DEFAULT = (
    ast.Constant,
    ast.Tuple,
    ast.List,
    ast.UnaryOp,
    ast.unaryop,
    ast.BinOp,
    ast.operator,
    ast.Attribute,
    ast.Name,
    ast.Load,
)
ERRORS = words("Exception ArithmeticError AssertionError IndexError KeyError RuntimeError TypeError ValueError")
"""What may be raised."""


def check_source(source: Source, variables: Mapping[str, Variable]) -> None:
    """Holds all of a source against the allow-list.

    Raises:
        CodeError: something is not on the list; checks "static", "variable" and "device".
    """
    for name, constant in source.constants.items():
        check_identifier(name, constant.lineno)
        assert constant.value is not None  # a constant has a value
        _FunctionCheck(source, source.main, variables, bound=set()).visit(constant.value)
    calls = {}
    for function in source.functions:
        check = _FunctionCheck(source, function, variables, set(bound_names(function)))
        check.run()
        calls[function.name] = check.helpers
    _refuse_recursion(calls, source)


def _refuse_recursion(calls: Mapping[str, set[str]], source: Source) -> None:
    """Refuses functions that call each other in a circle."""
    done: set[str] = set()
    while ready := [name for name in calls if name not in done and calls[name] <= done]:
        done.update(ready)
    for function in source.functions:
        if function.name not in done:
            raise CodeError("static", f"the function {function.name} calls itself, directly or not", function.lineno)


def _check_annotation(node: ast.expr | None) -> None:
    """Accepts names of types; no annotation is ever evaluated, and what reads like code is refused so that it is seen."""
    for part in ast.walk(node) if node is not None else ():
        text = part.value if isinstance(part, ast.Constant) and isinstance(part.value, str) else ""
        if not isinstance(part, _ANNOTATION) or not re.fullmatch(r"[\w.,| \[\]]*", text):
            line = getattr(part, "lineno", node.lineno if node is not None else 0)
            raise CodeError("static", f"{type(part).__name__} is not allowed in an annotation", line)


class _FunctionCheck:
    """Walks one function, those in it included; the walk keeps which helpers it calls."""

    def __init__(
        self, source: Source, function: ast.FunctionDef, variables: Mapping[str, Variable], bound: set[str]
    ) -> None:
        self._source = source
        self._function = function
        self._variables = variables
        self._local = bound - {"self"}
        self._offered = source.helpers.keys() | source.constants.keys()
        self.helpers: set[str] = set()

    def run(self) -> None:
        """Checks the whole function."""
        function = self._function
        if function is self._source.main:
            if function.args.vararg or function.args.kwarg:
                message = "arguments with * or ** are not allowed; name the variables"
                raise CodeError("static", message, function.lineno)
            for argument in all_arguments(function):
                check_identifier(argument.arg, argument.lineno)
                if argument.arg not in self._variables and argument.arg not in defaults(function):
                    raise unknown_variable(argument.arg, self._variables, argument.lineno)
        self._functiondef(function)

    def visit(self, node: ast.AST) -> None:
        """Checks one node and what is below it."""
        special = getattr(self, f"_{type(node).__name__.lower()}", None)
        if special is not None:
            special(node)
        elif isinstance(node, _PLAIN):
            for child in ast.iter_child_nodes(node):
                self.visit(child)
        else:
            line = getattr(node, "lineno", self._function.lineno)
            reason = next((text for kind, text in _REASONS.items() if isinstance(node, kind)), "")
            raise CodeError("static", reason or f"{type(node).__name__} is not allowed", line)

    def _functiondef(self, node: ast.FunctionDef) -> None:
        check_identifier(node.name, node.lineno)
        if node.decorator_list:
            raise CodeError("static", "an inner function has a decorator; it needs none", node.lineno)
        self._arguments(node.args)
        _check_annotation(node.returns)
        for statement in node.body:
            self.visit(statement)

    def _lambda(self, node: ast.Lambda) -> None:
        self._arguments(node.args)
        self.visit(node.body)

    def _arguments(self, node: ast.arguments) -> None:
        for value in [*node.defaults, *(value for value in node.kw_defaults if value is not None)]:
            if not all(isinstance(part, _DEFAULT) for part in ast.walk(value)):
                raise CodeError("static", "the default value of an argument is not a plain constant", value.lineno)
            self.visit(value)
        for argument in [*node.posonlyargs, *node.args, *node.kwonlyargs, node.vararg, node.kwarg]:
            if argument is not None:
                check_identifier(argument.arg, argument.lineno)
                _check_annotation(argument.annotation)

    def _expr(self, node: ast.Expr) -> None:
        """A statement that is a constant is a docstring."""
        if not isinstance(node.value, ast.Constant):
            self.visit(node.value)

    def _import(self, node: ast.Import) -> None:
        """Imports in the body were looked at when the modules were collected."""

    _importfrom = _import

    def _annassign(self, node: ast.AnnAssign) -> None:
        _check_annotation(node.annotation)
        self.visit(node.target)
        if node.value is not None:
            self.visit(node.value)

    def _with(self, node: ast.With) -> None:
        for item in node.items:
            path = module_path(getattr(item.context_expr, "func", item.context_expr), self._source.modules, self._local)
            if path not in ("torch.no_grad", "torch.inference_mode") or item.optional_vars:
                raise CodeError("static", "with is not allowed", node.lineno)
        for statement in node.body:
            self.visit(statement)

    def _raise(self, node: ast.Raise) -> None:
        name = getattr(node.exc.func, "id", "") if isinstance(node.exc, ast.Call) else ""
        if not isinstance(node.exc, ast.Call) or name not in ERRORS or node.cause:
            raise CodeError("static", _REASONS[ast.Raise], node.lineno)
        for part in [*node.exc.args, *node.exc.keywords]:
            self.visit(part)

    def _constant(self, node: ast.Constant) -> None:
        check_literal(node)
        if isinstance(node.value, str):
            check_text(node)

    def _name(self, node: ast.Name) -> None:
        name, source = node.id, self._source
        if name == "self" and not isinstance(node.ctx, ast.Store):
            if not takes_self(self._function):
                raise CodeError("static", "self is read, but is not the first argument", node.lineno)
        elif name in self._local or not isinstance(node.ctx, ast.Load):
            check_identifier(name, node.lineno)
        elif name == source.main.name:
            raise CodeError("static", f"the function {name} calls itself", node.lineno)
        elif name in source.helpers:
            self.helpers.add(name)
        elif name in source.modules:
            if "." in source.modules[name] and not path_allowed(source.modules[name]):
                raise CodeError(
                    "static", f"{source.modules[name]} is not on the list of allowed functions", node.lineno
                )
            if source.modules[name] in ("torch", "math", "numpy", "torch.nn", "torch.nn.functional"):
                raise CodeError("static", f"the module {name} stands alone; name a function of it", node.lineno)
        elif name not in self._variables and name not in source.constants and not self._is_offered(name):
            raise unknown_name(name, self._variables, self._local, node.lineno)

    def _is_offered(self, name: str) -> bool:
        is_class_of_it = is_class(ast.Name(id=name, ctx=ast.Load())) and bool(self._offered)
        return name in BUILTINS or name in HELPERS_IN_SCOPE or name == "getattr" or is_class_of_it

    def _attribute(self, node: ast.Attribute) -> None:
        if isinstance(node.ctx, ast.Store | ast.Del):
            raise CodeError("static", f"the attribute .{node.attr} cannot be assigned", node.lineno)
        owner, source = node.value, self._source
        if isinstance(owner, ast.Name) and owner.id == "self" and "self" not in self._local:
            self.visit(owner)
            if node.attr in source.helpers:
                self.helpers.add(node.attr)
            elif not (node.attr in self._variables or node.attr in source.constants or node.attr in HELPERS_IN_SCOPE):
                raise unknown_variable(node.attr, self._variables, node.lineno)
            return
        path = module_path(node, source.modules, self._local)
        if path and not path_allowed(path):
            raise CodeError("static", f"{path} is not on the list of allowed functions", node.lineno)
        if path:
            return
        if node.attr in ("cuda", "cpu"):
            message = f".{node.attr}() is not allowed: keep tensors on the inputs' device"
            raise CodeError("device", message, node.lineno)
        if node.attr not in ATTRIBUTES and node.attr not in METHODS and node.attr not in self._offered:
            raise CodeError("static", f"the attribute .{node.attr} is not on the list of allowed methods", node.lineno)
        if node.attr in source.helpers and node.attr not in METHODS:
            self.helpers.add(node.attr)
        self.visit(owner)

    def _call(self, node: ast.Call) -> None:
        path = module_path(node.func, self._source.modules, self._local)
        if path in _RANDOM:
            raise CodeError("static", f"{path} is not allowed: there are no random draws", node.lineno)
        if path == "torch.jit.annotate" and len(node.args) == 2 and not node.keywords:
            _check_annotation(node.args[0])
            self.visit(node.args[1])
            return
        self.visit(node.func)
        for argument in node.args:
            self.visit(argument)
        for keyword in node.keywords:
            check_keyword(keyword)
            self.visit(keyword.value)
        if isinstance(node.func, ast.Name) and node.func.id == "range":
            check_range(node)
