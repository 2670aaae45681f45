"""`params.yaml` as frozen dataclasses: over the preset of task and size, and under the sets of method and ablation.

What a parameter means is said in `params.yaml` itself, above the key. A section is named after the stage that reads it.
Layers, from the bottom: the preset, which gives what is null; the file's own values; the method's set; the ablation's. A stage has a part of the parameters, those that it reads; asking for another one is an error.
"""

import copy
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from porse.conversion import CONFIG, Fraction, NonNegative, Positive, Range, Some, convert, convert_part, wrong
from porse.documents import read_yaml
from porse.errors import ParamsError
from porse.methods import origins, overridden
from porse.presets import FOLDER as PRESETS
from porse.presets import filled, find_preset, given

MOST_COUNTS = 2**24
"""Counts that a checkpoint holds, 128 MiB: of each environment's cells where counts live for an episode."""

MOST_STEPS = 2**22
"""Environment steps of one epoch that are held in memory at once."""

MOST_LAYERS = 16
"""Hidden layers of a network."""

ROOT = Path()
"""The project's root: commands and stages run there."""

Several = Annotated[int, Range(1, 1000)]
Few = Annotated[int, Range(0, 1000)]

_NAME = re.compile(r"[A-Za-z0-9]([A-Za-z0-9-]*[A-Za-z0-9])?")
"""Names of rungs and folders: they become names of stages, of folders, and words of a command."""


class Section:
    """Parameters that belong together; of those that a stage does not read, it has none."""

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Says which parameter is not there; called only for what is not there."""
            if name not in type(self).__dataclass_fields__:
                raise AttributeError(f"{type(self).__name__} has no {name}")
            raise ParamsError(
                f"expected this stage to read only the parameters that it depends on, found it reading {name} of "
                f"{type(self).__name__}; name it among the stage's sections in porse/inputs/stages.py"
            )


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
class LlmParams(Section):
    """The model that writes rewards and mappings, and how it is sampled."""

    profile: str
    temperature: Annotated[float, Range(0.0, 2.0)]
    top_p: Annotated[float, Range(1e-6, 1.0)]
    max_tokens: Annotated[int, Range(1, 10**7)]
    max_usd: NonNegative | None
    max_requests: Annotated[int, Range(0)] | None
    on_miss: Literal["error", "grammar"]
    profiles: Mapping[str, Profile]

    @property
    def model(self) -> str:
        """The model name of the chosen profile."""
        return self.profiles[self.profile].model


@dataclass(frozen=True)
class CandidateParams(Section):
    """What a candidate's total reward is made of, and its weights before anything mutates."""

    goal: Literal["generated", "sparse", "human"]
    bonus: Literal["mapping", "simhash", "none"]
    beta: NonNegative
    scale: Annotated[float, Range(1e-6)]
    alpha: Fraction


@dataclass(frozen=True)
class GenerateParams(Section):
    """How many candidates an iteration has, and where they come from."""

    candidates: Several
    elites: Few
    iterations: Literal["every", "first"]
    parents: Literal["winner", "islands"]
    mappings: Literal["generator", "spliced"]
    functions: str
    beyond_goal: bool


@dataclass(frozen=True)
class IslandsParams(Section):
    """The population that rewards evolve in (REvolve)."""

    count: Several
    size: Several
    crossover: Fraction
    migration: Fraction
    temperature: Annotated[float, Range(1e-6)]


@dataclass(frozen=True)
class ValidateParams(Section):
    """How much is done for a broken function, and on which states functions are tried."""

    max_repairs: Few
    max_fresh: Few
    probe_envs: Annotated[int, Range(2, 2**14)]
    probe_steps: Annotated[int, Range(1, 10**5)]


@dataclass(frozen=True)
class ExplorationParams(Section):
    """The exploration bonus."""

    lambda_: NonNegative
    form: Literal["relative", "literal", "calibrated"]
    lifetime: Literal["candidate", "rung", "episode"]
    cells: Annotated[int, Range(2, 10**6)]
    discretiser: Literal["grid", "sum"]
    simhash_bits: Annotated[int, Range(1, 20)]


