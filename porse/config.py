"""`params.yaml` as frozen dataclasses: types, ranges, and no default anywhere.

A missing, unknown, mistyped or out-of-range parameter is a `ParamsError` that names it. What a parameter means is said
in `params.yaml` itself, above the key. A section is named after the stage that reads it.
"""

import dataclasses
import difflib
import math
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml

from porse.errors import ParamsError


@dataclass(frozen=True)
class Range:
    """Bounds of a number, both included."""

    low: float
    high: float = math.inf


Positive = Annotated[int, Range(1)]
Count = Annotated[int, Range(0)]
Fraction = Annotated[float, Range(0.0, 1.0)]
NonNegative = Annotated[float, Range(0.0)]


@dataclass(frozen=True)
class Profile:
    """One model and where it answers."""

    model: str
    base_url: str
    key_variable: str
    usd_per_million_prompt_tokens: NonNegative
    usd_per_million_completion_tokens: NonNegative


@dataclass(frozen=True)
class LlmParams:
    """The model that writes rewards and mappings, and how it is sampled."""

    profile: str
    temperature: Annotated[float, Range(0.0, 2.0)]
    top_p: Annotated[float, Range(1e-6, 1.0)]
    max_tokens: Positive
    profiles: Mapping[str, Profile]

    @property
    def model(self) -> str:
        """The model name of the chosen profile."""
        return self.profiles[self.profile].model


@dataclass(frozen=True)
class CandidateParams:
    """What a candidate is besides its functions, before anything mutates."""

    beta: NonNegative
    scale: Annotated[float, Range(1e-6)]
    alpha: Fraction


@dataclass(frozen=True)
class GenerateParams:
    """How many candidates an iteration has, and how many of them are carried over."""

    candidates: Positive
    elites: Count


@dataclass(frozen=True)
class ValidateParams:
    """How much is done for a broken function, and on which states functions are tried."""

    max_repairs: Count
    max_fresh: Count
    probe_envs: Annotated[int, Range(2)]
    probe_steps: Positive


@dataclass(frozen=True)
class ExplorationParams:
    """The exploration bonus."""

    lambda_: NonNegative
    cells: Annotated[int, Range(2)]


@dataclass(frozen=True)
class TrainParams:
    """One policy's training by PPO."""

    rung_epochs: Positive
    num_envs: Annotated[int, Range(2)]
    steps_per_epoch: Positive
    hidden: Sequence[Positive]
    activation: Literal["elu", "relu", "tanh"]
    init_std: Annotated[float, Range(1e-3)]
    normalise_observations: bool
    reward_scale: Annotated[float, Range(1e-6)]
    learning_rate: Annotated[float, Range(1e-8, 1.0)]
    desired_kl: Annotated[float, Range(1e-6)]
    gamma: Fraction
    gae_lambda: Fraction
    clip: Annotated[float, Range(1e-3, 1.0)]
    entropy: NonNegative
    value_coefficient: NonNegative
    max_grad_norm: Annotated[float, Range(1e-6)]
    passes: Positive
    minibatches: Positive


@dataclass(frozen=True)
class EliminateParams:
    """How candidates are ranked."""

    window: Positive


@dataclass(frozen=True)
class MutateParams:
    """How the best survivor is varied at half time."""

    pool: str
    mutants: Positive
    inertia: NonNegative
    cognitive: NonNegative
    social: NonNegative
    window: Positive
    points: Annotated[int, Range(2)]
    max_fresh: Count


@dataclass(frozen=True)
class FuseParams:
    """What an iteration hands to the next one."""

    pool: str
    points: Annotated[int, Range(2)]


@dataclass(frozen=True)
class Iteration:
    """One entry of the unrolled loop."""

    n: Positive
    next: int | str


@dataclass(frozen=True)
class Rung:
    """One entry of the schedule inside an iteration."""

    rung: int | str
    pool: str
    until: Positive
    keep: Positive


@dataclass(frozen=True)
class Params:
    """All of `params.yaml`."""

    task: str
    method: Literal["porse"]
    seed: Annotated[int, Range(0, 2**31 - 1)]
    numerics: Literal["portable", "fast"]
    llm: LlmParams
    candidate: CandidateParams
    generate: GenerateParams
    validate: ValidateParams
    exploration: ExplorationParams
    train: TrainParams
    eliminate: EliminateParams
    mutate: MutateParams
    fuse: FuseParams
    iterations: Sequence[Iteration]
    rungs: Sequence[Rung]


def load_params(path: Path) -> Params:
    """Returns the checked parameters of the file at `path`.

    Raises:
        ParamsError: the file is missing, is no YAML mapping, or a parameter is missing, unknown or out of range.
    """
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ParamsError(
            f"expected the parameters in {path}, found no such file; run from the project's root"
        ) from None
    except yaml.YAMLError as error:
        raise ParamsError(f"expected YAML in {path}, found: {' '.join(str(error).split())}; mend the file") from None
    return parse_params(document, str(path))


def parse_params(document: Any, where: str) -> Params:
    """Returns the checked parameters of a parsed document; `where` names it in errors.

    Raises:
        ParamsError: a parameter is missing, unknown, mistyped or out of range, or two of them contradict each other.
    """
    params: Params = _convert(document, Params, "", where)
    _check_together(params, where)
    return params


