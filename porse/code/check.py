"""The static check: every node, name, attribute and literal of the syntax tree against the allow-list.

It also finds what a function reads: task variables as arguments, as `self.<name>` or by their bare names, and helpers.
"""

import ast
import difflib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from porse.code.contract import (
    ATTRIBUTES,
    BUILTINS,
    HELPERS,
    MATH_NAMES,
    MAX_INTEGER,
    MAX_LOOP,
    METHODS,
    TORCH_CONSTANTS,
    TORCH_FUNCTIONS,
    TORCH_MODULES,
)
from porse.code.prelude import HELPER_SOURCES
from porse.code.program import Program, import_names
from porse.code.verdict import CodeError
from porse.variables import Variable

_STATEMENTS = (
    ast.Return, ast.Assign, ast.AugAssign, ast.AnnAssign, ast.For, ast.If, ast.Expr, ast.Pass, ast.Break, ast.Continue,
    ast.Assert, ast.Import, ast.ImportFrom, ast.With, ast.Delete,
)  # fmt: skip
_EXPRESSIONS = (
    ast.Constant, ast.Name, ast.Attribute, ast.Subscript, ast.Slice, ast.Call, ast.BinOp, ast.UnaryOp, ast.BoolOp,
    ast.Compare, ast.IfExp, ast.List, ast.Tuple, ast.Dict, ast.Set, ast.ListComp, ast.GeneratorExp, ast.DictComp,
    ast.JoinedStr, ast.FormattedValue, ast.Starred,
)  # fmt: skip
_REASONS: dict[type[ast.AST], str] = {
    ast.While: "while loops are not allowed, since they may never end; use tensor operations or for over range",
    ast.Lambda: "a lambda without a name is not allowed; write a local function",
    ast.FunctionDef: "a function can stand only directly in the function's body or beside it",
    ast.ClassDef: "classes are not allowed",
    ast.Try: "try is not allowed; guard with torch.where or clamp",
    ast.Raise: "raise is not allowed",
    ast.Global: "global is not allowed",
    ast.NamedExpr: "the := operator is not allowed",
}
_TYPES = frozenset(
    "Tensor FloatTensor LongTensor BoolTensor int float bool str device List list Tuple tuple Dict dict Optional Union "
    "Any torch typing None Final Sequence jit".split()
)
_DEVICE_WORDS = ("cuda", "cpu", "mps", "xpu", "meta", "hpu")


@dataclass(frozen=True)
class Reads:
    """What one function reads.

    Attributes:
        variables: task variables that it reads without declaring them as arguments.
        helpers: functions of the program that it calls.
        constants: module-level constants that it reads.
    """

    variables: frozenset[str]
    helpers: frozenset[str]
    constants: frozenset[str]


def module_path(node: ast.expr, modules: Mapping[str, str], local: Iterable[str]) -> str:
    """Returns the dotted path of an attribute chain that starts at a module's name, "" for anything else."""
    names: list[str] = []
    while isinstance(node, ast.Attribute):
        names.insert(0, node.attr)
        node = node.value
    if isinstance(node, ast.Name) and node.id in modules and node.id not in local:
        return ".".join([modules[node.id], *names])
    return ""


def path_allowed(path: str) -> bool:
    """Whether a dotted path below torch, math or numpy may be used."""
    if path.startswith("numpy."):
        return path in ("numpy.pi", "numpy.inf", "numpy.e", "numpy.nan")
    module, _, name = path.rpartition(".")
    if module == "math":
        return name in MATH_NAMES
    if module == "torch":
        return name in TORCH_FUNCTIONS or name in TORCH_CONSTANTS
    return module.startswith("torch.") and name in TORCH_MODULES.get(module.removeprefix("torch."), ())


def check_program(program: Program, variables: Mapping[str, Variable]) -> dict[str, Reads]:
    """Returns what each function of the program reads, after holding all of it against the allow-list.

    Raises:
        CodeError: something is not on the list; checks "static", "variable" and "device".
    """
    for name, value in program.constants.items():
        _check_literal(name, value)
    functions = {**program.helpers, program.main.name: program.main}
    reads = {name: _FunctionCheck(program, f, variables).run() for name, f in functions.items()}
    _refuse_recursion(reads, functions)
    return reads