@dataclass(frozen=True)
class TrainParams(Section):
    """One policy's training by PPO."""

    rung_epochs: Annotated[int, Range(1, 10**6)]
    length: Literal["iteration", "lineage", "budget"]
    num_envs: Annotated[int, Range(2, 2**17)]
    steps_per_epoch: Annotated[int, Range(1, 2**17)]
    hidden: Some[Annotated[int, Range(1, 2**13)]]
    activation: Literal["elu", "relu", "tanh"]
    init_std: Annotated[float, Range(1e-3)]
    normalise_observations: bool
    observation_clip: Annotated[float, Range(1e-3)]
    scaling: Literal["returns", "none"]
    learning_rate: Annotated[float, Range(1e-8, 1.0)]
    desired_kl: Annotated[float, Range(1e-6)]
    gamma: Fraction
    gae_lambda: Fraction
    clip: Annotated[float, Range(1e-3, 1.0)]
    entropy: NonNegative
    value_coefficient: NonNegative
    max_grad_norm: Annotated[float, Range(1e-6)]
    passes: Several
    minibatches: Positive


@dataclass(frozen=True)
class ProbeParams(Section):
    """The search of alpha by short trainings (ROSKA)."""

    trainings: Few
    initial: Annotated[int, Range(2, 101)]
    share: Fraction
    least_epochs: Positive
    length: Annotated[float, Range(1e-3)]
    noise: Annotated[float, Range(1e-9)]
    xi: NonNegative


@dataclass(frozen=True)
class EliminateParams(Section):
    """How candidates are ranked, and how many go on."""

    keep: Literal["rungs", "all", "one"]
    score: Literal["mean", "max"]
    window: Positive


@dataclass(frozen=True)
class MutateParams(Section):
    """How the best survivor is varied at half time."""

    pool: str
    mutants: Few
    vary: Some[Literal["beta", "alpha", "draw"]]
    inertia: NonNegative
    cognitive: NonNegative
    social: NonNegative
    window: Positive
    points: Annotated[int, Range(2, 10**4)]
    max_fresh: Few


@dataclass(frozen=True)
class FuseParams(Section):
    """What an iteration hands to the next one."""

    pool: str
    policy: Literal["fused", "random"]
    incumbent: Literal["latest", "best"]
    points: Annotated[int, Range(2, 10**4)]


@dataclass(frozen=True)
class EvaluateParams(Section):
    """How good the winner is, and how far its training depends on its seed."""

    seeds: Few
    episodes: Annotated[int, Range(2, 2**17)]


@dataclass(frozen=True)
class Lengths:
    """MTS of one policy trained as long as a winning lineage, and for the whole budget."""

    lineage: float
    budget: float


@dataclass(frozen=True)
class Reference:
    """What the human normalised score is measured against."""

    human: Lengths
    sparse: Lengths


@dataclass(frozen=True)
class SummariseParams(Section):
    """What a run's metrics are measured against, by task."""

    references: Mapping[str, Reference]
    thresholds: Mapping[str, float]


@dataclass(frozen=True)
class Iteration:
    """One entry of the unrolled loop."""

    n: Several
    next: int | str


@dataclass(frozen=True)
class Rung:
    """One entry of the schedule inside an iteration."""

    rung: int | str
    pool: str
    until: Several
    keep: Several


@dataclass(frozen=True)
class Params(Section):
    """All of `params.yaml`."""

    __pydantic_config__ = CONFIG

    task: str
    size: Literal["cpu", "paper"]
    method: str
    ablation: str
    generator: Literal["model", "grammar", "files"]
    seed: Annotated[int, Range(0, 2**31 - 1)]
    numerics: Literal["portable", "fast"]
    device: Literal["cpu", "warp-cpu", "cuda:0", "cuda:1", "cuda:2", "cuda:3", "cuda:4", "cuda:5", "cuda:6", "cuda:7"]
    deterministic: bool
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
    iterations: Some[Iteration]
    rungs: Some[Rung]

    def with_seed(self, seed: int) -> "Params":
        """Returns the same parameters with another seed; what is not there stays away."""
        other = copy.copy(self)
        # The dataclass is frozen, and nobody has seen the copy yet.
        object.__setattr__(other, "seed", seed)
        return other


