"""What a function may use of torch, math and numpy: the names that it runs with, and no others."""

import builtins
import math
from types import SimpleNamespace
from typing import Any

import torch

from porse.functions.contract import MATH_NAMES, NUMPY_NAMES, TORCH_CONSTANTS, TORCH_FUNCTIONS, TORCH_MODULES
from porse.functions.verdict import words

ERRORS = words("Exception ArithmeticError AssertionError IndexError KeyError RuntimeError TypeError ValueError")
"""What may be raised."""


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
        TORCH_FUNCTIONS | TORCH_CONSTANTS,
        linalg=_names(torch.linalg, TORCH_MODULES["linalg"]),
        special=_names(torch.special, TORCH_MODULES["special"]),
        nn=SimpleNamespace(functional=_names(torch.nn.functional, TORCH_MODULES["nn.functional"])),
    ),
    math=_names(math, MATH_NAMES),
    numpy=SimpleNamespace(**{name: _of_numpy(path) for name, path in NUMPY_NAMES.items()}),
)
