"""`params.yaml` as frozen dataclasses, with the sets of the method and the ablation laid over it.

What a parameter means is said in `params.yaml` itself, above the key. A section is named after the stage that reads it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml

from porse.conversion import Count, Fraction, NonNegative, Positive, Range, convert, wrong
from porse.errors import ParamsError
from porse.methods import overridden

MOST_SUMMED_CELLS = 1872
"""Sums of bins are counted by joint cells, and those of 8 progress variables must fit into 64 bits."""


@dataclass(frozen=True)
class Profile:
    """One model, where it answers, and in which dialect it is asked."""

    model: str
    aliases: tuple[str, ...]
    limit: str
    leave_out: tuple[Literal["temperature", "top_p"], ...]
    extra: Mapping[str, Any]
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
    """What a candidate's total reward is made of, and its weights before anything mutates."""

    goal: Literal["generated", "sparse", "human"]
    bonus: Literal["mapping", "simhash", "none"]
    beta: NonNegative
    scale: Annotated[float, Range(1e-6)]
    alpha: Fraction


@dataclass(frozen=True)
class GenerateParams:
    """How many candidates an iteration has, and where they come from."""

    candidates: Positive
    elites: Count
    iterations: Literal["every", "first"]
    parents: Literal["winner", "islands"]
    mappings: Literal["generator", "spliced"]
    beyond_goal: bool


@dataclass(frozen=True)
class IslandsParams:
    """The population that rewards evolve in (REvolve)."""

    count: Positive
    size: Positive
    crossover: Fraction
    migration: Fraction
    temperature: Annotated[float, Range(1e-6)]


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
    discretiser: Literal["grid", "sum"]
    simhash_bits: Annotated[int, Range(1, 20)]


@dataclass(frozen=True)
class TrainParams:
    """One policy's training by PPO."""

    rung_epochs: Positive
    length: Literal["iteration", "run"]
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
class ProbeParams:
    """The search of alpha by short trainings (ROSKA)."""

    trainings: Count
    initial: Annotated[int, Range(2, 101)]
    share: Fraction
    length: Annotated[float, Range(1e-3)]
    noise: Annotated[float, Range(1e-9)]
    xi: NonNegative


@dataclass(frozen=True)
class EliminateParams:
    """How candidates are ranked, and how many go on."""

    keep: Literal["rungs", "all", "one"]
    window: Positive


@dataclass(frozen=True)
class MutateParams:
    """How the best survivor is varied at half time."""

    pool: str
    mutants: Count
    vary: Sequence[Literal["beta", "alpha"]]
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
    policy: Literal["fused", "random"]
    incumbent: Literal["latest", "best"]
    points: Annotated[int, Range(2)]


@dataclass(frozen=True)
class EvaluateParams:
    """How far the winner's training depends on its seed."""

    seeds: Count


@dataclass(frozen=True)
class Reference:
    """MTS of the two methods that the human normalised score is measured against."""

    human: float
    sparse: float


@dataclass(frozen=True)
class SummariseParams:
    """What a run's metrics are measured against, by task."""

    references: Mapping[str, Reference]
    thresholds: Mapping[str, float]


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
    method: str
    ablation: str
    generator: Literal["model", "grammar"]
    seed: Annotated[int, Range(0, 2**31 - 1)]
    numerics: Literal["portable", "fast"]
    llm: LlmParams
    candidate: CandidateParams
    generate: GenerateParams
    islands: IslandsParams
    validate: ValidateParams
    exploration: ExplorationParams
    train: TrainParams
    probe: ProbeParams
    eliminate: EliminateParams
    mutate: MutateParams
    fuse: FuseParams
    evaluate: EvaluateParams
    summarise: SummariseParams
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
    laid_over = overridden(document, where) if isinstance(document, dict) else document
    params: Params = convert(laid_over, Params, "", where)
    _check_together(params, where)
    return params


def _check_together(params: Params, where: str) -> None:
    """Raises a ParamsError where parameters that are fine by themselves contradict each other."""
    llm, candidate, train = params.llm, params.candidate, params.train
    if llm.profile not in llm.profiles:
        raise ParamsError(wrong("llm.profile", f"one of {', '.join(llm.profiles)}", llm.profile, where))
    if candidate.beta > candidate.scale:
        raise ParamsError(
            wrong("candidate.beta", f"at most candidate.scale = {candidate.scale}", candidate.beta, where)
        )
    if params.generate.elites >= params.generate.candidates:
        expected = f"less than generate.candidates = {params.generate.candidates}"
        raise ParamsError(wrong("generate.elites", expected, params.generate.elites, where))
    exploration = params.exploration
    if exploration.discretiser == "sum" and exploration.cells > MOST_SUMMED_CELLS:
        expected = f"at most {MOST_SUMMED_CELLS} where exploration.discretiser is sum"
        raise ParamsError(wrong("exploration.cells", expected, exploration.cells, where))
    batch = train.num_envs * train.steps_per_epoch
    if batch % train.minibatches:
        raise ParamsError(
            wrong("train.minibatches", f"a divisor of num_envs x steps_per_epoch = {batch}", train.minibatches, where)
        )
    _check_rungs(params, where)
    if [entry.n for entry in params.iterations] != list(range(1, len(params.iterations) + 1)):
        raise ParamsError(wrong("iterations", "n = 1, 2, 3, ...", [entry.n for entry in params.iterations], where))


def _check_rungs(params: Params, where: str) -> None:
    """Raises a ParamsError where a rung reads a pool that is not there yet, or keeps more candidates than it has."""
    sizes = {"validate-code": params.generate.candidates}
    for index, rung in enumerate(params.rungs):
        if rung.pool == "mutate" and params.mutate.pool in sizes:
            sizes["mutate"] = sizes[params.mutate.pool] + params.mutate.mutants
        if rung.pool not in sizes:
            raise ParamsError(wrong(f"rungs[{index}].pool", f"one of {', '.join(sizes)}", rung.pool, where))
        if rung.keep > sizes[rung.pool] and params.eliminate.keep == "rungs":
            expected = f"at most the {sizes[rung.pool]} candidates of {rung.pool}"
            raise ParamsError(wrong(f"rungs[{index}].keep", expected, rung.keep, where))
        sizes[f"eliminate-{rung.rung}"] = rung.keep
    if sizes.get(params.fuse.pool) != 1:
        raise ParamsError(wrong("fuse.pool", "an elimination that keeps one candidate", params.fuse.pool, where))