@dataclass(frozen=True)
class Resolved:
    """A parsed `params.yaml` with all layers, unchecked.

    Attributes:
        document: the values.
        origins: where each value comes from that is not the file's own, by its dotted name: "preset Over cpu",
            "method eureka", "ablation fixed-beta".
        where: names the file, and the preset where one gives values, in errors.
    """

    document: dict[str, Any]
    origins: dict[str, str]
    where: str


def load_params(path: Path, root: Path = ROOT) -> Params:
    """Returns the checked parameters of the file at `path`, with all layers; `root` as for `resolve_document`.

    Raises:
        ParamsError: the file is missing, is no YAML mapping, or a parameter is missing, unknown or out of range.
    """
    return parse_params(load_document(path), str(path), root)


def presets_root(folder: Path, root: Path = ROOT) -> Path:
    """Returns where the presets of the run in `folder` are: a run that came with none has those of the project at `root`."""
    return folder if (folder / PRESETS).is_dir() else root


def load_document(path: Path) -> Any:
    """Returns the parsed `params.yaml` at `path`, unchecked and without the layers below and above it.

    Raises:
        ParamsError: the file is missing or is no YAML.
    """
    try:
        return read_yaml(path)
    except FileNotFoundError:
        raise ParamsError(
            f"expected the parameters in {path}, found no such file; run from the project's root"
        ) from None


def parse_params(document: Any, where: str, root: Path = ROOT) -> Params:
    """Returns the checked parameters of a parsed document, with all layers; the others as for `resolve_document`.

    Raises:
        ParamsError: a parameter is missing, unknown, mistyped or out of range, or two of them contradict each other.
    """
    resolved = resolve_document(document, where, root) if isinstance(document, dict) else None
    params: Params = convert(resolved.document if resolved else document, Params, "", where)
    _check_together(params, where, resolved.where if resolved else where)
    return params


def resolve_document(document: Mapping[str, Any], where: str, root: Path = ROOT) -> Resolved:
    """Returns a parsed `params.yaml` with all layers.

    Args:
        document: the parsed file.
        where: names it in errors.
        root: the project's root, where the presets are, and the modules of tasks of one's own.

    Raises:
        ParamsError: task, size, method or ablation is unknown, or the preset is missing or wrong.
    """
    preset = find_preset(document, where, root)
    above = origins(document, where)
    if preset is None:
        return Resolved(overridden(document, where), above, where)
    # Checked by itself, so that an error names the preset's file.
    convert_part(preset.values, Params, "", preset.where, Section)
    below = {f"{section}.{key}": preset.origin for section, key in given(document)}
    return Resolved(overridden(filled(document, preset), where), {**below, **above}, f"{where} over {preset.where}")


def parse_part(document: Mapping[str, Any], where: str) -> Params:
    """Returns the parameters of a stage: those that the document holds, and no others.

    Args:
        document: a part of a resolved `params.yaml`, which was checked as a whole.
        where: names it in errors.

    Raises:
        ParamsError: a parameter is unknown, mistyped or out of range; or, later, one that is not there is asked for.
    """
    part: Params = convert_part(document, Params, "", where, Section)
    return part


def document_of(params: Params) -> dict[str, Any]:
    """Returns the document that `parse_part` reads the same parameters from: those that are there, and no others."""
    document: dict[str, Any] = _plain(params)
    return document


def _plain(value: Any) -> Any:
    """Returns a parameter, or a dataclass of them, as YAML and JSON have it."""
    if is_dataclass(value):
        there = vars(value)
        return {field.name.rstrip("_"): _plain(there[field.name]) for field in fields(value) if field.name in there}
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, (list, tuple)) else value