def _check_literal(name: str, value: ast.expr) -> None:
    allowed = (ast.Constant, ast.UnaryOp, ast.USub, ast.List, ast.Tuple, ast.Load, ast.BinOp, ast.Add, ast.Sub, ast.Mult, ast.Div)
    for node in ast.walk(value):
        if not isinstance(node, allowed):
            raise CodeError("static", f"the constant {name} is not a plain number", value.lineno)
        _check_number(node)


def _check_number(node: ast.AST) -> None:
    if not isinstance(node, ast.Constant):
        return
    if isinstance(node.value, bytes | complex):
        raise CodeError("static", f"a {type(node.value).__name__} constant is not allowed", node.lineno)
    if isinstance(node.value, int) and abs(node.value) > MAX_INTEGER:
        raise CodeError("static", f"an integer constant is larger than {MAX_INTEGER}", node.lineno)


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


def local_names(function: ast.FunctionDef) -> set[str]:
    """Returns the arguments of a function and every name that it binds."""
    bound = {argument.arg for argument in all_arguments(function)}
    bound.update(n.id for n in ast.walk(function) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store))
    return bound


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


class _FunctionCheck:
    """Walks one function; the walk keeps what the function reads."""

    def __init__(self, program: Program, function: ast.FunctionDef, variables: Mapping[str, Variable]) -> None:
        self.program = program
        self.function = function
        self.variables = variables
        self.modules = dict(program.modules)
        for node in ast.walk(function):
            if isinstance(node, ast.Import | ast.ImportFrom):
                self.modules.update(import_names(node))
        self.local = local_names(function)
        self.read: set[str] = set()
        self.helpers: set[str] = set()
        self.constants: set[str] = set()

    def run(self) -> Reads:
        self._arguments()
        for statement in self.function.body:
            self._visit(statement)
        return Reads(frozenset(self.read), frozenset(self.helpers), frozenset(self.constants))

    def _arguments(self) -> None:
        function, arguments = self.function, self.function.args
        if arguments.vararg or arguments.kwarg:
            raise CodeError("static", "arguments with * or ** are not allowed; name the variables", function.lineno)
        given = defaults(function)
        for argument in all_arguments(function):
            self._identifier(argument.arg, argument.lineno)
            if argument.annotation is not None:
                _check_annotation(argument.annotation)
        for name, value in given.items():
            if not isinstance(_unsigned(value), ast.Constant):
                raise CodeError("static", f"the default value of {name} is not a plain constant", value.lineno)
            _check_number(_unsigned(value))
        if function.returns is not None:
            _check_annotation(function.returns)
        if function is self.program.main:
            for argument in all_arguments(function):
                if argument.arg not in self.variables and not _is_number(given.get(argument.arg)):
                    raise unknown_variable(argument.arg, self.variables, argument.lineno)

    def _visit(self, node: ast.AST) -> None:
        if isinstance(node, ast.expr_context | ast.operator | ast.unaryop | ast.boolop | ast.cmpop | ast.withitem):
            for child in ast.iter_child_nodes(node):
                self._visit(child)
            return
        if isinstance(node, ast.keyword):
            if node.arg is None:
                raise CodeError("static", "** in a call is not allowed", node.lineno)
            self._keyword(node)
        elif isinstance(node, ast.comprehension):
            if node.is_async:
                raise CodeError("static", "async is not allowed", self.function.lineno)
        elif not isinstance(node, _STATEMENTS + _EXPRESSIONS):
            line = getattr(node, "lineno", self.function.lineno)
            reason = next((text for kind, text in _REASONS.items() if isinstance(node, kind)), "")
            raise CodeError("static", reason or f"{type(node).__name__} is not allowed", line)
        if self._special(node):
            return
        for child in ast.iter_child_nodes(node):
            self._visit(child)

    def _special(self, node: ast.AST) -> bool:
        """Checks a node with rules of its own; returns whether its children are done too."""
        if isinstance(node, ast.AnnAssign):
            _check_annotation(node.annotation)
            if not isinstance(node.target, ast.Name):
                raise CodeError("static", "only plain names can be annotated", node.lineno)
            if node.value is not None:
                self._visit(node.value)
            return True
        if isinstance(node, ast.With):
            for item in node.items:
                path = module_path(getattr(item.context_expr, "func", item.context_expr), self.modules, self.local)
                if path not in ("torch.no_grad", "torch.inference_mode") or item.optional_vars:
                    raise CodeError("static", "with is not allowed", node.lineno)
            for statement in node.body:
                self._visit(statement)
            return True
        if isinstance(node, ast.Constant):
            _check_number(node)
            if isinstance(node.value, str):
                self._string(node)
        elif isinstance(node, ast.Name):
            self._name(node)
        elif isinstance(node, ast.Attribute):
            return self._attribute(node)
        elif isinstance(node, ast.Call):
            return self._call(node)
        elif isinstance(node, ast.For):
            self._for(node)
        elif isinstance(node, ast.FormattedValue) and node.format_spec is not None:
            raise CodeError("static", "format specifications in f-strings are not allowed", node.lineno)
        return isinstance(node, ast.Import | ast.ImportFrom)

    def _identifier(self, name: str, line: int) -> None:
        if not name.isascii() or name.startswith(("__", "porse_")):
            raise CodeError("static", f"the name {name!r} is not allowed; use plain ASCII names", line)

    def _string(self, node: ast.Constant) -> None:
        words = str(node.value).split(":")[0].strip().lower()
        if words in _DEVICE_WORDS:
            raise CodeError(
                "device", f"the device {node.value!r} is written into the code; use the device of an input, x.device", node.lineno
            )

    def _name(self, node: ast.Name) -> None:
        name = node.id
        if isinstance(node.ctx, ast.Store):
            self._identifier(name, node.lineno)
            return
        if name in self.local:
            self._identifier(name, node.lineno)
        elif name in self.program.helpers:
            self.helpers.add(name)
        elif name in self.program.constants:
            self.constants.add(name)
        elif name in self.variables:
            self.read.add(name)
        elif name in self.modules:
            path = self.modules[name]
            if not path_allowed(path):
                raise CodeError("static", f"{path} cannot be used like this", node.lineno)
        elif name == self.program.main.name:
            raise CodeError("static", f"the function {name} calls itself", node.lineno)
        elif name not in BUILTINS and name not in HELPER_SOURCES:
            raise unknown_name(name, self.variables, self.local, node.lineno)

    def _attribute(self, node: ast.Attribute) -> bool:
        if isinstance(node.ctx, ast.Store):
            raise CodeError("static", f"the attribute .{node.attr} cannot be assigned", node.lineno)
        if isinstance(node.value, ast.Name) and node.value.id == "self" and "self" not in self.local:
            self._self(node)
            return True
        path = module_path(node, self.modules, self.local)
        if path:
            if not path_allowed(path):
                raise CodeError("static", f"{path} is not on the list of allowed functions", node.lineno)
            return True
        if node.attr not in ATTRIBUTES and node.attr not in METHODS:
            raise CodeError("static", f"the attribute .{node.attr} is not on the list of allowed methods", node.lineno)
        self._visit(node.value)
        return True

    def _self(self, node: ast.Attribute) -> None:
        if not self.function.args.args or self.function.args.args[0].arg != "self":
            raise CodeError("static", "self is read, but is not the first argument", node.lineno)
        if node.attr in self.variables:
            self.read.add(node.attr)
        elif node.attr in self.program.helpers:
            self.helpers.add(node.attr)
        elif node.attr not in HELPER_SOURCES:
            raise unknown_variable(node.attr, self.variables, node.lineno)

    def _call(self, node: ast.Call) -> bool:
        if any(isinstance(argument, ast.Starred) for argument in node.args):
            raise CodeError("static", "* in a call is not allowed", node.lineno)
        if not isinstance(node.func, ast.Name | ast.Attribute):
            raise CodeError("static", "only named functions and methods can be called", node.lineno)
        path = module_path(node.func, self.modules, self.local)
        if path in ("torch.rand", "torch.randn", "torch.rand_like", "torch.randn_like", "torch.randint", "torch.randperm"):
            raise CodeError("static", f"{path} is not allowed: a reward draws no random numbers", node.lineno)
        if isinstance(node.func, ast.Attribute) and node.func.attr in ("cuda", "cpu") and not path:
            raise CodeError("device", f".{node.func.attr}() is not allowed: keep tensors on the inputs' device", node.lineno)
        if path == "torch.jit.annotate" and len(node.args) == 2:
            _check_annotation(node.args[0])
            self._visit(node.args[1])
            return True
        return False

    def _keyword(self, node: ast.keyword) -> None:
        if node.arg in ("out", "names", "generator", "pin_memory", "memory_format", "layout"):
            raise CodeError("static", f"the keyword {node.arg} is not allowed", node.lineno)

    def _for(self, node: ast.For) -> None:
        if node.orelse:
            raise CodeError("static", "else after for is not allowed", node.lineno)
        calls = [n for n in ast.walk(node.iter) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name) and n.func.id == "range"]
        for call in calls:
            for argument in ast.walk(call):
                if isinstance(argument, ast.Constant) and isinstance(argument.value, int) and abs(argument.value) > MAX_LOOP:
                    raise CodeError("static", f"a loop of more than {MAX_LOOP} rounds is not allowed", node.lineno)
                if isinstance(argument, ast.BinOp) and isinstance(argument.op, ast.Mult | ast.Pow | ast.LShift):
                    raise CodeError("static", "the count of a range must be a plain number or a size", node.lineno)


