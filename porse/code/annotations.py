"""Types in annotations: which are accepted, and how TorchScript spells them. No annotation is ever evaluated."""

import ast
from collections.abc import Callable, Mapping

from porse.functions.read.contract import TORCH_CONSTANTS
from porse.code.hoist import number_type
from porse.code.scan import parse_expression
from porse.code.syntax import all_arguments, assigned_values, defaults
from porse.functions.verdict import CodeError
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
_MAX_NAMES_ASKED = 32
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

    Plain to see is a number, a text, arithmetic of numbers, a task's number, a list or dictionary, which holds tensors where
    it holds anything else, and a name that only ever holds one of these.
    """
    return _type(node, function, variables, {})


def _type(node: ast.expr, function: ast.FunctionDef, variables: Mapping[str, Variable], seen: dict[str, str]) -> str:
    if isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str)):
        return "str"
    if isinstance(node, ast.List | ast.ListComp | ast.Dict | ast.DictComp):
        held = node.elts if isinstance(node, ast.List) else node.values if isinstance(node, ast.Dict) else []
        kinds = {_type(value, function, variables, seen) for value in held}
        kind = (kinds.pop() if len(kinds) == 1 else "") or "Tensor"
        return f"Dict[str, {kind}]" if isinstance(node, ast.Dict | ast.DictComp) else f"List[{kind}]"
    if isinstance(node, ast.Tuple):
        parts = [_type(value, function, variables, seen) for value in node.elts]
        return f"Tuple[{', '.join(parts)}]" if parts and all(parts) else ""
    if not isinstance(node, ast.Name):
        return number_kind(node, lambda part: _type(part, function, variables, seen))
    if node.id not in seen and len(seen) < _MAX_NAMES_ASKED:
        seen[node.id] = ""  # where it is asked for again meanwhile
        seen[node.id] = _type_of_name(node.id, function, variables, seen)
    return seen.get(node.id, "")


def _type_of_name(name: str, function: ast.FunctionDef, variables: Mapping[str, Variable], seen: dict[str, str]) -> str:
    for argument in all_arguments(function):
        if argument.arg == name:
            declared = type_text(argument.annotation) if argument.annotation else ""
            known = variables[name].kind if name in variables else declared
            return known if known in ("int", "float") else number_type(defaults(function).get(name))
    kinds = {_type(value, function, variables, seen) for value in assigned_values(function, name)}
    for node in ast.walk(function):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.target.id == name:
            kinds.add(type_text(node.annotation))
    return kinds.pop() if len(kinds) == 1 and not _is_bound_otherwise(name, function) else ""


def _is_bound_otherwise(name: str, function: ast.FunctionDef) -> bool:
    """Whether a name is bound by anything but an assignment to it alone: a loop, or a tuple that is taken apart."""
    alone = {
        id(target)
        for node in ast.walk(function)
        if isinstance(node, ast.Assign | ast.AnnAssign | ast.AugAssign)
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
    }
    names = (node for node in ast.walk(function) if isinstance(node, ast.Name) and node.id == name)
    return any(isinstance(node.ctx, ast.Store) and id(node) not in alone for node in names)


def number_kind(node: ast.expr, kind_of_name: Callable[[ast.expr], str]) -> str:
    """Returns "int", "float" or "bool" for a number that is written out, or arithmetic of some, "" for anything else."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub | ast.Mult | ast.Div | ast.Pow):
        sides = {kind_of_name(node.left), kind_of_name(node.right)}
        if not sides <= {"int", "float"}:
            return ""
        return "float" if "float" in sides or isinstance(node.op, ast.Div) else "int"
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        return kind_of_name(node.operand)
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        return "float" if node.attr in ("pi", "e", "inf") and node.value.id in ("math", "torch", "np", "numpy") else ""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and isinstance(node.func.value, ast.Name):
        if node.func.value.id in ("np", "numpy"):  # most of its functions take tensors as well
            return "float" if all(map(kind_of_name, node.args)) and node.func.attr not in ("abs", "absolute") else ""
        return "float" if node.func.value.id == "math" and node.func.attr not in ("floor", "ceil") else ""
    return number_type(node)


def _quoted(node: ast.Constant) -> ast.expr:
    """Returns the tree of a type that is written as text."""
    text = str(node.value)
    if '"' in text or "'" in text or len(text) > 200:
        raise CodeError("static", "an annotation is not a type", node.lineno)
    return parse_expression(text, node)
