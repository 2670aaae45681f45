"""The verdict on one generated function, the error of one that has none, and what the two rooms both know of names."""

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

from porse.errors import PorseError


def words(text: str) -> frozenset[str]:
    """Returns the words of a text: how the long lists here and elsewhere are written."""
    return frozenset(text.split())


Kind = Literal["reward", "mapping"]

MAX_NAMES = 8
"""Progress variables of one mapping at most."""

MAX_COMPONENTS = 32
"""Components of one reward at most."""

MAX_NAME_CHARACTERS = 64
"""Names of components and progress variables are cut to this length."""

TENSOR_FUNCTIONS = words("""
        abs absolute acos acosh add addcdiv addcmul all amax amin any arccos arccosh arcsin arcsinh arctan arctan2
    arctanh argmax argmin argsort asin asinh atan atan2 atanh baddbmm bitwise_and bitwise_not bitwise_or bmm
    broadcast_to ceil chunk clamp clamp_max clamp_min clip clone conj copysign cos cosh count_nonzero cross cummax
    cummin cumprod cumsum deg2rad diagonal diff dist div divide dot eq erf exp exp2 expm1 fix flatten flip floor
    floor_divide fmax fmin fmod frac gather ge greater greater_equal gt heaviside hypot index_select inner isclose
    isfinite isinf isnan isneginf isposinf le lerp less less_equal log log10 log1p log2 log_softmax logaddexp
    logical_and logical_not logical_or logical_xor logit logsumexp lt masked_fill matmul max maximum mean median min
    minimum mm moveaxis movedim mul multiply mv nan_to_num nanmean nansum narrow ne neg negative norm not_equal
    outer permute positive pow prod rad2deg ravel reciprocal relu remainder reshape roll round rsqrt select sgn
    sigmoid sign signbit sin sinc sinh softmax sort split sqrt square squeeze std sub subtract sum swapaxes swapdims
    t take_along_dim tan tanh tile topk trace transpose tril triu true_divide trunc unbind unflatten unsqueeze var
    where xlogy
    """)
"""Names that are functions of torch, methods of tensors and operators alike."""

Check = Literal[
    "ok", "extract", "syntax", "static", "variable", "device", "type", "return", "inplace", "names", "shape", "finite",
    "large", "constant", "run", "time", "memory", "crash",
]  # fmt: skip
"""Which check decided; `docs/generated-code.md` says what each one asks for."""


@dataclass(frozen=True)
class Verdict:
    """What the checks say about one submitted function.

    Attributes:
        passed: the function may be used.
        check: the check that decided, "ok" when passed.
        message: one paragraph for a person and for a repair prompt, empty when passed.
        line: line of the reply, counted from 1, that the message is about; 0 when it is about no one line.
        names: the reward components, or the progress variables; empty unless passed.
        rises: one flag for each progress variable, true when the task needs it to rise; empty for rewards.
        warning: what a person should know of a function that passed, else empty.
        program: the text of the operator list that stands for the function from now on; empty unless passed.
    """

    passed: bool
    check: Check
    message: str
    line: int
    names: tuple[str, ...] = ()
    rises: tuple[bool, ...] = ()
    warning: str = ""
    program: str = ""


class CodeError(PorseError):
    """A generated function was refused or failed.

    Attributes:
        check: the check that refused it.
        line: line of the function's source, counted from 1; 0 when the error is about no one line.
    """

    def __init__(self, check: Check, message: str, line: int = 0) -> None:
        super().__init__(message)
        self.check: Check = check
        self.line = line


@lru_cache(maxsize=1024)
def plain_name(name: str) -> str:
    """Returns a name of at most 64 letters, digits and underscores, "unnamed" when nothing is left."""
    return re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")[:MAX_NAME_CHARACTERS].rstrip("_") or "unnamed"
