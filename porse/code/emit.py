"""Writes a checked program again as TorchScript text: fully bracketed, typed by the task, one statement a line.

Only nodes that are known here can come out, so what TorchScript reads is what the check has seen. Differences between
Python and TorchScript's own parser (chained comparisons, operator precedence, f-strings) are resolved here.
"""

import ast
from collections.abc import Mapping
from dataclasses import dataclass, field

from porse.code.check import Reads, all_arguments, defaults, local_names, module_path
from porse.code.hoist import number_type
from porse.code.prelude import HELPER_SOURCES
from porse.code.program import Program, import_names
from porse.code.verdict import CodeError
from porse.variables import Variable

_TYPE_OF_KIND = {"tensor": "Tensor", "int": "int", "float": "float", "device": "Device"}
_BINARY = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.FloorDiv: "//", ast.Mod: "%", ast.Pow: "**",
    ast.MatMult: "@", ast.BitAnd: "&", ast.BitOr: "|", ast.BitXor: "^", ast.LShift: "<<", ast.RShift: ">>",
}  # fmt: skip
_UNARY = {ast.USub: "-", ast.Not: "not ", ast.Invert: "~"}
_COMPARE = {
    ast.Eq: "==", ast.NotEq: "!=", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Is: "is",
    ast.IsNot: "is not", ast.In: "in", ast.NotIn: "not in",
}  # fmt: skip
_FACTORIES = frozenset("torch.arange torch.eye torch.full torch.linspace torch.ones torch.tensor torch.zeros".split())
_NUMBERS = {"torch.pi": "math.pi", "torch.e": "math.e", "torch.inf": "math.inf", "torch.nan": "math.nan",
            "numpy.pi": "math.pi", "numpy.e": "math.e", "numpy.inf": "math.inf", "numpy.nan": "math.nan"}  # fmt: skip
_ALIASES = {"torch.concatenate": "torch.cat", "torch.as_tensor": "torch.tensor", "torch.absolute": "torch.abs"}
_CONSTRUCTORS = ("torch.Tensor", "torch.FloatTensor")
_DROPPED_CALLS = ("print",)


@dataclass(frozen=True)
class Emitted:
    """TorchScript text of a program.

    Attributes:
        text: helpers first, then the function.
        lines: for each line of the text, the line of the source, 0 for lines of our own.
        name: the function to look up.
        arguments: the task variable of each argument, in order.
    """

    text: str
    lines: tuple[int, ...]
    name: str
    arguments: tuple[str, ...]


def emit(program: Program, reads: Mapping[str, Reads], variables: Mapping[str, Variable]) -> Emitted:
    """Returns the TorchScript text of a checked program.

    Raises:
        CodeError: an expression has no TorchScript form.
    """
    lines: list[tuple[int, str]] = []
    needs = _needs(reads)
    used: set[str] = set()
    order = _order(reads)
    arguments: tuple[str, ...] = ()
    for name in order:
        function = program.helpers.get(name, program.main)
        writer = _Writer(program, function, reads, needs, variables)
        arguments = writer.run()
        lines.extend(writer.lines)
        used |= writer.used
    own = [(0, line) for name in HELPER_SOURCES if name in used for line in HELPER_SOURCES[name].splitlines()]
    lines = own + lines
    return Emitted(
        "\n".join(text for _, text in lines) + "\n", tuple(number for number, _ in lines), f"f_{program.main.name}", arguments
    )


def _needs(reads: Mapping[str, Reads]) -> dict[str, tuple[str, ...]]:
    """Returns for each function the task variables that it must be handed besides its own arguments."""
    needs: dict[str, set[str]] = {name: set(r.variables) for name, r in reads.items()}
    for _ in reads:
        for name, r in reads.items():
            for helper in r.helpers:
                needs[name] |= needs[helper]
    return {name: tuple(sorted(found)) for name, found in needs.items()}


def _order(reads: Mapping[str, Reads]) -> list[str]:
    """Returns the functions, each after those that it calls, the main one last."""
    order: list[str] = []

    def add(name: str) -> None:
        if name not in order:
            for helper in sorted(reads[name].helpers):
                add(helper)
            order.append(name)

    add(list(reads)[-1])
    return order


