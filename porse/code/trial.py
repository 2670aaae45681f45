"""The first runs of a function, on real states, on more environments and on disturbed states, and their verdict."""

import types
import warnings
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, get_args

import torch
from torch import Tensor

from porse.code import sleef
from porse.code.compile import MappingFunction, RewardFunction, compile_mapping, compile_reward
from porse.code.contract import TORCH_MODULES, Kind
from porse.code.verdict import CodeError, Verdict
from porse.variables import Variable

_SCALES = (0.01, 0.1, 1.0, 10.0)
"""Sizes of the disturbances that an output must react to, times the spread of each variable, or times 1."""
_MANY = 2048
"""Environments of the second run: it shows what memory and time grow with."""

Compiled = RewardFunction | MappingFunction


def try_function(source: str, kind: Kind, variables: Sequence[Variable], values: Mapping[str, Any]) -> Verdict:
    """Returns the verdict on one source; its line is a line of the source.

    Args:
        source: the normalised source.
        kind: "reward" or "mapping".
        variables: what the task offers.
        values: the value of each variable in real states.
    """
    compiler = compile_reward if kind == "reward" else compile_mapping
    try:
        plain = compiler(source, variables, False)
        with torch.inference_mode():
            names, rises = _check_runs(plain.portable(), values)
            _outputs(plain, values)
    except CodeError as error:
        return Verdict(False, error.check, str(error), error.line)
    except MemoryError:
        return Verdict(False, "memory", "the function needs more memory than it may use", 0)
    return Verdict(True, "ok", "", 0, names, rises)


def _check_runs(function: Compiled, values: Mapping[str, Any]) -> tuple[tuple[str, ...], tuple[bool, ...]]:
    """Returns names and directions after all runs."""
    if not any(isinstance(values[name], Tensor) for name in function.arguments):
        raise CodeError(
            "constant", "the function reads no state of the task, so its output never changes", function.line
        )
    given = {n: v.clone() if isinstance(v, Tensor) else v for n, v in values.items() if n in function.arguments}
    outputs, rises = _outputs(function, given)
    _check_inputs(function, given, values)
    for name, output in outputs.items():
        _check_finite(name, output, function, values)
    many = {n: _tiled(n, v) for n, v in given.items()}
    for other in (many, given):
        again, flags = _outputs(function, other)
        if again.keys() != outputs.keys() or flags != rises:
            raise CodeError("names", "names and directions must be the same in every call", function.line)
    _check_reacts(function, values, outputs)
    function.run_branches(many)
    return tuple(name for name in outputs if name), rises


def _outputs(function: Compiled, values: Mapping[str, Any]) -> tuple[dict[str, Tensor], tuple[bool, ...]]:
    """Returns every output by name, the total reward as "", and the directions."""
    if isinstance(function, RewardFunction):
        total, components = function(values)
        return {**components, "": total}, ()
    progress, rises, names = function(values)
    return dict(zip(names, progress, strict=True)), tuple(rises)


