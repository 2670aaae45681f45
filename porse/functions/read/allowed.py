"""Questions to the allow-list that need no walk, and the errors that name the nearest known names."""

import ast
import difflib
from collections.abc import Iterable, Mapping

from porse.functions.contract import (
    BUILTINS,
    HELPERS,
    MATH_NAMES,
    MAX_INTEGER,
    MAX_LOOP,
    NUMPY_NAMES,
    TORCH_CONSTANTS,
    TORCH_FUNCTIONS,
    TORCH_MODULES,
)
from porse.functions.verdict import CodeError
from porse.variables import Variable

_DEVICES = ("cuda", "cpu", "mps", "xpu", "meta", "hpu")
_KEYWORDS = frozenset(("out", "names", "generator", "pin_memory", "memory_format", "layout"))


def path_allowed(path: str) -> bool:
    """Whether a dotted path below torch, math or numpy may be used."""
    module, _, name = path.rpartition(".")
    if module == "numpy":
        return name in NUMPY_NAMES
    if module == "math":
        return name in MATH_NAMES
    if module == "torch":
        return name in TORCH_FUNCTIONS or name in TORCH_CONSTANTS
    return module.startswith("torch.") and name in TORCH_MODULES.get(module.removeprefix("torch."), ())


def check_literal(node: ast.Constant) -> None:
    """Refuses bytes, complex numbers and very large integers."""
    if isinstance(node.value, bytes | complex):
        raise CodeError("static", f"a {type(node.value).__name__} constant is not allowed", node.lineno)
    if isinstance(node.value, int) and abs(node.value) > MAX_INTEGER:
        raise CodeError("static", f"an integer constant is larger than {MAX_INTEGER}", node.lineno)


def check_identifier(name: str, line: int) -> None:
    """Refuses names that are not plain, and those that this package writes itself."""
    if not name.isascii() or name.startswith(("__", "porse_")) or name in ("torch", "math"):
        raise CodeError("static", f"the name {name!r} is not allowed here; use a plain ASCII name of your own", line)


def check_text(node: ast.Constant) -> None:
    """Refuses texts that are devices, or that reach for the inside of objects when they are formatted."""
    text = str(node.value)
    if text.split(":")[0].strip().lower() in _DEVICES:
        message = f"the device {text!r} is written into the code; use the device of an input, x.device"
        raise CodeError("device", message, node.lineno)
    if "__" in text and "{" in text:
        raise CodeError("static", "a text with __ inside braces is not allowed", node.lineno)


def check_keyword(node: ast.keyword) -> None:
    """Refuses keywords of a call that would write somewhere, or that have no meaning in a reward."""
    if node.arg is None:
        raise CodeError("static", "** in a call is not allowed", node.lineno)
    if node.arg in _KEYWORDS or not node.arg.isascii():
        raise CodeError("static", f"the keyword {node.arg} is not allowed", node.lineno)


def check_range(call: ast.Call) -> None:
    """Refuses a call of range with a large number in it."""
    for part in ast.walk(call):
        if isinstance(part, ast.Constant) and isinstance(part.value, int) and abs(part.value) > MAX_LOOP:
            raise CodeError("static", f"a loop of more than {MAX_LOOP} rounds is not allowed", call.lineno)


def nearest(name: str, known: Iterable[str]) -> str:
    """Returns the known names that look like `name`, nearest first, "" for none."""
    return ", ".join(difflib.get_close_matches(name, sorted(known), n=4, cutoff=0.5))


def unknown_variable(name: str, variables: Mapping[str, Variable], line: int) -> CodeError:
    """Returns the error for a name that the task does not offer."""
    near = nearest(name, variables)
    hint = f"the nearest are {near}" if near else f"it offers {', '.join(sorted(variables))}"
    return CodeError("variable", f"expected variables of the task, found {name}, which it does not offer; {hint}", line)


def unknown_name(name: str, variables: Mapping[str, Variable], local: Iterable[str], line: int) -> CodeError:
    """Returns the error for a name that is neither a variable, nor bound, nor an allowed function."""
    near = nearest(name, {*variables, *local, *BUILTINS, *HELPERS})
    hint = f"; the nearest known names are {near}" if near else ""
    return CodeError("variable", f"the name {name} is not defined and not allowed{hint}", line)
