"""Trains one candidate: its operator lists loaded, its task made, its policy trained."""

import traceback
from collections.abc import Callable

from porse.config import Params
from porse.errors import PorseError
from porse.exploration import SimHashCounts, SumCounts, VisitCounts
from porse.functions.run.execute import MappingFunction, RewardFunction
from porse.functions.verdict import CodeError
from porse.identity import seed_for
from porse.tasks import make_task
from porse.tasks.base import Task
from porse.training.bonus import Bonus, MappingBonus, NoBonus, SimHashBonus
from porse.training.goal import Goal, generated, human, sparse
from porse.training.job import Job, Outcome
from porse.training.reason import lacks_memory, plain, reason_of
from porse.training.reward import CandidateFailed, Reward
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
    task = make_task(params.task, params.train.num_envs, seed_for(job.seed, "task"))
    reward = Reward(_goal(job, params), _bonus(job, task, params), job.beta, params.candidate.scale)
    trainer = Trainer(task, reward, params.train, job.seed)
    trainer.load(job.start)
    rows = trainer.train(job.until, report, before)
    trainer.save(job.finish)
    return Outcome([(row.epoch, row.series, row.value) for row in rows], "")


def _goal(job: Job, params: Params) -> Goal:
    if params.candidate.goal == "generated":
        return generated(RewardFunction(job.reward_program, params.numerics == "portable"))
    return human if params.candidate.goal == "human" else sparse


def _bonus(job: Job, task: Task, params: Params) -> Bonus:
    exploration = params.exploration
    if params.candidate.bonus == "none":
        return NoBonus()
    if params.candidate.bonus == "simhash":
        seed = seed_for(job.seed, "simhash")
        counts = SimHashCounts(task.NUM_OBSERVATIONS, exploration.simhash_bits, exploration.lambda_, seed)
        return SimHashBonus(counts)
    mapping = MappingFunction(job.mapping_program, params.numerics == "portable")
    visits = SumCounts if exploration.discretiser == "sum" else VisitCounts
    return MappingBonus(mapping, visits(mapping.rises, exploration.cells, exploration.lambda_))
