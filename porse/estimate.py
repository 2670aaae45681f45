"""`porse estimate`: what a run takes before it starts, from its schedule and a measurement of a few seconds on this machine."""

import dataclasses
import difflib
import json
import math
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from porse import numerics
from porse.config import Params, leaves, load_document, parse_params
from porse.documents import parse_yaml
from porse.errors import ParamsError, PorseError
from porse.llm.store import Store
from porse.llm_estimate import REPAIRS, estimated, planned_questions
from porse.plan import EVALUATE, planned
from porse.printing import echo
from porse.renderer import import_without_drawing
from porse.search.elimination import how_many_go_on
from porse.search.lengths import alpha_is_searched, probe_trainings, rung_epochs
from porse.search.schedule import first_candidates, is_searched, mutants, total_epochs, work
from porse.task_names import is_own
from porse.training.bar import in_words
from porse.training.limits import limits_from_environment
from porse.training.memory import training_mib
from porse.training.remote import is_on_gpu

DAY_S = 86_400
MEASURED_STEPS = 4096
"""Steps of one measured epoch at most: what takes longer is measured with fewer environments, and counted by the step."""
ROW_BYTES = 10
"""Of one value of the curves in a table: 8 in the default run's."""


@dataclass(frozen=True)
class Measured:
    """What a few seconds of training showed.

    Attributes:
        step_s: seconds of one training for each environment step, its part of PPO included.
        fixed_bytes: of a checkpoint, whatever the number of environments.
        env_bytes: of a checkpoint, for each environment.
        series: values in the curves for each epoch.
        observations: width of an observation.
        actions: width of an action.
    """

    step_s: float
    fixed_bytes: int
    env_bytes: float
    series: int
    observations: int
    actions: int


@dataclass(frozen=True)
class Effort:
    """What a run takes.

    Attributes:
        search_epochs: epochs of all candidates.
        evaluation_epochs: epochs of the winning lineage with further seeds, at most.
        steps: environment steps of both.
        steps_per_second: of one training.
        at_once: trainings side by side.
        seconds: of all trainings, on a machine that has nothing else to do.
        disk_bytes: of the run's folders and of DVC's cache.
        memory_mib: of one training, beyond the libraries'.
        replies: questions of the schedule to a model.
        recorded: how many of them have a recorded reply.
    """

    search_epochs: int
    evaluation_epochs: int
    steps: int
    steps_per_second: float
    at_once: int
    seconds: float
    disk_bytes: int
    memory_mib: int
    replies: int
    recorded: int

    @property
    def warning(self) -> str:
        """A sentence where the trainings take more than a day, else an empty text."""
        if self.seconds <= DAY_S:
            return ""
        return (
            f"the trainings alone take about {in_words(self.seconds)} with {self.at_once} at once, more than a day; a smaller size, more "
            "CPUs, several machines or a GPU make it shorter (docs/cluster.md)"
        )


def effort_of(params: Params, measured: Measured, at_once: int, crowd: int, replies: int, recorded: int) -> Effort:
    """Returns what a run takes.

    Args:
        params: the run's parameters.
        measured: what its trainings take.
        at_once: trainings side by side.
        crowd: how many may share their CPUs at the end of a pool (`porse.training.limits`).
        replies: questions of the schedule to a model.
        recorded: how many of them have a recorded reply.
    """
    train = params.train
    epoch_steps = train.num_envs * train.steps_per_epoch
    epoch_s = epoch_steps * measured.step_s
    costs = [cost for entry in params.iterations for cost in work(params, entry.n) if cost.candidates]
    rounds_s = [rung_s(cost.candidates, cost.epochs / cost.candidates * epoch_s, at_once, crowd) for cost in costs]
    [links] = [stage.bars for stage in planned(params) if stage.name == EVALUATE]
    link = max(rung.until for rung in params.rungs) * rung_epochs(params)
    evaluation_s = len(links) * rung_s(params.evaluate.seeds, link * epoch_s, at_once, crowd)
    search, evaluation = total_epochs(params), sum(bar.epochs for bar in links)
    return Effort(
        search_epochs=search,
        evaluation_epochs=evaluation,
        steps=(search + evaluation) * epoch_steps,
        steps_per_second=1.0 / measured.step_s,
        at_once=at_once,
        seconds=math.fsum([*rounds_s, evaluation_s]),
        disk_bytes=disk_bytes(params, measured),
        memory_mib=training_mib(train, measured.observations, measured.actions),
        replies=replies,
        recorded=recorded,
    )


def rung_s(candidates: int, each_s: float, at_once: int, crowd: int) -> float:
    """Returns how long trainings of one length take: round after round, and the last ones share the CPUs.

    Five on two CPUs, three of which may share them, are one round and then one and a half.
    """
    full = max(0, math.ceil((candidates - crowd) / at_once))
    left = candidates - full * at_once
    return (full + max(1.0, left / at_once) * (left > 0)) * each_s


