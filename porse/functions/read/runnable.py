"""A checked source as Python that runs: its tree without what has no meaning here, and the names that it may use.

This is the one place where generated text becomes code. `porse.functions.read.trace` runs it, in a confined process, after
the static check.
"""

import ast
import builtins
import contextlib
import math
import operator
import sys
import warnings
from collections.abc import Callable, Mapping
from types import CodeType, SimpleNamespace
from typing import Any

import torch

from porse.functions.contract import (
    BUILTINS,
    MATH_NAMES,
    NUMPY_NAMES,
    TORCH_CONSTANTS,
    TORCH_FUNCTIONS,
    TORCH_MODULES,
)
from porse.functions.read.check import ERRORS
from porse.functions.read.prelude import HELPERS_IN_SCOPE
from porse.functions.read.source import Source, all_arguments, is_class, takes_self
from porse.functions.verdict import CodeError

FILE = "<function>"
"""What Python calls the source in its tracebacks."""


def compiled(source: Source) -> CodeType:
    """Returns the code of a source: its constants, then its functions."""
    body: list[ast.stmt] = [*source.constants.values(), *source.functions]
    tree = ast.Module(body=[_Plain().visit(statement) for statement in body], type_ignores=[])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return compile(ast.fix_missing_locations(tree), FILE, "exec", dont_inherit=True)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        line = getattr(error, "lineno", 0) or 0
        raise CodeError("syntax", f"Python cannot compile the function: {getattr(error, 'msg', error)}", line) from None


class _Plain(ast.NodeTransformer):
    """Leaves out annotations, imports, prints and asserts: nothing depends on them, and a print would look at numbers."""

    def visit_arg(self, node: ast.arg) -> ast.AST:
        node.annotation = None
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.returns = None
        return self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        self.generic_visit(node)
        if node.value is None:
            return ast.copy_location(ast.Pass(), node)
        return ast.copy_location(ast.Assign(targets=[node.target], value=node.value), node)

    def visit_Expr(self, node: ast.Expr) -> ast.AST:
        is_print = (
            isinstance(node.value, ast.Call) and isinstance(node.value.func, ast.Name) and node.value.func.id == "print"
        )
        return ast.copy_location(ast.Pass(), node) if is_print else self.generic_visit(node)

    def _left_out(self, node: ast.stmt) -> ast.AST:
        return ast.copy_location(ast.Pass(), node)

    def visit_Assert(self, node: ast.Assert) -> ast.AST:
        return self._left_out(node)

    def visit_Import(self, node: ast.Import) -> ast.AST:
        return self._left_out(node)

    def visit_ImportFrom(self, node: ast.ImportFrom) -> ast.AST:
        return self._left_out(node)

    def visit_Set(self, node: ast.Set) -> ast.AST:
        """`{{"near": r}}` is what an f-string left of a dictionary."""
        self.generic_visit(node)
        return node.elts[0] if len(node.elts) == 1 and isinstance(node.elts[0], ast.Dict) else node

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.AST:
        """`x[near] += 1.0` reads as many rows as the data say; written as a choice in every row it has a fixed shape."""
        self.generic_visit(node)
        if not isinstance(node.target, ast.Subscript) or isinstance(node.target.slice, ast.Slice | ast.Tuple):
            return node
        operator = ast.Constant(type(node.op).__name__)
        given = [node.target.value, node.target.slice, operator, node.value]
        call = ast.Call(func=ast.Name(id="porse_augment", ctx=ast.Load()), args=given, keywords=[])
        return ast.fix_missing_locations(ast.copy_location(ast.Expr(call), node))

    def visit_Call(self, node: ast.Call) -> ast.AST:
        self.generic_visit(node)
        is_annotate = isinstance(node.func, ast.Attribute) and node.func.attr == "annotate" and len(node.args) == 2
        return node.args[1] if is_annotate else node


class _Holder(SimpleNamespace):
    """What `self`, a class and what is made of one stand for: variables, constants and functions as attributes."""

    def __call__(self) -> "_Holder":
        """Returns itself: a class that is made keeps nothing."""
        return self


def main_function(source: Source, code: CodeType, values: Mapping[str, Any]) -> Callable[[], Any]:
    """Returns the source's function as one without arguments, its constants computed.

    Args:
        source: a checked source.
        code: what `compiled` made of it.
        values: the task's variables by name.
    """
    own = _Holder(**{**HELPERS_IN_SCOPE, **values})
    space: dict[str, Any] = {**HELPERS_IN_SCOPE, **values}
    space |= {name: _found(path) for name, path in source.modules.items()}
    for node in ast.walk(ast.Module(body=[*source.functions, *source.constants.values()], type_ignores=[])):
        if isinstance(node, ast.Name) and is_class(node):
            space.setdefault(node.id, own)
    space["__builtins__"] = {name: getattr(builtins, name) for name in BUILTINS | ERRORS} | {
        "print": lambda *parts, **more: None,
        "__import__": _loaded,
        "porse_augment": _augment,
        "getattr": lambda owner, name: _attribute(owner, name, own),
    }
    exec(code, space)
    for name in source.constants:
        setattr(own, name, space[name])
    for function in source.functions:
        setattr(own, function.name, _bound(space[function.name], own) if takes_self(function) else space[function.name])
    given = {a.arg: values[a.arg] for a in all_arguments(source.main) if a.arg in values}
    main = getattr(own, source.main.name)
    return lambda: main(**given)


