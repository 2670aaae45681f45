"""The static check: every node, name, attribute and literal of the syntax tree against the allow-list.

It also finds what a function reads: task variables as arguments, as `self.<name>` or by their bare names, and helpers.
"""

import ast
import re
from collections.abc import Mapping
from dataclasses import dataclass

from porse.code.allowed import (
    check_identifier,
    check_keyword,
    check_literal,
    check_range,
    check_text,
    is_text,
    path_allowed,
    unknown_name,
    unknown_variable,
)
from porse.code.annotations import check_annotation
from porse.code.contract import ATTRIBUTES, BUILTINS, METHODS
from porse.code.hoist import number_type
from porse.code.prelude import HELPER_SOURCES
from porse.code.program import Program
from porse.code.syntax import all_arguments, defaults, local_names, module_path, modules_of
from porse.code.verdict import CodeError
from porse.variables import Variable

_PLAIN = (
    ast.Return, ast.Assign, ast.AugAssign, ast.If, ast.Pass, ast.Break, ast.Continue, ast.Assert, ast.Delete,
    ast.Slice, ast.UnaryOp, ast.BoolOp, ast.Compare, ast.IfExp, ast.List, ast.Tuple, ast.Dict, ast.Set,
    ast.ListComp, ast.GeneratorExp, ast.DictComp, ast.comprehension, ast.JoinedStr, ast.expr_context, ast.operator,
    ast.unaryop, ast.boolop, ast.cmpop,
)  # fmt: skip
"""Nodes that need no rule of their own; the others have a method of `_FunctionCheck`, or are refused."""
_REASONS: dict[type[ast.AST], str] = {
    ast.While: "while loops are not allowed, since they may never end; use tensor operations or for over range",
    ast.Lambda: "a lambda without a name is not allowed; write a local function",
    ast.FunctionDef: "a function can stand only directly in the function's body or beside it",
    ast.ClassDef: "classes are not allowed",
    ast.Try: "try is not allowed; guard with torch.where or clamp",
    ast.Raise: "raise is not allowed, but for an error with a text",
    ast.Global: "global is not allowed",
    ast.NamedExpr: "the := operator is not allowed",
}
_RANDOM = frozenset(f"torch.{name}" for name in ("rand", "randn", "rand_like", "randn_like", "randint", "randperm"))


@dataclass(frozen=True)
class Reads:
    """What one function reads.

    Attributes:
        variables: task variables that it reads without declaring them as arguments.
        helpers: functions of the program that it calls.
    """

    variables: frozenset[str]
    helpers: frozenset[str]


def check_program(program: Program, variables: Mapping[str, Variable]) -> dict[str, Reads]:
    """Returns what each function of the program reads, after holding all of it against the allow-list.

    Raises:
        CodeError: something is not on the list; checks "static", "variable" and "device".
    """
    functions = {**program.helpers, program.main.name: program.main}
    reads = {name: _FunctionCheck(program, f, variables).run() for name, f in functions.items()}
    _refuse_recursion(reads, functions)
    return reads


def _refuse_recursion(reads: Mapping[str, Reads], functions: Mapping[str, ast.FunctionDef]) -> None:
    """Refuses functions that call each other in a circle."""
    done: set[str] = set()
    while True:
        ready = [name for name in reads if name not in done and reads[name].helpers <= done]
        if not ready:
            break
        done.update(ready)
    for name in reads:
        if name not in done:
            raise CodeError("static", f"the function {name} calls itself, directly or not", functions[name].lineno)


