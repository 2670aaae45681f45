"""Expressions as TorchScript text, in brackets wherever Python's precedence and TorchScript's could part."""

import ast
from collections.abc import Mapping
from functools import reduce
from itertools import groupby

from porse.code.annotations import type_text
from porse.code.calls import FUNCTIONAL, plain_form
from porse.functions.read.contract import NUMPY_NAMES
from porse.code.prelude import HELPER_SOURCES
from porse.code.program import Program
from porse.code.syntax import local_names, module_path, modules_of
from porse.functions.verdict import CodeError
from porse.variables import Variable

VARIABLE = "porse_"
"""Prefix of a task variable, and of a helper of ours, that the function reads without declaring it."""
FUNCTION = "porse_f_"
"""Prefix of the program's own functions."""

BINARY = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.FloorDiv: "//", ast.Mod: "%", ast.Pow: "**",
    ast.MatMult: "@", ast.BitAnd: "&", ast.BitOr: "|", ast.BitXor: "^", ast.LShift: "<<", ast.RShift: ">>",
}  # fmt: skip
_UNARY = {ast.USub: "-", ast.UAdd: "", ast.Not: "not ", ast.Invert: "~"}
_COMPARE = {
    ast.Eq: "==", ast.NotEq: "!=", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Is: "is",
    ast.IsNot: "is not", ast.In: "in", ast.NotIn: "not in",
}  # fmt: skip
_FACTORIES = frozenset(
    f"torch.{name}" for name in ("arange", "as_tensor", "eye", "full", "linspace", "ones", "tensor", "zeros")
)
_METHODS_WRITTEN_ANEW = ("norm", "cross", "type", "bool")
_PATHS = {
    **{f"torch.{name}": f"math.{name}" for name in ("pi", "e", "inf", "nan")},
    **{f"numpy.{name}": path for name, path in NUMPY_NAMES.items()},
    "torch.concatenate": "torch.cat",
    "torch.absolute": "torch.abs",
}