def disk_bytes(params: Params, measured: Measured) -> int:
    """Returns what pools and DVC's cache hold at the end: a file that stands in several pools is in the cache once."""
    checkpoint = measured.fixed_bytes + params.train.num_envs * measured.env_bytes
    checkpoints = rows = 0.0
    for entry in params.iterations:
        for trained, held, epochs in _pools(params, entry.n):
            checkpoints += trained + held
            # Tables differ from pool to pool: each is in its folder and in the cache.
            rows += 2 * epochs * measured.series
    return round(checkpoints * checkpoint + rows * ROW_BYTES)


def _pools(params: Params, iteration: int) -> list[tuple[int, int, int]]:
    """Returns of each pool of an iteration: the checkpoints that are new in it, all that are in it, and its members' epochs."""
    if not is_searched(params, iteration):
        return []
    trained = {cost.rung: cost.candidates for cost in work(params, iteration)}
    epochs_of = rung_epochs(params)
    sizes = {"validate-code": first_candidates(params)}
    ages = {"validate-code": 0}
    found: list[tuple[int, int, int]] = []
    for index, rung in enumerate(params.rungs):
        if rung.pool == "mutate":
            before = params.mutate.pool
            sizes["mutate"] = sizes[before] + mutants(params, iteration)
            found.append((0, sizes[before], sizes[before] * ages[before] * epochs_of))
        size, new = sizes[rung.pool], trained[str(rung.rung)]
        if index == 0 and alpha_is_searched(params, iteration):
            probes = size * (probe_trainings(params) - 1)
            size, new = size + probes, new + probes
        kept = how_many_go_on(params, rung.keep, size)
        found += [(new, size, size * rung.until * epochs_of), (0, kept, kept * rung.until * epochs_of)]
        name = f"eliminate-{rung.rung}"
        sizes[name], ages[name] = kept, rung.until
    return found


