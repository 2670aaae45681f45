"""A checked source as Python that runs: its tree without what has no meaning here, and the names that it may use.

This is the one place where generated text becomes code. `porse.functions.read.trace` runs it, in a confined process, after
the static check.
"""

import ast
import builtins
import contextlib
import math
import sys
from collections.abc import Callable, Mapping
from types import CodeType, SimpleNamespace
from typing import Any

import torch

from porse.functions.read.check import ERRORS
from porse.functions.read.contract import BUILTINS, MATH_NAMES, NUMPY_NAMES, TORCH_CONSTANTS, TORCH_FUNCTIONS, TORCH_MODULES, words
from porse.functions.read.prelude import HELPERS_IN_SCOPE
from porse.functions.read.source import Source, all_arguments, is_class, takes_self
from porse.functions.verdict import CodeError

FILE = "<function>"
"""What Python calls the source in its tracebacks."""
_OF_EVERY_TASK = words("actions device num_envs obs_buf progress_buf")
"""What `self` has in the tasks, whatever a class around the function sets when it is made."""


def compiled(source: Source) -> CodeType:
    """Returns the code of a source: its constants, then its functions."""
    body: list[ast.stmt] = [*source.constants.values(), *source.functions]
    tree = ast.Module(body=[_Plain().visit(statement) for statement in body], type_ignores=[])
    return compile(ast.fix_missing_locations(tree), FILE, "exec", dont_inherit=True)


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
        is_print = isinstance(node.value, ast.Call) and isinstance(node.value.func, ast.Name) and node.value.func.id == "print"
        return ast.copy_location(ast.Pass(), node) if is_print else self.generic_visit(node)

    def _left_out(self, node: ast.stmt) -> ast.AST:
        return ast.copy_location(ast.Pass(), node)

    visit_Assert = visit_Import = visit_ImportFrom = _left_out

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
        "getattr": lambda owner, name: _attribute(owner, name, own),
    }
    exec(code, space)
    for name in source.constants:
        if name not in _OF_EVERY_TASK:
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


def _cross(a: torch.Tensor, b: torch.Tensor, dim: int = -1) -> torch.Tensor:
    """As torch's, along the last dimension: torch would take the first of size 3, the wrong one for three environments."""
    return torch.cross(a, b, dim=dim)


def _names(owner: Any, names: frozenset[str]) -> dict[str, Any]:
    return {name: getattr(owner, name) for name in sorted(names) if hasattr(owner, name)}


_MATH = SimpleNamespace(**_names(math, MATH_NAMES))
_FUNCTIONAL = SimpleNamespace(**_names(torch.nn.functional, TORCH_MODULES["nn.functional"]))
_NN = SimpleNamespace(functional=_FUNCTIONAL)
_TORCH = SimpleNamespace(
    **_names(torch, TORCH_FUNCTIONS | TORCH_CONSTANTS)
    | {"cross": _cross, "no_grad": contextlib.nullcontext, "inference_mode": contextlib.nullcontext, "nn": _NN}
    | {"linalg": SimpleNamespace(**_names(torch.linalg, TORCH_MODULES["linalg"]))}
    | {"special": SimpleNamespace(**_names(torch.special, TORCH_MODULES["special"]))}
)
_NUMPY = SimpleNamespace(**{
    name: getattr(_MATH, path.removeprefix("math.")) if path.startswith("math.") else getattr(builtins, path)
    for name, path in NUMPY_NAMES.items()
})  # fmt: skip
_SPACES = {"torch": _TORCH, "math": _MATH, "numpy": _NUMPY, "torch.nn": _NN, "torch.nn.functional": _FUNCTIONAL} | {
    f"torch.{name}": getattr(_TORCH, name) for name in ("linalg", "special")
}
