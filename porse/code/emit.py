"""Writes a checked program again as TorchScript text: fully bracketed, typed by the task, one statement a line.

Only nodes that are known here can come out, so what TorchScript reads is what the check has seen. Asserts, prints,
imports and docstrings compute nothing and are left out.
"""

import ast
from collections.abc import Mapping
from dataclasses import dataclass

from porse.code.annotations import TYPE_OF_KIND, argument_type, type_text, value_type
from porse.code.check import Reads
from porse.code.expressions import BINARY, FUNCTION, VARIABLE, Expressions
from porse.code.hoist import number_type
from porse.code.one_type import FLOAT, TENSOR, Local
from porse.code.prelude import HELPER_SOURCES
from porse.code.program import Program
from porse.code.syntax import all_arguments, assigned_names, defaults, given_values
from porse.functions.verdict import CodeError
from porse.variables import Variable


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


def emit(
    program: Program,
    reads: Mapping[str, Reads],
    variables: Mapping[str, Variable],
    types: Mapping[Local, str],
) -> Emitted:
    """Returns the TorchScript text of a checked program.

    Args:
        program: the program.
        reads: what each of its functions reads.
        variables: what the task offers, by name.
        types: names whose first value tells the wrong type, as `types_of_names` returns them.

    Raises:
        CodeError: a statement or an expression has no TorchScript form.
    """
    needs = _needs(reads)
    lines: list[tuple[int, str]] = []
    used: set[str] = set()
    arguments: tuple[str, ...] = ()
    for name in _order(reads, program.main.name):
        writer = _Writer(program, program.helpers.get(name, program.main), needs, variables, types)
        arguments = writer.run()
        lines.extend(writer.lines)
        used |= writer.expressions.used
    own = [(0, line) for name, source in HELPER_SOURCES.items() if name in used for line in source.splitlines()]
    lines = own + lines
    text = "\n".join(text for _, text in lines) + "\n"
    return Emitted(text, tuple(number for number, _ in lines), FUNCTION + program.main.name, arguments)


def _needs(reads: Mapping[str, Reads]) -> dict[str, tuple[str, ...]]:
    """Returns for each function the task variables that it must be handed besides its own arguments."""
    needs: dict[str, set[str]] = {name: set(r.variables) for name, r in reads.items()}
    for _ in reads:
        for name, r in reads.items():
            needs[name] = needs[name].union(*(needs[helper] for helper in r.helpers))
    return {name: tuple(sorted(found)) for name, found in needs.items()}


def _order(reads: Mapping[str, Reads], main: str) -> list[str]:
    """Returns the functions that are called, each after those that it calls, the main one last."""
    order: list[str] = []

    def add(name: str) -> None:
        if name not in order:
            for helper in sorted(reads[name].helpers):
                add(helper)
            order.append(name)

    add(main)
    return order


