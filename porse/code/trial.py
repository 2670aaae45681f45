"""The first runs of a function, on real states and on disturbed ones, and the verdict they lead to."""

import random
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from porse.code.compile import MappingFunction, RewardFunction, compile_mapping, compile_reward
from porse.code.contract import Kind
from porse.code.verdict import CodeError, Verdict
from porse.variables import Variable

_SCALES = (0.01, 0.1, 1.0, 10.0)
"""Sizes of the disturbances that a function must react to, times the spread of each variable or 1."""


def try_function(source: str, kind: Kind, variables: Sequence[Variable], values: Mapping[str, Any]) -> Verdict:
    """Returns the verdict on one source; its line is a line of the source."""
    try:
        for portable in (False, True):
            names, rises = _try_one(source, kind, variables, values, portable)
    except CodeError as error:
        return Verdict(False, error.check, str(error), error.line)
    except (MemoryError, RuntimeError) as error:
        if isinstance(error, MemoryError) or "memory" in str(error):
            return Verdict(False, "memory", "the function needs more memory than it may use", 0)
        raise
    return Verdict(True, "ok", "", 0, names, rises)


def _try_one(
    source: str, kind: Kind, variables: Sequence[Variable], values: Mapping[str, Any], portable: bool
) -> tuple[tuple[str, ...], tuple[bool, ...]]:
    compiler = compile_reward if kind == "reward" else compile_mapping
    function = compiler(source, variables, portable)
    if not function.arguments:
        raise CodeError("constant", "the function reads no variable of the task, so that its output never changes")
    with torch.inference_mode():
        before = {n: v.clone() if isinstance(v, Tensor) else v for n, v in values.items() if n in function.arguments}
        outputs, rises = _outputs(function, before)
        _check_inputs(function, before, values)
        for name, output in outputs.items():
            _check_finite(name, output, function, values)
        _check_reacts(function, values, outputs)
    names = tuple(name for name in outputs if name != "")
    return names, rises


def _outputs(function: RewardFunction | MappingFunction, values: Mapping[str, Any]) -> tuple[dict[str, Tensor], tuple[bool, ...]]:
    """Returns every output by name, the total reward as "", and the directions."""
    if isinstance(function, RewardFunction):
        total, components = function(values)
        return {**components, "": total}, ()
    progress, rises, names = function(values)
    return dict(zip(names, progress, strict=True)), tuple(rises)


def _check_inputs(function: RewardFunction | MappingFunction, after: Mapping[str, Any], values: Mapping[str, Any]) -> None:
    for name in function.arguments:
        if isinstance(values[name], Tensor) and not torch.equal(
            torch.nan_to_num(after[name]), torch.nan_to_num(values[name])
        ):
            raise CodeError("inplace", f"the function changes its input {name} in place; work on {name}.clone()")


def _check_finite(name: str, output: Tensor, function: RewardFunction | MappingFunction, values: Mapping[str, Any]) -> None:
    bad = ~torch.isfinite(output)
    if not bool(bad.any()):
        return
    index = int(bad.nonzero()[0, 0])
    what = _what(name, function)
    kind = "NaN" if bool(torch.isnan(output[index])) else "infinity"
    share = 100.0 * float(bad.float().mean())
    example = ", ".join(
        f"{n} = {_numbers(values[n][index])}" for n in dict.fromkeys(function.arguments) if isinstance(values[n], Tensor)
    )
    raise CodeError("finite", f"{what} is {kind} on {share:.1f} % of real states, for example where {example[:600]}")


def _check_reacts(function: RewardFunction | MappingFunction, values: Mapping[str, Any], outputs: Mapping[str, Tensor]) -> None:
    """Refuses outputs that are one constant on real states and stay it however the inputs are disturbed."""
    suspects = [n for n, v in outputs.items() if _constant(v) and (n == "" or isinstance(function, MappingFunction))]
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
        raise CodeError("constant", f"{what} is the same number in all states, whatever the variables are")


def _constant(value: Tensor) -> bool:
    return value.numel() > 0 and bool((value == value[0]).all())


def _disturb(value: Any, scale: float, generator: torch.Generator) -> Any:
    if not isinstance(value, Tensor):
        return value
    noise = torch.randn(value.shape, generator=generator)
    if value.is_floating_point():
        return value + scale * noise * value.std().clamp(min=1.0)
    return (value + (scale * 10 * noise.abs()).to(value.dtype)).to(value.dtype)


def _what(name: str, function: RewardFunction | MappingFunction) -> str:
    if isinstance(function, MappingFunction):
        return f"the progress variable {name}"
    return f"the component {name}" if name else "the total reward"


def _numbers(value: Tensor) -> str:
    """Returns the first numbers of a tensor, four digits each."""
    flat = value.reshape(-1)[:8]
    text = ", ".join(f"{float(number):.4g}" for number in flat)
    return text if value.dim() == 0 else f"[{text}{', ...' if value.numel() > 8 else ''}]"


def warm_up(variables: Sequence[Variable]) -> None:
    """Compiles and runs a small function once, so that torch's own preparations happen before the first fork."""
    name = next((v.name for v in variables if v.kind == "tensor"), "x")
    known = [*variables, Variable("x", "tensor", (3,), "1", "world", "")]
    source = (
        f"def compute_reward({name}):\n"
        f"    d = torch.norm({name}.reshape({name}.shape[0], -1), dim=-1) + F.normalize({name}, dim=-1).sum()\n"
        "    return torch.exp(-d), {'d': d}\n"
    )
    random.seed(0)
    values = {v.name: torch.zeros(3, *v.shape) for v in known if v.name == name}
    for portable in (False, True):
        compile_reward(source, known, portable)(values)