@dataclass
class _Writer:
    program: Program
    function: ast.FunctionDef
    reads: Mapping[str, Reads]
    needs: Mapping[str, tuple[str, ...]]
    variables: Mapping[str, Variable]
    lines: list[tuple[int, str]] = field(default_factory=list)
    used: set[str] = field(default_factory=set)

    def run(self) -> tuple[str, ...]:
        """Writes the function; returns the task variable of each argument."""
        self.modules = dict(self.program.modules)
        for node in ast.walk(self.function):
            if isinstance(node, ast.Import | ast.ImportFrom):
                self.modules.update(import_names(node))
        self.local = local_names(self.function)
        self.number = self.function.lineno
        is_main = self.function is self.program.main
        given = defaults(self.function)
        declared, arguments, first = [], [], []
        for argument in all_arguments(self.function):
            name = argument.arg
            if is_main and name not in self.variables:
                first.append(f"{name} = {self._default(argument, given[name])}")
                continue
            kind = _TYPE_OF_KIND[self.variables[name].kind] if is_main else self._helper_type(argument, given.get(name))
            tail = f" = {self.expression(given[name])}" if name in given and not is_main else ""
            declared.append(f"{self._bind(name)}: {kind or 'Tensor'}{tail}")
            arguments.append(name)
        extra = [f"porse_{n}: {_TYPE_OF_KIND[self.variables[n].kind]}" for n in self.needs[self.function.name]]
        self.device = self._device_source(is_main)
        self._line(0, f"def f_{self.function.name}({', '.join(extra + declared)}):")
        for name in sorted(self.reads[self.function.name].constants):
            self._line(1, f"{self._bind(name)} = {self.expression(self.program.constants[name])}")
        for text in first:
            self._line(1, text)
        self._body(self.function.body, 1)
        return (*self.needs[self.function.name], *arguments)

    def _helper_type(self, argument: ast.arg, default: ast.expr | None) -> str:
        """Returns the type of a helper's argument: as declared, of its default, or of the numbers it is called with."""
        if argument.annotation is not None:
            return self._type(argument.annotation)
        if number_type(default):
            return number_type(default)
        position = all_arguments(self.function).index(argument)
        kinds: set[str] = set()
        for function in [*self.program.helpers.values(), self.program.main]:
            for node in ast.walk(function):
                if isinstance(node, ast.Call) and getattr(node.func, "id", getattr(node.func, "attr", "")) == self.function.name:
                    values = [k.value for k in node.keywords if k.arg == argument.arg] or node.args[position : position + 1]
                    kinds.update(_known_type(value, function, self.variables) for value in values)
        return kinds.pop() if len(kinds) == 1 and kinds != {""} else "Tensor"

    def _default(self, argument: ast.arg, value: ast.expr) -> str:
        text = self.expression(value)
        is_float = isinstance(argument.annotation, ast.Name) and argument.annotation.id == "float"
        return f"float({text})" if is_float else text

    def _device_source(self, is_main: bool) -> str:
        """Returns an expression for the device of the inputs, "" when the function has no tensor among them."""
        for name in self.needs[self.function.name]:
            if self.variables[name].kind == "tensor":
                return f"porse_{name}.device"
        bound = {n.id for n in ast.walk(self.function) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
        for argument in all_arguments(self.function):
            if argument.arg in bound:
                continue
            if is_main and argument.arg in self.variables and self.variables[argument.arg].kind == "tensor":
                return f"{argument.arg}.device"
            if not is_main and self._type(argument.annotation) == "Tensor":
                return f"{argument.arg}.device"
        return ""

    def _line(self, depth: int, text: str) -> None:
        self.lines.append((self.number, "    " * depth + text))

    def _bind(self, name: str) -> str:
        return name

    def _body(self, body: list[ast.stmt], depth: int) -> None:
        before = len(self.lines)
        for statement in body:
            self.number = statement.lineno
            self._statement(statement, depth)
        if len(self.lines) == before:
            self._line(depth, "pass")

    def _statement(self, node: ast.stmt, depth: int) -> None:
        if isinstance(node, ast.Assert | ast.Import | ast.ImportFrom | ast.Delete):
            return
        if isinstance(node, ast.Return):
            self._line(depth, f"return {self.expression(node.value)}" if node.value else "return")
        elif isinstance(node, ast.Assign):
            self._assign(node, depth)
        elif isinstance(node, ast.AugAssign):
            self._augmented(node, depth)
        elif isinstance(node, ast.AnnAssign):
            self._annotated(node, depth)
        elif isinstance(node, ast.Expr):
            if isinstance(node.value, ast.Constant) or self._dropped(node.value):
                return
            self._line(depth, self.expression(node.value))
        elif isinstance(node, ast.With):
            self._body(node.body, depth)
        elif isinstance(node, ast.If):
            self._line(depth, f"if {self.expression(node.test)}:")
            self._body(node.body, depth + 1)
            if node.orelse:
                self._line(depth, "else:")
                self._body(node.orelse, depth + 1)
        elif isinstance(node, ast.For):
            self._line(depth, f"for {self._target(node.target)} in {self.expression(node.iter)}:")
            self._body(node.body, depth + 1)
        elif isinstance(node, ast.Pass | ast.Break | ast.Continue):
            self._line(depth, type(node).__name__.lower())
        else:
            raise CodeError("static", f"{type(node).__name__} is not allowed", node.lineno)

    def _dropped(self, node: ast.expr) -> bool:
        return isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in _DROPPED_CALLS

    def _assign(self, node: ast.Assign, depth: int) -> None:
        value = self.expression(node.value)
        if len(node.targets) == 1:
            self._line(depth, f"{self._target(node.targets[0])} = {value}")
            return
        self._line(depth, f"porse_value = {value}")
        for target in node.targets:
            self._line(depth, f"{self._target(target)} = porse_value")

    def _augmented(self, node: ast.AugAssign, depth: int) -> None:
        sign, target, value = _BINARY[type(node.op)], self._target(node.target), self.expression(node.value)
        if sign in ("+", "-", "*", "/"):
            self._line(depth, f"{target} {sign}= {value}")
        else:
            self._line(depth, f"{target} = ({target} {sign} {value})")

    def _annotated(self, node: ast.AnnAssign, depth: int) -> None:
        assert isinstance(node.target, ast.Name)  # noqa: S101 (checked)
        if node.value is None:
            return
        kind = self._type(node.annotation)
        value = self.expression(node.value)
        if kind == "float" and isinstance(node.value, ast.Constant) and isinstance(node.value.value, int):
            value = f"float({value})"
        self._line(depth, f"{node.target.id}: {kind} = {value}" if kind else f"{node.target.id} = {value}")

    def _target(self, node: ast.expr) -> str:
        if isinstance(node, ast.Tuple | ast.List):
            return ", ".join(self._target(element) for element in node.elts) + ("," if len(node.elts) == 1 else "")
        if isinstance(node, ast.Name):
            return node.id
        if isinstance(node, ast.Subscript):
            return self.expression(node)
        raise CodeError("static", f"{type(node).__name__} cannot be assigned", node.lineno)

    def _type(self, node: ast.expr | None) -> str:
        """Returns TorchScript's spelling of an annotation, "" for one that it does not know."""
        if node is None:
            return "Tensor"
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            return self._type(ast.parse(node.value, mode="eval").body)
        if isinstance(node, ast.Constant) and node.value is None:
            return "None"
        if isinstance(node, ast.BinOp):
            sides = [self._type(side) for side in (node.left, node.right) if not isinstance(side, ast.Constant)]
            return f"Optional[{sides[0]}]" if len(sides) == 1 else ""
        if isinstance(node, ast.Subscript):
            outer = self._type(node.value)
            inner = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
            parts = [self._type(part) for part in inner]
            return f"{outer}[{', '.join(parts)}]" if outer and all(parts) else ""
        name = node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""
        names = {"Tensor": "Tensor", "FloatTensor": "Tensor", "LongTensor": "Tensor", "BoolTensor": "Tensor",
                 "int": "int", "float": "float", "bool": "bool", "str": "str", "device": "Device", "List": "List",
                 "list": "List", "Tuple": "Tuple", "tuple": "Tuple", "Dict": "Dict", "dict": "Dict",
                 "Optional": "Optional"}  # fmt: skip
        return names.get(name, "")

    def expression(self, node: ast.expr) -> str:
        """Returns the text of an expression, in brackets where precedence could matter."""
        method = getattr(self, f"_{type(node).__name__.lower()}", None)
        if method is None:
            raise CodeError("static", f"{type(node).__name__} is not allowed", getattr(node, "lineno", self.number))
        return method(node)

    def _constant(self, node: ast.Constant) -> str:
        value = node.value
        if value is Ellipsis:
            return "..."
        if isinstance(value, str):
            return text_literal(value)
        if isinstance(value, float) and value in (float("inf"), float("-inf")):
            return "math.inf"
        if value is None or isinstance(value, bool | int | float):
            return repr(value)
        raise CodeError("static", f"a {type(value).__name__} constant is not allowed", node.lineno)

    def _name(self, node: ast.Name) -> str:
        name = node.id
        if name in self.local or name in self.program.constants:
            return name
        if name in self.program.helpers:
            return f"f_{name}"
        if name in self.variables:
            return f"porse_{name}"
        if name in self.modules:
            return self._path(self.modules[name])
        if name in HELPER_SOURCES and name != "sum":
            self.used.add(name)
            return f"porse_{name}"
        return name

    def _path(self, path: str) -> str:
        if path.startswith("torch.nn.functional."):
            return "F." + path.rpartition(".")[2]
        return _ALIASES.get(_NUMBERS.get(path, path), _NUMBERS.get(path, path))

    def _attribute(self, node: ast.Attribute) -> str:
        path = module_path(node, self.modules, self.local)
        if path:
            return self._path(path)
        if isinstance(node.value, ast.Name) and node.value.id == "self":
            if node.attr in self.program.helpers:
                return f"f_{node.attr}"
            if node.attr in self.variables:
                return f"porse_{node.attr}"
            self.used.add(node.attr)
            return f"porse_{node.attr}"
        return f"{self.expression(node.value)}.{node.attr}"

    def _subscript(self, node: ast.Subscript) -> str:
        parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        return f"{self.expression(node.value)}[{', '.join(self.expression(part) for part in parts)}]"

    def _slice(self, node: ast.Slice) -> str:
        lower, upper, step = (self.expression(part) if part else "" for part in (node.lower, node.upper, node.step))
        return f"{lower}:{upper}" + (f":{step}" if step else "")

    def _binop(self, node: ast.BinOp) -> str:
        return f"({self.expression(node.left)} {_BINARY[type(node.op)]} {self.expression(node.right)})"

    def _unaryop(self, node: ast.UnaryOp) -> str:
        if isinstance(node.op, ast.UAdd):
            return self.expression(node.operand)
        if isinstance(node.operand, ast.Constant):
            return f"{_UNARY[type(node.op)]}{self.expression(node.operand)}".join(("(", ")")) if isinstance(node.op, ast.Not) else f"{_UNARY[type(node.op)]}{self.expression(node.operand)}"
        return f"({_UNARY[type(node.op)]}{self.expression(node.operand)})"

    def _boolop(self, node: ast.BoolOp) -> str:
        sign = " and " if isinstance(node.op, ast.And) else " or "
        return "(" + sign.join(self.expression(value) for value in node.values) + ")"

    def _compare(self, node: ast.Compare) -> str:
        sides = [self.expression(side) for side in (node.left, *node.comparators)]
        pairs = zip(sides[:-1], node.ops, sides[1:], strict=True)
        texts = [f"({left} {_COMPARE[type(op)]} {right})" for left, op, right in pairs]
        return texts[0] if len(texts) == 1 else "(" + " and ".join(texts) + ")"

    def _ifexp(self, node: ast.IfExp) -> str:
        return f"({self.expression(node.body)} if {self.expression(node.test)} else {self.expression(node.orelse)})"

    def _list(self, node: ast.List) -> str:
        return "[" + ", ".join(self.expression(element) for element in node.elts) + "]"

    def _tuple(self, node: ast.Tuple) -> str:
        return "(" + ", ".join(self.expression(e) for e in node.elts) + ("," if len(node.elts) == 1 else "") + ")"

    def _dict(self, node: ast.Dict) -> str:
        if any(key is None for key in node.keys):
            raise CodeError("static", "** in a dictionary is not allowed", node.lineno)
        pairs = zip(node.keys, node.values, strict=True)
        return "{" + ", ".join(f"{self.expression(k)}: {self.expression(v)}" for k, v in pairs if k is not None) + "}"

    def _set(self, node: ast.Set) -> str:
        """A dictionary in doubled braces, as left over from a format string, reads as a set of one dictionary."""
        if len(node.elts) == 1 and isinstance(node.elts[0], ast.Dict):
            return self._dict(node.elts[0])
        raise CodeError("static", "sets are not allowed", node.lineno)

    def _listcomp(self, node: ast.ListComp | ast.GeneratorExp) -> str:
        generator = node.generators[0]
        if len(node.generators) != 1 or generator.ifs:
            raise CodeError("static", "a list comprehension has one for and no if", node.lineno)
        head = self.expression(node.elt)
        return f"[{head} for {self._target(generator.target)} in {self.expression(generator.iter)}]"

    _generatorexp = _listcomp

    def _dictcomp(self, node: ast.DictComp) -> str:
        generator = node.generators[0]
        if len(node.generators) != 1 or generator.ifs:
            raise CodeError("static", "a dictionary comprehension has one for and no if", node.lineno)
        head = f"{self.expression(node.key)}: {self.expression(node.value)}"
        return f"{{{head} for {self._target(generator.target)} in {self.expression(generator.iter)}}}"

    def _joinedstr(self, node: ast.JoinedStr) -> str:
        text, values = "", []
        for part in node.values:
            if isinstance(part, ast.Constant):
                text += str(part.value).replace("{", "(").replace("}", ")")
            elif isinstance(part, ast.FormattedValue):
                text += "{}"
                values.append(self.expression(part.value))
        return f"{text_literal(text)}.format({', '.join(values)})" if values else text_literal(text)

    def _call(self, node: ast.Call) -> str:
        path = module_path(node.func, self.modules, self.local)
        arguments = [self.expression(argument) for argument in node.args]
        keywords = [(k.arg or "", self.expression(k.value)) for k in node.keywords]
        if path == "torch.jit.annotate":
            return f"torch.jit.annotate({self._type(node.args[0])}, {arguments[1]})"
        function = self.expression(node.func)
        if function in _CONSTRUCTORS and len(node.args) == 1 and isinstance(node.args[0], ast.List | ast.Tuple):
            function, keywords = "torch.tensor", [("dtype", "torch.float32"), *keywords]
        if function in _FACTORIES and self.device and all(name != "device" for name, _ in keywords):
            keywords.append(("device", self.device))
        if isinstance(node.func, ast.Attribute) and not path and node.func.attr == "norm":
            function, arguments = "torch.norm", [self.expression(node.func.value), *arguments]
        if function == "torch.cross" or (isinstance(node.func, ast.Attribute) and not path and node.func.attr == "cross"):
            # Without a dimension torch.cross takes the first of size 3, which is the wrong one for three environments.
            arguments = arguments if path else [self.expression(node.func.value), *arguments]
            function = "torch.linalg.cross"
            keywords += [("dim", arguments.pop(2))] if len(arguments) > 2 else []
        if isinstance(node.func, ast.Attribute) and not path and node.func.attr == "type":
            function = f"{self.expression(node.func.value)}.to"
        if function == "sum" and len(arguments) == 1 and not keywords:
            self.used.add("sum")
            function = "porse_sum"
        name = self._helper_name(node.func)
        if name:
            arguments = [f"porse_{n}" for n in self.needs[name]] + arguments
        return f"{function}({', '.join([*arguments, *(f'{k}={v}' for k, v in keywords)])})"

    def _helper_name(self, function: ast.expr) -> str:
        """Returns the name of the program's own function that is called, if one is."""
        if isinstance(function, ast.Name) and function.id in self.program.helpers and function.id not in self.local:
            return function.id
        is_method = isinstance(function, ast.Attribute) and isinstance(function.value, ast.Name)
        if is_method and function.value.id == "self" and function.attr in self.program.helpers:
            return function.attr
        return ""


def _known_type(node: ast.expr, function: ast.FunctionDef, variables: Mapping[str, Variable]) -> str:
    """Returns the type of a call's argument where it is plain to see: a number, or a name that is always a number."""
    if number_type(node) or not isinstance(node, ast.Name):
        return number_type(node)
    for argument in all_arguments(function):
        if argument.arg == node.id:
            declared = argument.annotation.id if isinstance(argument.annotation, ast.Name) else ""
            known = variables[node.id].kind if node.id in variables else declared
            return known if known in ("int", "float") else number_type(defaults(function).get(node.id))
    kinds = {
        number_type(n.value)
        for n in ast.walk(function)
        if isinstance(n, ast.Assign) and any(isinstance(t, ast.Name) and t.id == node.id for t in n.targets)
    }
    return kinds.pop() if len(kinds) == 1 else ""


def text_literal(value: str) -> str:
    """Returns a string literal that both parsers read alike: what is not plain becomes an underscore."""
    return '"' + "".join(c if c.isascii() and c.isprintable() and c not in "\"\\" else "_" for c in value) + '"'