class _Writer:
    """Writes one function, line by line."""

    def __init__(
        self,
        program: Program,
        function: ast.FunctionDef,
        needs: Mapping[str, tuple[str, ...]],
        variables: Mapping[str, Variable],
        types: Mapping[Local, str],
    ) -> None:
        self.lines: list[tuple[int, str]] = []
        self.expressions = Expressions(program, function, needs, variables)
        self._program = program
        self._function = function
        self._needs = needs[function.name]
        self._variables = variables
        self._types = types
        self._is_main = function is program.main
        self._line = function.lineno

    def run(self) -> tuple[str, ...]:
        """Writes the function; returns the task variable of each argument."""
        given = defaults(self._function)
        head = [f"{VARIABLE}{name}: {TYPE_OF_KIND[self._variables[name].kind]}" for name in self._needs]
        arguments, first = list(self._needs), []
        for argument in all_arguments(self._function):
            name, default = argument.arg, given.get(argument.arg)
            if self._is_main and name in self._variables:
                head.append(f"{name}: {TYPE_OF_KIND[self._variables[name].kind]}")
                arguments.append(name)
            elif self._is_main and default is not None:
                first.append(f"{name} = {self._number(type_text(argument.annotation), default)}")
            else:
                tail = f" = {self.expressions.text(default)}" if default is not None else ""
                head.append(f"{name}: {self._helper_type(argument, default) or 'Tensor'}{tail}")
        self.expressions.device = self._device()
        self._write(0, f"def {FUNCTION}{self._function.name}({', '.join(head)}):")
        for text in first:
            self._write(1, text)
        self._body(self._function.body, 1)
        return tuple(arguments)

    def _helper_type(self, argument: ast.arg, default: ast.expr | None) -> str:
        """Returns the type of a helper's argument: as declared, of its default, or of the numbers it is called with."""
        if argument.annotation is not None:
            return argument_type(argument.annotation)
        given = given_values(self._program, self._function, argument)
        kinds = {value_type(value, function, self._variables) for value, function in given}
        if number_type(default):
            return "float" if "float" in kinds else number_type(default)
        return (kinds.pop() if len(kinds) == 1 else "") or "Tensor"

    def _number(self, kind: str, value: ast.expr) -> str:
        """Returns a number as the type that was declared for it."""
        text = self.expressions.text(value)
        return f"float({text})" if kind == "float" and number_type(value) == "int" else text

    def _device(self) -> str:
        """Returns an expression for the device of the inputs, "" when no tensor is among them."""
        for name in self._needs:
            if self._variables[name].kind == "tensor":
                return f"{VARIABLE}{name}.device"
        assigned = assigned_names(self._function)
        for argument in all_arguments(self._function):
            name = argument.arg
            if self._is_main:
                is_tensor = name in self._variables and self._variables[name].kind == "tensor"
            else:
                is_tensor = self._helper_type(argument, defaults(self._function).get(name)) == "Tensor"
            if is_tensor and name not in assigned:
                return f"{name}.device"
        return ""

    def _write(self, depth: int, text: str) -> None:
        self.lines.append((self._line, "    " * depth + text))

    def _body(self, body: list[ast.stmt], depth: int) -> None:
        before = len(self.lines)
        for statement in body:
            self._line = statement.lineno
            self._statement(statement, depth)
        if len(self.lines) == before:
            self._write(depth, "pass")

    def _statement(self, node: ast.stmt, depth: int) -> None:
        text, target = self.expressions.text, self.expressions.target
        if isinstance(node, ast.Return):
            self._write(depth, f"return {text(node.value)}" if node.value else "return")
        elif isinstance(node, ast.Assign | ast.AugAssign | ast.AnnAssign):
            self._assignment(node, depth)
        elif isinstance(node, ast.Expr):
            if not isinstance(node.value, ast.Constant) and not _is_print(node.value):
                self._write(depth, text(node.value))
        elif isinstance(node, ast.With):
            self._body(node.body, depth)
        elif isinstance(node, ast.If):
            self._write(depth, f"if {text(node.test)}:")
            self._body(node.body, depth + 1)
            if node.orelse:
                self._write(depth, "else:")
                self._body(node.orelse, depth + 1)
        elif isinstance(node, ast.For):
            self._write(depth, f"for {target(node.target)} in {text(node.iter)}:")
            self._body(node.body, depth + 1)
        elif isinstance(node, ast.Raise):
            self._write(depth, 'raise RuntimeError("the function raises an error")')
        elif isinstance(node, ast.Pass | ast.Break | ast.Continue):
            self._write(depth, type(node).__name__.lower())
        elif not isinstance(node, ast.Assert | ast.Import | ast.ImportFrom | ast.Delete):
            raise CodeError("static", f"{type(node).__name__} is not allowed", node.lineno)

    def _assignment(self, node: ast.Assign | ast.AugAssign | ast.AnnAssign, depth: int) -> None:
        if node.value is None:
            return
        target, value = self.expressions.target, self.expressions.text(node.value)
        if isinstance(node, ast.AugAssign):
            sign = BINARY[type(node.op)]
            place = target(node.target)
            # The others have no in-place form in TorchScript, and a tensor of one number cannot grow in place.
            known = sign in ("+", "-", "*", "/") and self._type(node.target) != TENSOR
            self._write(depth, f"{place} {sign}= {value}" if known else f"{place} = ({place} {sign} {value})")
        elif isinstance(node, ast.AnnAssign) and not self._type(node.target):
            kind = type_text(node.annotation)
            place = target(node.target) + (f": {kind}" if kind else "")
            self._write(depth, f"{place} = {self._number(kind, node.value)}")
        else:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            kind = next(filter(None, map(self._type, targets)), "")
            value = self._first_value(node.value, kind) if kind else value
            if len(targets) == 1:
                self._write(depth, f"{target(targets[0])} = {value}")
            else:
                self._write(depth, f"{VARIABLE}value = {value}")
                for each in targets:
                    self._write(depth, f"{target(each)} = {VARIABLE}value")

    def _type(self, target: ast.expr) -> str:
        """Returns the type that is known of a name whose first value tells the wrong one, "" for all others."""
        return self._types.get((FUNCTION + self._function.name, target.id), "") if isinstance(target, ast.Name) else ""

    def _first_value(self, value: ast.expr, kind: str) -> str:
        """Returns the text of a value of such a name: a number as a float or a tensor, and what is empty with its type."""
        text, device = self.expressions.text(value), self.expressions.device
        if kind == TENSOR:
            return f"torch.tensor({text}{f', device={device}' if device else ''})" if number_type(value) else text
        if number_type(value) == "int" and kind == FLOAT:
            return f"float({text})"
        whole = {"[]": f"List[{kind}]", "{}": f"Dict[str, {kind}]"}.get(text, "")
        return f"torch.jit.annotate({whole}, {text})" if whole else text


def _is_print(node: ast.expr) -> bool:
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print"