class Expressions:
    """Writes the expressions of one function.

    Attributes:
        used: helpers of ours that were written so far.
        device: text of an expression for the device of the inputs; new tensors without a device are put there.
    """

    def __init__(
        self,
        program: Program,
        function: ast.FunctionDef,
        needs: Mapping[str, tuple[str, ...]],
        variables: Mapping[str, Variable],
    ) -> None:
        self._program = program
        self._needs = needs
        self._variables = variables
        self._modules = modules_of(program, function)
        self._local = local_names(function)
        self._line = function.lineno
        self.used: set[str] = set()
        self.device = ""

    def text(self, node: ast.expr) -> str:
        """Returns the text of an expression.

        Raises:
            CodeError: it has no TorchScript form; check "static".
        """
        write = getattr(self, f"_{type(node).__name__.lower()}", None)
        if write is None:
            raise CodeError("static", f"{type(node).__name__} is not allowed", getattr(node, "lineno", self._line))
        return write(node)

    def target(self, node: ast.expr) -> str:
        """Returns the text of what is assigned to."""
        if isinstance(node, ast.Tuple | ast.List):
            parts = [self.inner_target(element) for element in node.elts]
            return ", ".join(parts) + ("," if len(parts) == 1 else "")
        if isinstance(node, ast.Name):
            return node.id
        if isinstance(node, ast.Subscript):
            return self.text(node)
        raise CodeError("static", f"{type(node).__name__} cannot be assigned", node.lineno)

    def inner_target(self, node: ast.expr) -> str:
        """Returns the text of what is assigned to where several names want brackets."""
        text = self.target(node)
        return f"({text})" if isinstance(node, ast.Tuple | ast.List) else text

    def _constant(self, node: ast.Constant) -> str:
        value = node.value
        if value is Ellipsis:
            return "..."
        if isinstance(value, str):
            return text_literal(value)
        if isinstance(value, float) and value == float("inf"):
            return "math.inf"
        if value is None or isinstance(value, bool | int | float):
            return repr(value)
        raise CodeError("static", f"a {type(value).__name__} constant is not allowed", node.lineno)

    def _name(self, node: ast.Name) -> str:
        name = node.id
        if name in self._local:
            return name
        if name in self._program.helpers:
            return FUNCTION + name
        if name in self._variables:
            return VARIABLE + name
        if name in self._modules:
            return _path_text(self._modules[name])
        return self._helper(name)

    def _helper(self, name: str) -> str:
        """Returns the text of a helper of ours or of a builtin; a builtin `sum` is seen to where it is called."""
        if name in HELPER_SOURCES and name != "sum":
            self.used.add(name)
            return VARIABLE + name
        return name

    def _attribute(self, node: ast.Attribute) -> str:
        path = module_path(node, self._modules, self._local)
        if path:
            return _path_text(path)
        if isinstance(node.value, ast.Name) and node.value.id == "self":
            if node.attr in self._program.helpers:
                return FUNCTION + node.attr
            if node.attr in self._variables:
                return VARIABLE + node.attr
            return self._helper(node.attr)
        return f"{self.text(node.value)}.{node.attr}"

    def _subscript(self, node: ast.Subscript) -> str:
        parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        return f"{self.text(node.value)}[{self._all(parts)}]"

    def _slice(self, node: ast.Slice) -> str:
        lower, upper, step = (self.text(part) if part else "" for part in (node.lower, node.upper, node.step))
        return f"{lower}:{upper}" + (f":{step}" if step else "")

    def _binop(self, node: ast.BinOp) -> str:
        sides = [self.text(side) for side in (node.left, node.right)]
        left, right = (f"({side})" if side[0] in "-~" else side for side in sides)
        return f"({left} {BINARY[type(node.op)]} {right})"

    def _unaryop(self, node: ast.UnaryOp) -> str:
        operand = self.text(node.operand)
        text = _UNARY[type(node.op)] + (f"({operand})" if operand[0] in "-~" else operand)
        # A negative number stays bare: TorchScript takes it for a constant then, as dim=-1 must be.
        is_number = isinstance(node.operand, ast.Constant) and not isinstance(node.op, ast.Not)
        return text if is_number else f"({text})"

    def _boolop(self, node: ast.BoolOp) -> str:
        sign = " and " if isinstance(node.op, ast.And) else " or "
        return f"({sign.join(self.text(value) for value in node.values)})"

    def _compare(self, node: ast.Compare) -> str:
        """TorchScript reads a chain as ((a < b) < c), so each link is written out."""
        sides = [self.text(side) for side in (node.left, *node.comparators)]
        pairs = zip(sides[:-1], node.ops, sides[1:], strict=True)
        links = [f"({left} {_COMPARE[type(op)]} {right})" for left, op, right in pairs]
        return links[0] if len(links) == 1 else f"({' and '.join(links)})"

    def _ifexp(self, node: ast.IfExp) -> str:
        return f"({self.text(node.body)} if {self.text(node.test)} else {self.text(node.orelse)})"

    def _list(self, node: ast.List) -> str:
        return f"[{self._all(node.elts)}]"

    def _tuple(self, node: ast.Tuple) -> str:
        return f"({self._all(node.elts)}{',' if len(node.elts) == 1 else ''})"

    def _all(self, nodes: list[ast.expr]) -> str:
        return ", ".join(self.text(node) for node in nodes)

    def _dict(self, node: ast.Dict) -> str:
        """`{**near, "far": x}` is written as one dictionary after the other, merged."""
        parts: list[str] = []
        for key, group in groupby(zip(node.keys, node.values, strict=True), key=lambda pair: pair[0] is None):
            if key:
                parts.extend(self.text(value) for _, value in group)
            else:
                pairs = (f"{self.text(name)}: {self.text(value)}" for name, value in group if name is not None)
                parts.append("{" + ", ".join(pairs) + "}")
        if None not in node.keys:
            return parts[0] if parts else "{}"
        self.used.add("merged")
        return reduce(lambda first, more: f"{VARIABLE}merged({first}, {more})", parts, "{}")

    def _set(self, node: ast.Set) -> str:
        """A dictionary in doubled braces, as left over from a format string, reads as a set of one dictionary."""
        if len(node.elts) == 1 and isinstance(node.elts[0], ast.Dict):
            return self._dict(node.elts[0])
        raise CodeError("static", "sets are not allowed", node.lineno)

    def _listcomp(self, node: ast.ListComp | ast.GeneratorExp) -> str:
        return f"[{self.text(node.elt)} {self._generator(node)}]"

    _generatorexp = _listcomp

    def _dictcomp(self, node: ast.DictComp) -> str:
        return f"{{{self.text(node.key)}: {self.text(node.value)} {self._generator(node)}}}"

    def _generator(self, node: ast.ListComp | ast.GeneratorExp | ast.DictComp) -> str:
        generator = node.generators[0]
        if len(node.generators) != 1 or generator.ifs:
            raise CodeError("static", "a comprehension has one for and no if", node.lineno)
        return f"for {self.inner_target(generator.target)} in {self.text(generator.iter)}"

    def _joinedstr(self, node: ast.JoinedStr) -> str:
        text, values = "", []
        for part in node.values:
            if isinstance(part, ast.FormattedValue):
                text += "{}"
                values.append(self.text(part.value))
            elif isinstance(part, ast.Constant):
                text += str(part.value).replace("{", "(").replace("}", ")")
        return f"{text_literal(text)}.format({', '.join(values)})" if values else text_literal(text)

    def _call(self, node: ast.Call) -> str:
        path = module_path(node.func, self._modules, self._local)
        arguments = [self.text(argument) for argument in node.args if path != "torch.jit.annotate"]
        if path == "torch.jit.annotate":
            return f"torch.jit.annotate({type_text(node.args[0])}, {self.text(node.args[1])})"
        keywords = {keyword.arg or "": self.text(keyword.value) for keyword in node.keywords}
        function = self.text(node.func)
        if function == "dict" and not arguments:
            return "{" + ", ".join(f"{text_literal(name)}: {value}" for name, value in keywords.items()) + "}"
        if function == "list" and not arguments:
            return "[]"
        if isinstance(node.func, ast.Attribute) and not path and node.func.attr == "new_tensor":
            owner = self.text(node.func.value)
            function, keywords = "torch.tensor", {"dtype": f"{owner}.dtype", "device": f"{owner}.device", **keywords}
        if isinstance(node.func, ast.Attribute) and not path and node.func.attr in _METHODS_WRITTEN_ANEW:
            function, owner = f"torch.{node.func.attr}", self.text(node.func.value)
            arguments = [owner, *arguments]
        is_list = len(node.args) == 1 and isinstance(node.args[0], ast.List | ast.Tuple)
        function, arguments, helper = plain_form(function, arguments, keywords, is_list)
        if helper:
            self.used.add(helper)
            function = VARIABLE + helper
        if function in _FACTORIES and self.device:
            keywords.setdefault("device", self.device)
        own = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
        if function == FUNCTION + own:
            arguments = [VARIABLE + name for name in self._needs[own]] + arguments
        return f"{function}({', '.join([*arguments, *(f'{name}={text}' for name, text in keywords.items())])})"


def _path_text(path: str) -> str:
    if path.startswith("torch.nn.functional."):
        return FUNCTIONAL + "." + path.rpartition(".")[2]
    return _PATHS.get(path, path)


def text_literal(value: str) -> str:
    """Returns a string literal that both parsers read alike: what is not plain becomes an underscore."""
    return '"' + "".join(c if c.isascii() and c.isprintable() and c not in '"\\' else "_" for c in value) + '"'
