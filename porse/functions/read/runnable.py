"""A checked source as Python that runs: its tree without what has no meaning here, and the names that it may use.

This is the one place where generated text becomes code. `porse.functions.read.trace` runs it, in a confined process, after
the static check.
"""

import __future__

import ast
import builtins
import math
import operator
import re
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence, Set, ValuesView
from types import CodeType, MethodType, NoneType, SimpleNamespace
from typing import Any

import torch
from torch.overrides import TorchFunctionMode
from torch.utils._ordered_set import OrderedSet

from porse.functions import contract
from porse.functions.read.extract import Source, arguments, takes_self
from porse.functions.verdict import CodeError
from porse.helpers import HELPERS_IN_SCOPE


def offered(path: str) -> Any:
    """Returns what stands for a dotted path, a namespace for a module; None where it is not offered."""
    found: Any = _MODULES
    for name in path.split("."):
        found = vars(found).get(name) if is_module(found) else None
    return found


def is_module(found: Any) -> bool:
    """Whether what is offered is a module: only the names in it are of use."""
    return isinstance(found, SimpleNamespace)


def _names(owner: Any, names: frozenset[str], **inner: SimpleNamespace) -> SimpleNamespace:
    return SimpleNamespace(**{name: getattr(owner, name) for name in names if hasattr(owner, name)}, **inner)


def _of_numpy(path: str) -> Any:
    """Returns a constant of numpy's, or a function of numbers that takes tensors as well where torch has one."""
    module, _, name = path.rpartition(".")
    of_numbers = getattr(math if module else builtins, name)
    of_tensors = getattr(torch, name, None)
    if not callable(of_numbers) or of_tensors is None:
        return of_numbers
    return lambda *given: (of_tensors if isinstance(given[0], torch.Tensor) else of_numbers)(*given)


_MODULES = SimpleNamespace(
    torch=_names(
        torch,
        contract.TORCH_FUNCTIONS | contract.TORCH_CONSTANTS,
        linalg=_names(torch.linalg, contract.TORCH_MODULES["linalg"]),
        special=_names(torch.special, contract.TORCH_MODULES["special"]),
        nn=SimpleNamespace(functional=_names(torch.nn.functional, contract.TORCH_MODULES["nn.functional"])),
    ),
    math=_names(math, contract.MATH_NAMES),
    numpy=SimpleNamespace(**{name: _of_numpy(path) for name, path in contract.NUMPY_NAMES.items()}),
)


FILE = "<function>"
"""What Python calls the source in its tracebacks."""


def compiled(source: Source) -> CodeType:
    """Returns the code of a source: its constants, then its functions. No annotation is evaluated."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.fix_missing_locations(_Runnable().visit(source.tree))
            return compile(tree, FILE, "exec", __future__.annotations.compiler_flag, dont_inherit=True)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        line = getattr(error, "lineno", 0) or 0
        raise CodeError("syntax", f"Python cannot compile the function: {getattr(error, 'msg', error)}", line) from None


class _Runnable(ast.NodeTransformer):
    """Leaves out imports, prints and asserts: nothing depends on them, and a print would look at numbers.

    What the static check cannot tell is asked where it runs: whose an attribute is, and of what a text is made. Sets keep the
    order in which they are filled.
    """

    def visit(self, node: ast.AST) -> Any:
        """Returns what stands for a node, whose parts come first."""
        match node:
            case ast.Call(func=ast.Attribute(attr="annotate"), args=[_, value]):
                return self.visit(value)
        self.generic_visit(node)
        match node:
            case ast.Import() | ast.ImportFrom() | ast.Assert() | ast.Expr(value=ast.Call(func=ast.Name(id="print"))):
                return ast.copy_location(ast.Pass(), node)
            case ast.With():  # torch.no_grad() says what holds everywhere
                return node.body
            case ast.Set(elts=[ast.Dict() as held]):  # {{"near": r}} is what an f-string left of a dictionary
                return held
            case ast.Set(elts=held):
                return _asked("set", node, ast.List(elts=held, ctx=ast.Load()))
            case ast.SetComp(elt=part, generators=loops):
                return _asked("set", node, ast.ListComp(elt=part, generators=loops))
            case ast.Attribute(value=owner, attr=name):
                return _asked("attribute", node, owner, ast.Constant(name))
            case ast.FormattedValue(value=value):
                node.value = _asked("plain", node, value)
            case ast.BinOp(op=ast.Mod(), right=value):
                node.right = _asked("plain", node, value)
            case ast.AugAssign(target=ast.Name(), op=ast.Mod(), value=value):
                node.value = _asked("plain", node, value)
            case ast.AugAssign(target=ast.Subscript(value=owner, slice=index), op=op, value=value):
                # x[near] += 1.0 reads as many rows as the data say; as a choice in every row it has a fixed shape.
                if not isinstance(index, ast.Slice | ast.Tuple):
                    word = ast.Constant(type(op).__name__)
                    return ast.copy_location(ast.Expr(_asked("augment", node, owner, index, word, value)), node)
        return node


def _asked(name: str, node: ast.AST, *given: ast.expr) -> ast.expr:
    """Returns the call of a function of `main_function`, in the place of a node."""
    call = ast.Call(func=ast.Name(id=f"porse_{name}", ctx=ast.Load()), args=[*given], keywords=[])
    return ast.copy_location(call, node)


class _Root(int):
    """The column of an actor in the root states, `ROOT_INDICES`."""


class RootColumns(TorchFunctionMode):
    """Reads `x[_Root(2), 0:3]` as `x[:, 2, 0:3]` while it is entered: that actor of every environment."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Calls a function of torch, an index with the column where it belongs."""
        if func in (torch.Tensor.__getitem__, torch.Tensor.__setitem__):
            index = args[1] if isinstance(args[1], tuple) else (args[1],)
            if index and isinstance(index[0], _Root):
                args = (args[0], (slice(None), *index), *args[2:])
        return func(*args, **(kwargs or {}))


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
    values = {name: _Root(value) if name in contract.ROOT_INDICES else value for name, value in values.items()}
    own = _Holder(**HELPERS_IN_SCOPE | values)
    space: dict[str, Any] = dict.fromkeys(source.classes, own)
    space |= {**vars(own), **{name: offered(path) for name, path in source.modules.items()}}
    space["__builtins__"] = {name: getattr(builtins, name) for name in contract.BUILTINS | contract.ERRORS} | {
        "print": lambda *parts, **more: None,
        "__import__": _loaded,
        "set": OrderedSet,
        "str": lambda value="": str(_plain(value)),
        "porse_augment": _augment,
        "porse_plain": _plain,
        "porse_set": OrderedSet,
        "porse_attribute": lambda owner, name: _attribute(owner, name, own),
        "getattr": lambda owner, name: _attribute(owner, name, own),
    }
    exec(code, space)
    vars(own).update({name: space[name] for name in source.constants})
    for function in source.functions:
        made = space[function.name]
        setattr(own, function.name, MethodType(made, own) if takes_self(function) else made)
    given = {name: values[name] for name in arguments(source.main) if name in values}
    main = getattr(own, source.main.name)
    return lambda: main(**given)