class _FunctionCheck:
    """Walks one function; the walk keeps what the function reads."""

    def __init__(self, program: Program, function: ast.FunctionDef, variables: Mapping[str, Variable]) -> None:
        self._program = program
        self._function = function
        self._variables = variables
        self._modules = modules_of(program, function)
        self._local = local_names(function)
        self._read: set[str] = set()
        self._helpers: set[str] = set()

    def run(self) -> Reads:
        """Checks the whole function and returns what it reads."""
        self._head()
        for statement in self._function.body:
            self._visit(statement)
        return Reads(frozenset(self._read), frozenset(self._helpers))

    def _head(self) -> None:
        """Checks name, arguments, default values and annotations."""
        function = self._function
        check_identifier(function.name, function.lineno)
        if function.args.vararg or function.args.kwarg:
            raise CodeError("static", "arguments with * or ** are not allowed; name the variables", function.lineno)
        given = defaults(function)
        for name, value in given.items():
            is_plain = isinstance(value, ast.Constant) or number_type(value)
            if not is_plain and not (isinstance(value, ast.Tuple) and all(map(number_type, value.elts))):
                raise CodeError("static", f"the default value of {name} is not a plain constant", value.lineno)
            self._visit(value)
        for argument in all_arguments(function):
            check_identifier(argument.arg, argument.lineno)
            if argument.annotation is not None:
                check_annotation(argument.annotation)
            is_main = function is self._program.main
            if is_main and argument.arg not in self._variables and not number_type(given.get(argument.arg)):
                raise unknown_variable(argument.arg, self._variables, argument.lineno)
        if function.returns is not None:
            check_annotation(function.returns)

    def _visit(self, node: ast.AST) -> None:
        """Checks one node and what is below it."""
        special = getattr(self, f"_{type(node).__name__.lower()}", None)
        if special is not None:
            special(node)
        elif isinstance(node, _PLAIN):
            self._below(node)
        else:
            line = getattr(node, "lineno", self._function.lineno)
            reason = next((text for kind, text in _REASONS.items() if isinstance(node, kind)), "")
            raise CodeError("static", reason or f"{type(node).__name__} is not allowed", line)

    def _below(self, node: ast.AST) -> None:
        for child in ast.iter_child_nodes(node):
            self._visit(child)

    def _expr(self, node: ast.Expr) -> None:
        """A statement that is a constant is a docstring: it is never written out."""
        if not isinstance(node.value, ast.Constant):
            self._visit(node.value)

    def _import(self, node: ast.Import) -> None:
        """Imports in the body were looked at when the modules were collected."""

    _importfrom = _import

    def _annassign(self, node: ast.AnnAssign) -> None:
        check_annotation(node.annotation)
        if not isinstance(node.target, ast.Name):
            raise CodeError("static", "only plain names can be annotated", node.lineno)
        self._visit(node.target)
        if node.value is not None:
            self._visit(node.value)

    def _with(self, node: ast.With) -> None:
        for item in node.items:
            path = module_path(getattr(item.context_expr, "func", item.context_expr), self._modules, self._local)
            if path not in ("torch.no_grad", "torch.inference_mode") or item.optional_vars:
                raise CodeError("static", "with is not allowed", node.lineno)
        for statement in node.body:
            self._visit(statement)

    def _raise(self, node: ast.Raise) -> None:
        """An error may be raised; which, and what it says, is left out."""
        name = getattr(node.exc.func, "id", "") if isinstance(node.exc, ast.Call) else ""
        if not isinstance(node.exc, ast.Call) or not re.fullmatch(r"\w*(Error|Exception)", name) or node.cause:
            raise CodeError("static", _REASONS[ast.Raise], node.lineno)
        for part in [*node.exc.args, *node.exc.keywords]:
            self._visit(part)

    def _for(self, node: ast.For) -> None:
        if node.orelse:
            raise CodeError("static", "else after for is not allowed", node.lineno)
        self._below(node)

    def _constant(self, node: ast.Constant) -> None:
        check_literal(node)
        if isinstance(node.value, str):
            check_text(node)

    def _formattedvalue(self, node: ast.FormattedValue) -> None:
        if node.format_spec is not None:
            raise CodeError("static", "format specifications in f-strings are not allowed", node.lineno)
        self._visit(node.value)

    def _subscript(self, node: ast.Subscript) -> None:
        if isinstance(node.slice, ast.Tuple) and not node.slice.elts:
            raise CodeError("static", "an empty index is not allowed", node.lineno)  # TorchScript crashes on it
        self._below(node)

    def _binop(self, node: ast.BinOp) -> None:
        sides = (node.left, node.right)
        if isinstance(node.op, ast.Mult | ast.Mod) and any(is_text(side) for side in sides):
            raise CodeError("static", "texts cannot be multiplied or formatted with %", node.lineno)
        self._below(node)

    def _name(self, node: ast.Name) -> None:
        name = node.id
        if name in self._local:
            check_identifier(name, node.lineno)
        elif name in self._variables:
            self._read.add(name)
        elif name in self._modules and path_allowed(self._modules[name]):
            return
        elif name == self._program.main.name:
            raise CodeError("static", f"the function {name} calls itself", node.lineno)
        else:
            raise unknown_name(name, self._variables, self._local, node.lineno)

    def _attribute(self, node: ast.Attribute) -> None:
        if isinstance(node.ctx, ast.Store | ast.Del):
            raise CodeError("static", f"the attribute .{node.attr} cannot be assigned", node.lineno)
        if isinstance(node.value, ast.Name) and node.value.id == "self" and "self" not in self._local:
            self._check_self(node)
            if node.attr in self._variables:
                self._read.add(node.attr)
            else:
                raise unknown_variable(node.attr, self._variables, node.lineno)
            return
        path = module_path(node, self._modules, self._local)
        if path and not path_allowed(path):
            raise CodeError("static", f"{path} is not on the list of allowed functions", node.lineno)
        if not path and node.attr not in ATTRIBUTES and node.attr not in METHODS:
            raise CodeError("static", f"the attribute .{node.attr} is not on the list of allowed methods", node.lineno)
        if not path:
            self._visit(node.value)

    def _check_self(self, node: ast.Attribute) -> None:
        arguments = self._function.args.args
        if not arguments or arguments[0].arg != "self":
            raise CodeError("static", "self is read, but is not the first argument", node.lineno)

    def _call(self, node: ast.Call) -> None:
        path = module_path(node.func, self._modules, self._local)
        if path in _RANDOM:
            raise CodeError("static", f"{path} is not allowed: there are no random draws", node.lineno)
        if path == "torch.jit.annotate" and len(node.args) == 2 and not node.keywords:
            check_annotation(node.args[0])
            self._visit(node.args[1])
            return
        self._called(node.func)
        for argument in node.args:
            if isinstance(argument, ast.Starred):
                raise CodeError("static", "* in a call is not allowed", node.lineno)
            self._visit(argument)
        for keyword in node.keywords:
            check_keyword(keyword)
            self._visit(keyword.value)
        if isinstance(node.func, ast.Name) and node.func.id == "range":
            check_range(node)

    def _called(self, function: ast.expr) -> None:
        """Checks what stands before the brackets of a call: only there may functions of the program stand."""
        if isinstance(function, ast.Name) and function.id not in self._local:
            if function.id in self._program.helpers:
                self._helpers.add(function.id)
                return
            if function.id in BUILTINS or function.id in HELPER_SOURCES:
                return
        elif isinstance(function, ast.Attribute):
            owner = function.value
            if isinstance(owner, ast.Name) and owner.id == "self" and "self" not in self._local:
                self._check_self(function)
                if function.attr in self._program.helpers:
                    self._helpers.add(function.attr)
                    return
                if function.attr in HELPER_SOURCES:
                    return
            elif function.attr in ("cuda", "cpu") and not module_path(function, self._modules, self._local):
                message = f".{function.attr}() is not allowed: keep tensors on the inputs' device"
                raise CodeError("device", message, function.lineno)
        elif not isinstance(function, ast.Name):
            raise CodeError("static", "only named functions and methods can be called", function.lineno)
        self._visit(function)