def leaves(document: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yields the values of a document by their dotted names, in its order; a list is one value."""
    for key, value in document.items():
        if isinstance(value, Mapping):
            yield from leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _check_together(params: Params, where: str, below: str) -> None:
    """Raises a ParamsError where parameters that are fine by themselves contradict each other.

    Args:
        params: the parameters.
        where: names their file.
        below: names their file and the preset, for those that either may have given.
    """
    llm, candidate, train = params.llm, params.candidate, params.train
    if llm.profile not in llm.profiles:
        raise ParamsError(wrong("llm.profile", f"one of {', '.join(llm.profiles)}", llm.profile, where))
    if candidate.beta > candidate.scale:
        raise ParamsError(
            wrong("candidate.beta", f"at most candidate.scale = {candidate.scale}", candidate.beta, where)
        )
    if params.generator == "files" and not _NAME.fullmatch(params.generate.functions):
        expected = "a folder below functions/, named with letters, digits and dashes, since generator is files"
        raise ParamsError(wrong("generate.functions", expected, params.generate.functions, where))
    if params.generate.elites >= params.generate.candidates:
        expected = f"less than generate.candidates = {params.generate.candidates}"
        raise ParamsError(wrong("generate.elites", expected, params.generate.elites, where))
    _check_exploration(params, where)
    if len(train.hidden) > MOST_LAYERS:
        raise ParamsError(wrong("train.hidden", f"at most {MOST_LAYERS} layers", list(train.hidden), where))
    batch = train.num_envs * train.steps_per_epoch
    if batch > MOST_STEPS:
        expected = f"at most {MOST_STEPS} divided by train.num_envs = {train.num_envs}"
        raise ParamsError(wrong("train.steps_per_epoch", expected, train.steps_per_epoch, below))
    if batch % train.minibatches:
        raise ParamsError(
            wrong("train.minibatches", f"a divisor of num_envs x steps_per_epoch = {batch}", train.minibatches, below)
        )
    if params.probe.trainings == 1:
        expected = "0, or at least 2: one value of alpha has nothing to be compared with"
        raise ParamsError(wrong("probe.trainings", expected, 1, where))
    _check_rungs(params, where)
    _check_iterations(params, where)


def _check_exploration(params: Params, where: str) -> None:
    """Raises a ParamsError where a bonus would be nothing, or its counts would fill the disk."""
    exploration, train = params.exploration, params.train
    if params.candidate.bonus == "none":
        return
    if exploration.form == "relative" and train.gamma == 1.0:
        expected = "less than 1 where exploration.form is relative: the bonus is lambda (1 - gamma) times the rarity"
        raise ParamsError(wrong("train.gamma", expected, train.gamma, where))
    is_hashed = params.candidate.bonus == "simhash"
    name, number = ("simhash_bits", exploration.simhash_bits) if is_hashed else ("cells", exploration.cells)
    cells = 2**number if is_hashed else number
    if exploration.lifetime == "episode" and cells * train.num_envs > MOST_COUNTS:
        expected = f"fewer cells where exploration.lifetime is episode: times train.num_envs at most {MOST_COUNTS}"
        raise ParamsError(wrong(f"exploration.{name}", expected, number, where))


def _check_iterations(params: Params, where: str) -> None:
    """Raises a ParamsError where iterations do not follow each other."""
    count = len(params.iterations)
    if [entry.n for entry in params.iterations] != list(range(1, count + 1)):
        raise ParamsError(wrong("iterations", "n = 1, 2, 3, ...", [entry.n for entry in params.iterations], where))
    for index, entry in enumerate(params.iterations):
        name = f"iterations[{index}].next"
        if entry.n < count and entry.next != entry.n + 1:
            raise ParamsError(wrong(name, f"{entry.n + 1}, the iteration after it", entry.next, where))
        if entry.n == count and (entry.next in range(1, count + 1) or not _is_name(entry.next)):
            expected = "a folder's name of its own, of letters, digits and dashes, such as result"
            raise ParamsError(wrong(name, expected, entry.next, where))


def _is_name(value: int | str) -> bool:
    return _NAME.fullmatch(str(value)) is not None


def _check_rungs(params: Params, where: str) -> None:
    """Raises a ParamsError where a rung reads a pool that is not there yet, or keeps more candidates than it has."""
    sizes = {"validate-code": params.generate.candidates}
    for index, rung in enumerate(params.rungs):
        if not _is_name(rung.rung) or f"eliminate-{rung.rung}" in sizes:
            expected = "a name of its own, of letters, digits and dashes"
            raise ParamsError(wrong(f"rungs[{index}].rung", expected, rung.rung, where))
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
    if params.mutate.pool not in sizes:
        raise ParamsError(wrong("mutate.pool", f"one of {', '.join(sizes)}", params.mutate.pool, where))
    if params.mutate.pool == "validate-code" and params.mutate.mutants:
        expected = "an elimination where mutate.mutants is above 0: no candidate of validate-code has trained"
        raise ParamsError(wrong("mutate.pool", expected, params.mutate.pool, where))