def _attribute(owner: Any, name: str, own: _Holder) -> Any:
    """Returns what is offered of a value: a variable or a function of `self`, a name of a module, a method of all else."""
    if isinstance(owner, SimpleNamespace) and name in vars(owner):
        return vars(owner)[name]
    if isinstance(owner, str) and name == "format":
        return lambda *given, **named: _fill(owner, given, named)
    if owner is own or name not in contract.METHODS | contract.ATTRIBUTES:
        found = f".{str(_plain(name))[:100]} of {'self' if owner is own else f'a {type(owner).__name__}'}"
        raise CodeError("static", f"expected a variable of self or a method that is offered, found {found}")
    return getattr(owner, name)


def _fill(text: str, given: Sequence[Any], named: Mapping[str, Any]) -> str:
    """Returns a text with plain values in its braces."""
    if re.search(r"{[^{}:!]*[.[]", text):  # would reach for the inside of objects
        raise CodeError("static", "braces hold a name or a number alone when a text is filled; use an f-string")
    return text.format(*_plain(given), **_plain(named))


_WORDED = (
    str, int, float, NoneType, range, torch.Tensor, torch.dtype, torch.device, torch.layout, torch.memory_format,
)  # fmt: skip
"""What has the same text in every process; numbers of tensors are not to be had, which torch is asked for."""


def _plain(value: Any) -> Any:
    """Returns a value whose text is the same in every process; refuses one whose text says where it lies in memory."""
    parts = [*value, *value.values()] if isinstance(value, Mapping) else value
    if isinstance(parts, Sequence | Set | ValuesView) and not isinstance(value, str):
        for part in parts:
            _plain(part)
    elif not isinstance(value, _WORDED):
        raise CodeError("static", f"a {type(value).__name__} has no text of its own; write its name out")
    return value


_OPERATORS = {
    "Add": "add", "Sub": "sub", "Mult": "mul", "Div": "truediv", "Pow": "pow", "FloorDiv": "floordiv", "Mod": "mod",
    "MatMult": "matmul", "LShift": "lshift", "RShift": "rshift", "BitAnd": "and", "BitOr": "or", "BitXor": "xor",
}  # fmt: skip


def _augment(owner: Any, index: Any, name: str, value: Any) -> None:
    """Does `owner[index] += value` and its like, with a choice in every row where `index` is a mask."""
    word = _OPERATORS[name]
    if isinstance(owner, torch.Tensor) and isinstance(index, torch.Tensor) and index.dtype is torch.bool:
        rest = owner.shape[index.dim() :]
        if not isinstance(value, torch.Tensor) or value.dim() == 0 or value.shape == rest:
            rows = index.reshape(*index.shape, *[1] * len(rest))
            owner.copy_(torch.where(rows, getattr(operator, f"__{word}__")(owner, value), owner))
            return
    owner[index] = getattr(operator, f"__i{word}__")(owner[index], value)


def _loaded(name: str, *others: Any, **more: Any) -> Any:
    """Returns a module of torch that is loaded: torch's C++ asks for some by the names of the function that calls it."""
    if name.partition(".")[0] != "torch":
        raise CodeError("static", f"the import of {name} is not allowed; only torch, math and typing are offered")
    return sys.modules[name]