def _bound(function: Callable[..., Any], own: _Holder) -> Callable[..., Any]:
    return lambda *given, **named: function(own, *given, **named)


def _attribute(owner: Any, name: str, own: _Holder) -> Any:
    """Returns a variable, a constant or a function of `self`: all that may be asked for by a name that is put together."""
    if owner is not own or not isinstance(name, str) or name.startswith("_") or not hasattr(own, name):
        raise CodeError("static", f"getattr is for the variables of self alone, and found {str(name)[:100]!r}")
    return getattr(own, name)


_IN_PLACE: dict[str, tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]]] = {
    "Add": (operator.add, operator.iadd), "Sub": (operator.sub, operator.isub), "Mult": (operator.mul, operator.imul),
    "Div": (operator.truediv, operator.itruediv), "Pow": (operator.pow, operator.ipow),
    "FloorDiv": (operator.floordiv, operator.ifloordiv), "Mod": (operator.mod, operator.imod),
    "BitAnd": (operator.and_, operator.iand), "BitOr": (operator.or_, operator.ior), "BitXor": (operator.xor, operator.ixor),
}  # fmt: skip


def _augment(owner: Any, index: Any, name: str, value: Any) -> None:
    """Does `owner[index] += value` and its like, with a choice in every row where `index` is a mask."""
    plain, in_place = _IN_PLACE[name]
    if isinstance(owner, torch.Tensor) and isinstance(index, torch.Tensor) and index.dtype is torch.bool:
        rest = owner.shape[index.dim() :]
        if not isinstance(value, torch.Tensor) or value.dim() == 0 or value.shape == rest:
            owner.copy_(torch.where(index.reshape(*index.shape, *[1] * len(rest)), plain(owner, value), owner))
            return
    owner[index] = in_place(owner[index], value)


def _loaded(name: str, *others: Any, **more: Any) -> Any:
    """Returns a module of torch that is loaded: torch's C++ asks for some by the names of the function that calls it."""
    if name.partition(".")[0] != "torch":
        raise CodeError("static", f"the import of {name} is not allowed; only torch, math and typing are offered")
    return sys.modules[name]


def _found(path: str) -> Any:
    """Returns what stands for a module, or for one name of it; what is not offered is not there."""
    if path in _SPACES:
        return _SPACES[path]
    module, _, name = path.rpartition(".")
    return getattr(_SPACES.get(module), name, None)


def _names(owner: Any, names: frozenset[str]) -> dict[str, Any]:
    return {name: getattr(owner, name) for name in sorted(names) if hasattr(owner, name)}


_MATH = SimpleNamespace(**_names(math, MATH_NAMES))
_FUNCTIONAL = SimpleNamespace(**_names(torch.nn.functional, TORCH_MODULES["nn.functional"]))
_NN = SimpleNamespace(functional=_FUNCTIONAL)
_TORCH = SimpleNamespace(
    **_names(torch, TORCH_FUNCTIONS | TORCH_CONSTANTS)
    | {"no_grad": contextlib.nullcontext, "inference_mode": contextlib.nullcontext, "nn": _NN}
    | {"linalg": SimpleNamespace(**_names(torch.linalg, TORCH_MODULES["linalg"]))}
    | {"special": SimpleNamespace(**_names(torch.special, TORCH_MODULES["special"]))}
)


def _of_numpy(path: str) -> Any:
    """Returns a constant of numpy's, or a function of numbers that takes tensors as well where torch has one."""
    module, _, name = path.rpartition(".")
    of_numbers = getattr(math if module else builtins, name)
    of_tensors = getattr(torch, name, None)
    if not callable(of_numbers) or of_tensors is None:
        return of_numbers
    return lambda *given: (of_tensors if isinstance(given[0], torch.Tensor) else of_numbers)(*given)


_NUMPY = SimpleNamespace(**{name: _of_numpy(path) for name, path in NUMPY_NAMES.items()})
_SPACES = {"torch": _TORCH, "math": _MATH, "numpy": _NUMPY, "torch.nn": _NN, "torch.nn.functional": _FUNCTIONAL} | {
    f"torch.{name}": getattr(_TORCH, name) for name in ("linalg", "special")
}
