"""Trains one candidate: its functions compiled anew, its task made, its policy trained."""

from collections.abc import Callable

from porse.code.compile import compile_mapping, compile_reward
from porse.config import Params
from porse.exploration import VisitCounts
from porse.identity import seed_for
from porse.tasks import make_task
from porse.tasks.base import Task
from porse.training.job import Job, Outcome
from porse.training.reward import CandidateFailed, CandidateReward
from porse.training.trainer import Trainer


def train_candidate(job: Job, params: Params, report: Callable[[int, float], None]) -> Outcome:
    """Trains `job` to its last epoch and writes its checkpoint; when its functions fail, nothing is written."""
    task = make_task(params.task, params.train.num_envs, seed_for(job.seed, "task"))
    try:
        trainer = Trainer(task, _reward(job, task, params), params.train, job.seed)
        trainer.load(job.start)
        rows = trainer.train(job.until, report)
    except CandidateFailed as failure:
        return Outcome([], str(failure))
    trainer.save(job.finish)
    return Outcome([(row.epoch, row.series, row.value) for row in rows], "")


def _reward(job: Job, task: Task, params: Params) -> CandidateReward:
    portable = params.numerics == "portable"
    goal = compile_reward(job.reward_source, task.VARIABLES, portable)
    mapping = compile_mapping(job.mapping_source, task.VARIABLES, portable)
    # One call tells the directions: they are the mapping's output, and constant.
    _, rises, _ = mapping(task.variables())
    visits = VisitCounts(rises, params.exploration.cells, params.exploration.lambda_)
    return CandidateReward(goal, mapping, visits, job.beta, params.candidate.scale)