def _check_together(params: Params, where: str) -> None:
    """Raises a ParamsError where parameters that are fine by themselves contradict each other."""
    llm, candidate, train = params.llm, params.candidate, params.train
    if llm.profile not in llm.profiles:
        raise ParamsError(_wrong("llm.profile", f"one of {', '.join(llm.profiles)}", llm.profile, where))
    if candidate.beta > candidate.scale:
        raise ParamsError(
            _wrong("candidate.beta", f"at most candidate.scale = {candidate.scale}", candidate.beta, where)
        )
    if params.generate.elites >= params.generate.candidates:
        expected = f"less than generate.candidates = {params.generate.candidates}"
        raise ParamsError(_wrong("generate.elites", expected, params.generate.elites, where))
    batch = train.num_envs * train.steps_per_epoch
    if batch % train.minibatches:
        raise ParamsError(
            _wrong("train.minibatches", f"a divisor of num_envs x steps_per_epoch = {batch}", train.minibatches, where)
        )
    _check_rungs(params, where)
    if [entry.n for entry in params.iterations] != list(range(1, len(params.iterations) + 1)):
        raise ParamsError(_wrong("iterations", "n = 1, 2, 3, ...", [entry.n for entry in params.iterations], where))


def _check_rungs(params: Params, where: str) -> None:
    """Raises a ParamsError where a rung reads a pool that is not there yet, or keeps more candidates than it has."""
    sizes = {"validate-code": params.generate.candidates}
    for index, rung in enumerate(params.rungs):
        if rung.pool == "mutate" and params.mutate.pool in sizes:
            sizes["mutate"] = sizes[params.mutate.pool] + params.mutate.mutants
        if rung.pool not in sizes:
            raise ParamsError(_wrong(f"rungs[{index}].pool", f"one of {', '.join(sizes)}", rung.pool, where))
        if rung.keep > sizes[rung.pool]:
            expected = f"at most the {sizes[rung.pool]} candidates of {rung.pool}"
            raise ParamsError(_wrong(f"rungs[{index}].keep", expected, rung.keep, where))
        sizes[f"eliminate-{rung.rung}"] = rung.keep
    if sizes.get(params.fuse.pool) != 1:
        raise ParamsError(_wrong("fuse.pool", "an elimination that keeps one candidate", params.fuse.pool, where))


def _convert(value: Any, kind: Any, name: str, where: str) -> Any:
    """Returns `value` as the annotated type `kind`, or raises a ParamsError that names the parameter."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is Annotated:
        number, bounds = _convert(value, arguments[0], name, where), arguments[1]
        if not bounds.low <= number <= bounds.high:
            raise ParamsError(_wrong(name, f"a number in [{bounds.low:g}, {bounds.high:g}]", value, where))
        return number
    if dataclasses.is_dataclass(kind):
        return _convert_section(value, typing.cast(type, kind), name, where)
    if origin is Literal:
        if value not in arguments:
            raise ParamsError(_wrong(name, f"one of {', '.join(map(str, arguments))}", value, where))
        return value
    if origin is Sequence:
        if not isinstance(value, list) or not value:
            raise ParamsError(_wrong(name, "a list with at least one entry", value, where))
        return tuple(_convert(item, arguments[0], f"{name}[{index}]", where) for index, item in enumerate(value))
    if origin is Mapping:
        if not isinstance(value, dict) or not value:
            raise ParamsError(_wrong(name, "a mapping with at least one entry", value, where))
        return {str(key): _convert(item, arguments[1], f"{name}.{key}", where) for key, item in value.items()}
    return _convert_scalar(value, kind, name, where)


def _convert_scalar(value: Any, kind: Any, name: str, where: str) -> Any:
    """Returns a bool, int, float or str of the wanted type; an int is a fine float, a bool is no int."""
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    allowed = typing.get_args(kind) or (kind,)
    if not isinstance(value, allowed) or (isinstance(value, bool) and bool not in allowed):
        expected = " or ".join(option.__name__ for option in allowed)
        raise ParamsError(_wrong(name, f"a value of type {expected}", value, where))
    if isinstance(value, float) and not math.isfinite(value):
        raise ParamsError(_wrong(name, "a finite number", value, where))
    return value


def _convert_section(value: Any, section: type, name: str, where: str) -> Any:
    """Returns a dataclass from a mapping that has exactly its fields."""
    if not isinstance(value, dict):
        raise ParamsError(_wrong(name or "the document", "a mapping", value, where))
    # `lambda` is a word of Python's; in params.yaml it is the paper's letter.
    fields = {field.name.rstrip("_"): field for field in dataclasses.fields(section)}
    prefix = f"{name}." if name else ""
    for key in value:
        if key not in fields:
            near = difflib.get_close_matches(str(key), list(fields), n=1)
            hint = f"did you mean {prefix}{near[0]}?" if near else f"known here: {', '.join(fields)}"
            raise ParamsError(f"expected only known parameters in {where}, found {prefix}{key}; {hint}")
    for key in fields:
        if key not in value:
            raise ParamsError(
                f"expected the parameter {prefix}{key} in {where}, found none; add it, Python has no defaults"
            )
    hints = typing.get_type_hints(section, include_extras=True)
    converted = {
        field.name: _convert(value[key], hints[field.name], f"{prefix}{key}", where) for key, field in fields.items()
    }
    return section(**converted)


def _wrong(name: str, expected: str, found: Any, where: str) -> str:
    return f"expected {name} to be {expected}, found {found!r} in {where}; change it there"