def _tiled(name: str, value: Any) -> Any:
    """Returns the values of `_MANY` environments: the same states again and again."""
    if isinstance(value, Tensor):
        rounds = -(-_MANY // value.shape[0])
        return value.repeat(rounds, *[1] * (value.dim() - 1))[:_MANY]
    return _MANY if name == "num_envs" else value


def _check_inputs(function: Compiled, after: Mapping[str, Any], values: Mapping[str, Any]) -> None:
    for name in function.arguments:
        before = values[name]
        if isinstance(before, Tensor) and not torch.equal(after[name].nan_to_num(), before.nan_to_num()):
            message = f"the function changes its input {name} in place; work on {name}.clone()"
            raise CodeError("inplace", message, function.line)


def _check_finite(name: str, output: Tensor, function: Compiled, values: Mapping[str, Any]) -> None:
    bad = ~torch.isfinite(output)
    if not bool(bad.any()):
        return
    index = int(bad.nonzero()[0, 0])
    kind = "NaN" if bool(torch.isnan(output[index])) else "infinity"
    share = 100.0 * float(bad.float().mean())
    read = [n for n in dict.fromkeys(function.arguments) if isinstance(values[n], Tensor)]
    example = ", ".join(f"{n} = {_numbers(values[n][index])}" for n in read)
    message = (
        f"{_what(name, function)} is {kind} on {share:.1f} % of real states, for example where {example[:600]};"
        " guard the division, root, logarithm or arc that makes it"
    )
    raise CodeError("finite", message, function.line)


def _check_reacts(function: Compiled, values: Mapping[str, Any], outputs: Mapping[str, Tensor]) -> None:
    """Refuses outputs that are one number on real states and stay it however the inputs are disturbed.

    Single components may be constant in these states: a bonus that nobody has earned yet.
    """
    suspects = [n for n, v in outputs.items() if _constant(v) and (not n or isinstance(function, MappingFunction))]
    generator = torch.Generator().manual_seed(0)
    for scale in _SCALES:
        if not suspects:
            return
        disturbed = {n: _disturb(values[n], scale, generator) for n in function.arguments}
        try:
            found, _ = _outputs(function, disturbed)
        except CodeError:
            continue
        suspects = [n for n in suspects if n in found and _constant(found[n])]
    if suspects:
        what = _what(suspects[0], function)
        raise CodeError(
            "constant", f"{what} is the same number in all states, whatever the variables are", function.line
        )


def _constant(value: Tensor) -> bool:
    return value.numel() > 0 and bool((value == value[0]).all())


def _disturb(value: Any, scale: float, generator: torch.Generator) -> Any:
    if not isinstance(value, Tensor):
        return value
    noise = torch.randn(value.shape, generator=generator)
    if value.is_floating_point():
        spread = (value - value.mean(0, keepdim=True)).abs().amax().nan_to_num(1.0, 1.0, 1.0)
        return value + scale * noise * spread.clamp(min=1.0)
    return (value + (scale * 10 * noise.abs()).to(value.dtype)).to(value.dtype)


def _what(name: str, function: Compiled) -> str:
    if isinstance(function, MappingFunction):
        return f"the progress variable {name}"
    return f"the component {name}" if name else "the total reward"


def _numbers(value: Tensor) -> str:
    """Returns the first numbers of a tensor, four digits each."""
    text = ", ".join(f"{float(number):.4g}" for number in value.reshape(-1)[:8])
    return text if value.dim() == 0 else f"[{text}{', ...' if value.numel() > 8 else ''}]"


def warm_up() -> None:
    """Has torch prepare everything that it prepares once, so that no function needs a file later.

    Torch's functions that are written in Python are compiled from their source files on first use, and Sleef's
    operators are made.
    """
    variables = [Variable("x", "tensor", (3,), "1", "world", "")]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        for name in sorted(TORCH_MODULES["nn.functional"]):
            function = getattr(torch.nn.functional, name)
            if isinstance(function, types.FunctionType):
                torch.jit.script(function)
    source = (
        "def compute_reward(x):\n"
        "    d = torch.norm(x, dim=-1) + torch.norm(x, p=2, dim=1) + torch.norm(x) + torch.einsum('ij,ij->i', x, x)\n"
        "    p, q = torch.split(x, [1, 2], dim=-1)\n"
        "    s = torch.split(x, 1, dim=-1)[0]\n"
        "    u, v = torch.broadcast_tensors(x, x)\n"
        "    return torch.exp(-d) + p.sum() + s.sum() + u.sum() + torch.atleast_1d(x).sum(-1), {'d': d}\n"
    )
    for portable in (False, True):
        with torch.inference_mode():
            compile_reward(source, variables, portable)({"x": torch.zeros(3, 3)})
    if sleef.is_needed():
        for function, precision in product(get_args(sleef.Function), get_args(sleef.Precision)):
            sleef.operator(function, precision)
