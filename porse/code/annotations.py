"""Types in annotations: which are accepted, and how TorchScript spells them. No annotation is ever evaluated."""

import ast
from collections.abc import Mapping

from porse.code.contract import TORCH_CONSTANTS
from porse.code.hoist import number_type
from porse.code.scan import parse_expression
from porse.code.syntax import all_arguments, assigned_values, defaults
from porse.code.verdict import CodeError
from porse.variables import Variable

TYPE_OF_KIND = {"tensor": "Tensor", "int": "int", "float": "float", "device": "Device"}
_SPELLING = {
    **dict.fromkeys(("Tensor", "FloatTensor", "LongTensor", "BoolTensor"), "Tensor"),
    **{name: name for name in ("int", "float", "bool", "str", "Optional")},
    **dict.fromkeys(("List", "list"), "List"),
    **dict.fromkeys(("Tuple", "tuple"), "Tuple"),
    **dict.fromkeys(("Dict", "dict"), "Dict"),
    "device": "Device",
}
_GENERIC = ("List", "Tuple", "Dict", "Optional")
_OF_TENSORS = {"List": "List[Tensor]", "Dict": "Dict[str, Tensor]"}
_ACCEPTED = frozenset([*_SPELLING, "Union", "Any", "torch", "typing", "None", "Final", "Sequence", "jit"])


def check_annotation(node: ast.expr) -> None:
    """Accepts an annotation of names of types.

    Raises:
        CodeError: it holds anything else; check "static".
    """
    for part in ast.walk(node):
        if isinstance(part, ast.Name | ast.Attribute):
            name = part.id if isinstance(part, ast.Name) else part.attr
            if name not in _ACCEPTED and name not in TORCH_CONSTANTS:
                raise CodeError("static", f"the type {name} is not allowed in an annotation", part.lineno)
        elif isinstance(part, ast.Constant):
            if isinstance(part.value, str):
                check_annotation(_quoted(part))
            elif part.value is not None and part.value is not Ellipsis:
                raise CodeError("static", "a value is not allowed in an annotation", part.lineno)
        elif not isinstance(part, ast.Subscript | ast.Tuple | ast.BinOp | ast.BitOr | ast.Load | ast.List):
            raise CodeError("static", f"{type(part).__name__} is not allowed in an annotation", node.lineno)


def argument_type(node: ast.expr) -> str:
    """Returns TorchScript's type of a helper's argument, "" for one that it does not know; `dict` alone holds tensors."""
    return type_text(node) or _OF_TENSORS.get(_spelling(node), "")


def type_text(node: ast.expr | None) -> str:
    """Returns TorchScript's spelling of an annotation, "" for one that says too little; nothing is a Tensor."""
    if node is None:
        return "Tensor"
    if isinstance(node, ast.Constant):
        return type_text(_quoted(node)) if isinstance(node.value, str) else "None"
    if isinstance(node, ast.BinOp):
        sides = [type_text(side) for side in (node.left, node.right) if not isinstance(side, ast.Constant)]
        return f"Optional[{sides[0]}]" if len(sides) == 1 and sides[0] else ""
    if isinstance(node, ast.Subscript):
        outer = _spelling(node.value)
        inner = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        parts = [type_text(part) for part in inner]
        return f"{outer}[{', '.join(parts)}]" if outer and all(parts) else ""
    name = _spelling(node)
    return "" if name in _GENERIC else name


def _spelling(node: ast.expr) -> str:
    name = node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""
    return _SPELLING.get(name, "")


def value_type(node: ast.expr, function: ast.FunctionDef, variables: Mapping[str, Variable]) -> str:
    """Returns the type of an expression in a function where it is plain to see, else "".

    Plain to see is a number, a task's number, and a name that only ever holds numbers of one type.
    """
    if number_type(node) or not isinstance(node, ast.Name):
        return number_type(node)
    for argument in all_arguments(function):
        if argument.arg == node.id:
            declared = type_text(argument.annotation) if argument.annotation else ""
            known = variables[node.id].kind if node.id in variables else declared
            return known if known in ("int", "float") else number_type(defaults(function).get(node.id))
    kinds = {number_type(value) for value in assigned_values(function, node.id)}
    return kinds.pop() if len(kinds) == 1 else ""


def _quoted(node: ast.Constant) -> ast.expr:
    """Returns the tree of a type that is written as text."""
    text = str(node.value)
    if '"' in text or "'" in text or len(text) > 200:
        raise CodeError("static", "an annotation is not a type", node.lineno)
    return parse_expression(text, node)