def _unsigned(node: ast.expr) -> ast.expr:
    return node.operand if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) else node


def _is_number(node: ast.expr | None) -> bool:
    value = _unsigned(node) if node is not None else None
    return isinstance(value, ast.Constant) and isinstance(value.value, int | float)


def _check_annotation(node: ast.expr) -> None:
    """Refuses annotations that are more than names of types; they are never evaluated."""
    for part in ast.walk(node):
        if isinstance(part, ast.Name | ast.Attribute):
            name = part.id if isinstance(part, ast.Name) else part.attr
            if name not in _TYPES and name not in TORCH_CONSTANTS:
                raise CodeError("static", f"the type {name} is not allowed in an annotation", part.lineno)
        elif isinstance(part, ast.Constant):
            if isinstance(part.value, str):
                _check_annotation(_annotation_of_text(part))
            elif part.value is not None and part.value is not Ellipsis:
                raise CodeError("static", "a value is not allowed in an annotation", part.lineno)
        elif not isinstance(part, ast.Subscript | ast.Tuple | ast.BinOp | ast.BitOr | ast.Load | ast.List):
            raise CodeError("static", f"{type(part).__name__} is not allowed in an annotation", node.lineno)


def _annotation_of_text(node: ast.Constant) -> ast.expr:
    text = str(node.value)
    try:
        if '"' in text or "'" in text or len(text) > 200:
            raise ValueError
        tree = ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise CodeError("static", "an annotation is not a type", node.lineno) from None
    for part in ast.walk(tree):
        if hasattr(part, "lineno"):
            ast.copy_location(part, node)
    return tree


def nearest(name: str, known: Iterable[str]) -> Iterator[str]:
    """Yields the known names that look like `name`, nearest first."""
    yield from difflib.get_close_matches(name, sorted(known), n=4, cutoff=0.5)


def unknown_variable(name: str, variables: Mapping[str, Variable], line: int) -> CodeError:
    """Returns the error for a name that the task does not offer."""
    near = ", ".join(nearest(name, variables))
    hint = f"the nearest are {near}" if near else f"it offers {', '.join(sorted(variables))}"
    return CodeError("variable", f"expected variables of the task, found {name}, which it does not offer; {hint}", line)


def unknown_name(name: str, variables: Mapping[str, Variable], local: Iterable[str], line: int) -> CodeError:
    """Returns the error for a name that is neither a variable, nor bound, nor an allowed function."""
    near = ", ".join(nearest(name, {*variables, *local, *BUILTINS, *HELPERS}))
    hint = f"; the nearest known names are {near}" if near else ""
    return CodeError("variable", f"the name {name} is not defined and not allowed{hint}", line)