def measured_size(params: Params) -> int:
    """Returns with how many environments an epoch is measured: halved until it is short, as far as minibatches allow."""
    train = params.train
    count = train.num_envs
    if is_on_gpu(params.device):
        # Twice the environments do not take twice the time there.
        return count
    while count * train.steps_per_epoch > MEASURED_STEPS and count % 2 == 0 and count > 2:
        if (count // 2 * train.steps_per_epoch) % train.minibatches:
            break
        count //= 2
    return count


def measure(params: Params, seconds: float) -> Measured:
    """Returns what trainings of these parameters take, after training with the human reward for about so many seconds.

    Counted is processor time, so that other work on the machine changes little, and on a GPU the time on the clock. What is
    loaded and compiled before the first epoch is not counted.

    Raises:
        PorseError: the training fails.
    """
    # Imported here: torch takes seconds, and must find the numeric profile set.
    from porse.checkpoint import read_checkpoint, write_checkpoint
    from porse.tasks import find_task
    from porse.training.candidate import train_candidate
    from porse.training.job import Job, Outcome
    from porse.training.start import random_policy

    count = measured_size(params)
    small = dataclasses.replace(
        params,
        train=dataclasses.replace(params.train, num_envs=count),
        candidate=dataclasses.replace(params.candidate, goal="human", bonus="none", beta=0.0),
    )
    clock = time.perf_counter if is_on_gpu(params.device) else time.process_time
    times: list[float] = []

    def train(start: Path, finish: Path, until: int) -> Outcome:
        times.clear()
        job = Job("measured", "", "", 0.0, start, finish, until, small.seed)
        outcome = train_candidate(job, small, lambda epoch, fitness: times.append(clock()))
        if outcome.failure:
            raise PorseError(
                f"expected a training of {small.task} with its human reward to run, found that {outcome.failure}; "
                "change the parameters that it is trained with"
            )
        return outcome

    with tempfile.TemporaryDirectory() as folder:
        start, first, last = (Path(folder, f"{name}.safetensors") for name in ("start", "first", "last"))
        write_checkpoint(start, random_policy(small, 1))
        train(start, first, 2)
        # The first report is at the end of an epoch: from there on only epochs are counted.
        more = 2 + max(0, int(seconds / max(times[1] - times[0], 1e-6)) - 1)
        outcome = train(first, last, 2 + more)
        epoch_s = (times[-1] - times[0]) / (len(times) - 1)
        size, checkpoint = last.stat().st_size, read_checkpoint(last)
    state = [array for part in ("task", "reward") for array in checkpoint.part(part).values()]
    of_envs = sum(array.nbytes for array in state if array.shape[:1] == (count,))
    task = find_task(small.task)
    return Measured(
        step_s=epoch_s / (count * small.train.steps_per_epoch),
        fixed_bytes=size - of_envs + _count_bytes(params),
        env_bytes=of_envs / count,
        series=math.ceil(len(outcome.rows) / len(times)),
        observations=task.NUM_OBSERVATIONS,
        actions=task.NUM_ACTIONS,
    )


def _count_bytes(params: Params) -> int:
    """Returns the bytes of the bonus's counts in a checkpoint; they are not measured."""
    exploration = params.exploration
    cells = {"mapping": exploration.cells, "simhash": 2**exploration.simhash_bits, "none": 0}[params.candidate.bonus]
    return 8 * cells * (params.train.num_envs if exploration.lifetime == "episode" else 1)


def changed(document: Any, assignments: Sequence[str]) -> Any:
    """Returns a parsed `params.yaml` with `name=value` put in, as `dvc exp run -S` does it: dotted names, values in YAML.

    Raises:
        ParamsError: one is not an assignment, or names no parameter.
    """
    for text in assignments:
        name, equals, value = text.partition("=")
        if not equals:
            raise ParamsError(f"expected NAME=VALUE after -S, found {text!r}; write it as in -S train.gamma=0.9")
        try:
            document = _put(document, name.split("."), parse_yaml(value, f"the value of {name} after -S"))
        except KeyError:
            near = difflib.get_close_matches(name, dict(leaves(document)) if isinstance(document, Mapping) else (), n=3)
            hint = f"did you mean {' or '.join(near)}?" if near else "`porse params` prints all"
            raise ParamsError(f"expected a parameter of params.yaml after -S, found {name}; {hint}") from None
    return document


def _put(document: Any, keys: Sequence[str], value: Any) -> Any:
    if not keys:
        return value
    if not isinstance(document, Mapping):
        raise KeyError(keys[0])
    return {**document, keys[0]: _put(document[keys[0]], keys[1:], value)}


@click.command()
@click.option(
    "--params", "path", default="params.yaml", show_default=True, type=click.Path(dir_okay=False, path_type=Path)
)
@click.option(
    "-S", "--set-param", "assignments", multiple=True, metavar="NAME=VALUE", help="Another value; may be given again."
)
@click.option("--workers", type=click.IntRange(1, 10**6), help="Trainings at once, in place of what this machine has.")
@click.option(
    "--seconds", default=4.0, show_default=True, type=click.FloatRange(0.0, 600.0), help="How long to measure."
)
@click.option("--prompts", default="prompts", show_default=True, type=click.Path(file_okay=False, path_type=Path))
@click.option("--cache", default="llm_cache", show_default=True, type=click.Path(file_okay=False, path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object.")
def estimate(
    path: Path,
    assignments: tuple[str, ...],
    workers: int | None,
    seconds: float,
    prompts: Path,
    cache: Path,
    as_json: bool,
) -> None:
    """Print epochs, environment steps, hours, disk and replies of a run, measured for a few seconds on this machine.

    `porse llm estimate` prints tokens and cost of the replies.
    """
    params = parse_params(changed(load_document(path), assignments), str(path))
    # Before torch is imported.
    numerics.apply(params.numerics)
    import_without_drawing()
    replies, recorded = _replies(params, prompts, cache)
    limits = limits_from_environment()
    if workers or is_on_gpu(params.device):
        # A GPU is for one training at a time.
        at_once = crowd = workers or 1
    else:
        at_once, crowd = limits.workers, limits.crowd
    effort = effort_of(params, measure(params, seconds), at_once, crowd, replies, recorded)
    if as_json:
        echo(json.dumps({**dataclasses.asdict(effort), "warning": effort.warning}, indent=2))
    else:
        echo("\n".join(_said(params, effort)))
    if effort.warning:
        echo(f"warning: {effort.warning}", err=True)


def _replies(params: Params, prompts: Path, cache: Path) -> tuple[int, int]:
    store = Store(cache)
    records = [record for key in store.all_keys() if (record := store.read(key)) is not None]
    lines = [line for line in estimated(planned_questions(params, prompts), records, params) if line.stage != REPAIRS]
    return sum(line.planned for line in lines), sum(line.recorded for line in lines)


def _said(params: Params, effort: Effort) -> list[str]:
    """Returns the lines that are printed."""
    own = " (a task of your own)" if is_own(params.task) else ""
    epochs = effort.search_epochs + effort.evaluation_epochs
    return [
        f"{params.task}{own}, size {params.size}, method {params.method}",
        f"epochs   {epochs:,}: {effort.search_epochs:,} of the search, {effort.evaluation_epochs:,} of the evaluation",
        f"steps    {effort.steps:,} environment steps",
        f"speed    {effort.steps_per_second:,.0f} steps/s of one training, measured",
        f"time     {in_words(effort.seconds)} for the trainings, {effort.at_once} at once",
        f"disk     {effort.disk_bytes / 1e9:.2f} GB for pools and DVC's cache",
        f"memory   {effort.memory_mib:,} MiB for each training, beyond the libraries'",
        f"replies  {effort.replies:,} questions to a model, {effort.recorded:,} of them recorded, and repairs",
    ]
