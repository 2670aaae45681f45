"""Trains one candidate: its operator lists loaded, its task made, its policy trained."""

import traceback
from collections.abc import Callable

from porse.config import Params
from porse.errors import PorseError, lacks_memory
from porse.exploration import Counts, ProgressSpace, SimHash, literal, relative
from porse.functions.run.execute import Function
from porse.functions.verdict import CodeError
from porse.identity import seed_for
from porse.search.lengths import rung_epochs
from porse.sim.devices import Device
from porse.sim.placement import placed
from porse.tasks import make_task
from porse.tasks.base import Task
from porse.training.bonus import Bonus, Ledger, MappingBonus, NoBonus, Price, SimHashBonus
from porse.training.device import made_ready
from porse.training.goal import Goal, generated, human, sparse
from porse.training.job import Job, Outcome
from porse.training.reason import plain, reason_of
from porse.training.reward import CandidateFailed, Reward
from porse.training.scale import NoScale, ReturnScale, Scale
from porse.training.trainer import Trainer


def train_candidate(job: Job, params: Params, report: Callable[[int, float], None]) -> Outcome:
    """Trains `job` to its last epoch and writes its checkpoint; when the training fails, nothing is written.

    Raises:
        PorseError: the program cannot go on: the start is missing or damaged, say, or the disk is full.
    """
    begun = 0

    def before(epoch: int) -> None:
        nonlocal begun
        begun = epoch

    try:
        return _trained(job, params, report, before)
    except CandidateFailed as failure:
        reason, outside = str(failure), False
    except CodeError as error:
        reason, outside = f"its function cannot be run: {plain(str(error))}", False
    except PorseError:
        raise
    except (Exception, SystemExit) as error:
        traceback.print_exc()
        reason, outside = f"its training raised {reason_of(error)}", lacks_memory(error)
        if outside:
            reason = f"its training may take no more memory: {reason_of(error)}"
    return Outcome([], f"{reason}, in epoch {begun}" if begun else f"{reason}, before its first epoch", outside)


def _trained(job: Job, params: Params, report: Callable[[int, float], None], before: Callable[[int], None]) -> Outcome:
    device = made_ready(params)
    with placed(device.torch):
        task = make_task(params.task, params.train.num_envs, seed_for(job.seed, "task"), device=device)
        trainer = Trainer(task, reward_of(job, task, params), params.train, job.seed)
        trainer.load(job.start)
        rows = trainer.train(job.until, report, before)
        trainer.save(job.finish)
    return Outcome([(row.epoch, row.series, row.value) for row in rows], "")


def reward_of(job: Job, task: Task, params: Params) -> Reward:
    """Returns what pays in a candidate's training on `task`.

    Raises:
        CodeError: a function cannot be run.
    """
    goal_size, total_size = _scale(params), _scale(params)
    bonus = _bonus(job, task, params)
    return Reward(_goal(job, params), bonus, job.beta, params.candidate.scale, goal_size, total_size)


def _goal(job: Job, params: Params) -> Goal:
    if params.candidate.goal == "generated":
        return generated(Function(job.reward_program, "reward", _is_portable(params)))
    return human if params.candidate.goal == "human" else sparse


def _is_portable(params: Params) -> bool:
    """Whether operators are replaced whose bits depend on the processor; on a GPU their replacements cannot run."""
    return params.numerics == "portable" and not Device(params.device).is_gpu


def _scale(params: Params) -> Scale:
    if params.train.scaling == "none":
        return NoScale()
    return ReturnScale(params.train.gamma, params.train.num_envs)


def _bonus(job: Job, task: Task, params: Params) -> Bonus:
    exploration = params.exploration
    if params.candidate.bonus == "none":
        return NoBonus()
    if params.candidate.bonus == "simhash":
        hashes = SimHash(task.NUM_OBSERVATIONS, exploration.simhash_bits, seed_for(job.seed, "simhash"))
        return SimHashBonus(hashes, _ledger(hashes.cells, params))
    mapping = Function(job.mapping_program, "mapping", _is_portable(params))
    space = ProgressSpace(mapping.rises, exploration.cells, exploration.discretiser)
    return MappingBonus(mapping, space, _ledger(space.cells, params))


def _ledger(cells: int, params: Params) -> Ledger:
    lifetime = params.exploration.lifetime
    counts = Counts(cells, params.train.num_envs, lifetime == "episode")
    return Ledger(counts, _price(params), rung_epochs(params) if lifetime == "rung" else 0)


def _price(params: Params) -> Price:
    """Returns what a visit pays: lambda deviations of the goal's return, about, or lambda alone as in eq. 3."""
    form, factor, gamma = params.exploration.form, params.exploration.lambda_, params.train.gamma
    if form == "relative":
        # Who is paid 1 - gamma in every step has a return of 1.
        return Price(relative, NoScale(), factor * (1.0 - gamma))
    if form == "calibrated":
        return Price(literal, ReturnScale(gamma, params.train.num_envs), factor)
    return Price(literal, NoScale(), factor)
