"""The first runs of an operator list, on real states, on more environments and on disturbed states, and their verdict."""

import contextlib
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from porse.functions.read.states import of_environments
from porse.functions.run.execute import Function
from porse.functions.run.operators import base_of
from porse.functions.run.program import Program, registers
from porse.functions.run.shapes import MANY, makes_pairs
from porse.functions.verdict import CodeError, words

_SCALES = (0.01, 0.1, 1.0, 10.0)
"""Sizes of the disturbances that an output must react to, times the spread of each variable, or times 1."""
_LARGEST = 1e8
"""Largest value of a result: PPO squares sums of a hundred rewards in float32, which ends at 3e38."""
_SHAPES_ONLY = words("zeros_like ones_like full_like new_zeros new_ones new_full")
"""Operators that take a shape from a tensor, and no number."""
_STEPS = words("""
    all any argmax argmin argsort ceil clamp clamp_max clamp_min clip count_nonzero eq floor floor_divide ge greater
    greater_equal gt heaviside isclose le less less_equal logical_and logical_not logical_or logical_xor lt
    masked_fill max maximum min minimum ne not_equal relu relu6 round sgn sign signbit threshold trunc where
    hardtanh hardsigmoid
    """)
"""Operators whose results may stay the same over most states, and still tell some from others."""


def try_program(program: Program, values: Mapping[str, Any]) -> str:
    """Returns the warning of a verdict on an operator list that passed, "" for none.

    Args:
        program: the list.
        values: the value of each variable in real states.

    Raises:
        CodeError: it does not pass.
    """
    if not program.variables:
        raise CodeError("constant", "the function reads no state of the task, so its output never changes")
    function = Function(program.text, program.kind, portable=True)
    states = {name: values[name] for name in ("num_envs", *program.variables)}
    with torch.inference_mode():
        outputs = _outputs(function, states)
        _check_values(program, states, outputs)
        _check_reacts(function, states, outputs)
        _outputs(function, of_environments(states, MANY))  # memory and time grow with them
        return _check_rows(function, states, outputs)


def _outputs(function: Function, values: Mapping[str, Any]) -> dict[str, Tensor]:
    """Returns every output by what it is, a reward's total at last."""
    results, is_reward = function(values), function.program.kind == "reward"
    what, total = ("component", {"the total reward": results.pop(0)}) if is_reward else ("progress variable", {})
    return {f"the {what} {name}": value for name, value in zip(function.names, results, strict=True)} | total


def _check_values(program: Program, values: Mapping[str, Any], outputs: Mapping[str, Tensor]) -> None:
    """Refuses outputs that are not finite, or too large."""
    for what, output in outputs.items():
        bad = ~torch.isfinite(output)
        if bool(bad.any()):
            index = int(bad.nonzero()[0, 0])
            kind = "NaN" if bool(torch.isnan(output[index])) else "infinity"
            example = ", ".join(f"{n} = {_numbers(values[n][index])}" for n in program.variables)
            raise CodeError(
                "finite",
                f"{what} is {kind} on {100.0 * float(bad.float().mean()):.1f} % of real states, for example where"
                f" {example[:600]}; guard the division, root, logarithm or arc that makes it",
            )
    for what, output in outputs.items():
        if (largest := float(output.abs().max())) > _LARGEST:
            raise CodeError(
                "large",
                f"expected values of at most {_LARGEST:g}, found {largest:.3g} in {what} on real states, which no policy"
                " can learn from; divide by the scale of its terms",
            )


def _check_reacts(function: Function, values: Mapping[str, Any], outputs: Mapping[str, Tensor]) -> None:
    """Refuses outputs of which no row changes however its variables are disturbed.

    Single components may be constant in these states: a bonus that nobody has earned yet. What compares or clamps may
    be constant in all states tried here, and still tell others apart; what does neither is.
    """
    program = function.program
    suspects = ["the total reward"] if program.kind == "reward" else list(outputs)
    results = dict(zip(suspects, program.results, strict=False))  # a reward's total is the first
    generator = torch.Generator().manual_seed(0)
    for scale in _SCALES:
        disturbed = {n: _disturb(v, scale, generator) for n, v in values.items()}
        with contextlib.suppress(CodeError):
            found = _outputs(function, disturbed)
            suspects = [what for what in suspects if bool((found[what] == outputs[what]).all())]
    for what in suspects:
        if not _may_step(program, results[what]):
            raise CodeError("constant", f"{what} is the same number in all states, whatever the variables are")


def _may_step(program: Program, result: int) -> bool:
    """Whether a result hangs on numbers of a variable through an operator that compares, clamps or chooses."""
    held = dict.fromkeys(range(len(program.variables)), False)
    for step, made in zip(program.steps, program.starts, strict=False):
        base = base_of(step.operator)
        sources = [held[index] for index in registers(step.arguments) if index in held]
        if sources and base not in _SHAPES_ONLY:
            held |= dict.fromkeys(range(made, made + step.makes), any(sources) or base in _STEPS)
    return held.get(result, False)


def _check_rows(function: Function, values: Mapping[str, Any], outputs: Mapping[str, Tensor]) -> str:
    """Returns a warning where an environment's results hang on the others; refuses what makes something for every pair."""
    count = values["num_envs"] // 2
    found = _outputs(function, of_environments(values, count))
    close = {w: torch.allclose(v[:count], found[w], rtol=1e-3, atol=1e-5, equal_nan=True) for w, v in outputs.items()}
    mixed = next((what for what, is_close in close.items() if not is_close), None)
    if mixed is None:
        return ""
    if makes_pairs(function.shapes):
        raise CodeError(
            "shape",
            f"{mixed} of one environment depends on all others, because a step makes a number for every pair of"
            " environments, (num_envs, num_envs); shapes such as (num_envs, 1) and (num_envs,) met: keep every tensor"
            " (num_envs,), with a[:, 0] in place of a[:, 0:1] and without keepdim",
        )
    return (
        f"{mixed} of one environment depends on the other environments (a mean, a maximum or a rank over all of them):"
        " it means something else for another number of environments"
    )


def _disturb(value: Any, scale: float, generator: torch.Generator) -> Any:
    if not isinstance(value, Tensor):
        return value
    noise = torch.randn(value.shape, generator=generator)
    if value.is_floating_point():
        spread = (value - value.mean(0, keepdim=True)).abs().amax().nan_to_num(1.0, 1.0, 1.0)
        return value + scale * noise * spread.clamp(min=1.0)
    return (value + (scale * 10 * noise.abs()).to(value.dtype)).to(value.dtype)


def _numbers(value: Tensor) -> str:
    """Returns the first numbers of a tensor, four digits each."""
    text = ", ".join(f"{float(number):.4g}" for number in value.reshape(-1)[:8])
    return text if value.dim() == 0 else f"[{text}{', ...' if value.numel() > 8 else ''}]"
