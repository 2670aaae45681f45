"""What is measured of trainings, in a process that has one numeric profile and trains as the pipeline does.

All trainings here have the human reward and no bonus, the method `human`: every task has one, no reply is needed, and rsl_rl's
runner can be paid the same.
"""

import os
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any

import psutil
from rsl_rl.runners import OnPolicyRunner

from porse import numerics
from porse.bench.floor import Products, bare_steps_s, physics_of, starts_of
from porse.bench.runner import stock_runner
from porse.checkpoint import write_checkpoint
from porse.config import Params, load_document, parse_params
from porse.errors import PorseError
from porse.identity import seed_for
from porse.tasks import make_task
from porse.training.candidate import reward_of, train_candidate
from porse.training.job import Ended, Job, Outcome, Report
from porse.training.limits import WORKERS_VARIABLE, limits_from_environment
from porse.training.local import Local
from porse.training.start import random_policy
from porse.training.trainer import Trainer


def human_params(file: Path, task: str, profile: numerics.Profile) -> Params:
    """Returns the parameters of a file for a task with its human reward, at the size `cpu`, on the processor.

    Raises:
        ParamsError: the file is missing or wrong.
    """
    document: dict[str, Any] = load_document(file)
    document |= {
        "task": task,
        "size": "cpu",
        "method": "human",
        "ablation": "none",
        "numerics": profile,
        "device": "cpu",
    }
    return parse_params(document, str(file), file.parent)


class Epochs:
    """Epochs of one training, of rsl_rl's runner and of the floor, one beside the other.

    Args:
        params: of the training.
        folder: for its first policy.
    """

    def __init__(self, params: Params, folder: Path) -> None:
        job = _job("measured", params, folder, params.seed, until=0)
        train, seed = params.train, seed_for(job.seed, "task")
        self._params, self._seed = params, seed
        self._task = make_task(params.task, train.num_envs, seed)
        self._trainer = Trainer(self._task, reward_of(job, self._task, params), train, job.seed)
        self._trainer.load(job.start)
        self._products = Products(self._task.NUM_OBSERVATIONS, self._task.NUM_ACTIONS, train)

    def epoch_s(self, epochs: int) -> float:
        """Returns the processor seconds of an epoch of the training, over some epochs."""
        begun = time.process_time()
        self._trainer.train(self._trainer.epoch + epochs, lambda *_: None, lambda _: None)
        return (time.process_time() - begun) / epochs

    def runner_s(self, epochs: int) -> float:
        """Returns the processor seconds of an epoch of rsl_rl's runner, over some epochs."""
        begun = time.process_time()
        self._runner.learn(epochs)
        return (time.process_time() - begun) / epochs

    def floor_s(self, times: int) -> float:
        """Returns the processor seconds of the physics and of the products of an epoch of the training, which is made for it.

        Args:
            times: how often both are done.
        """
        physics = physics_of(self._task)
        with starts_of(physics) as starts:
            self.epoch_s(1)
        after = self._task.state()
        bare = sum(bare_steps_s(physics, starts, self._task.SUBSTEPS, time.process_time) for _ in range(times))
        self._task.load_state(after)
        return (bare + sum(self._products.seconds() for _ in range(times))) / times

    @cached_property
    def _runner(self) -> OnPolicyRunner:
        train = self._params.train
        return stock_runner(make_task(self._params.task, train.num_envs, self._seed), train)


class Work:
    """What a process of the bench can be asked for.

    Args:
        params_of: gives the parameters of trainings on a task.
        folder: for policies and checkpoints.
    """

    def __init__(self, params_of: Callable[[str], Params], folder: Path) -> None:
        self._params_of, self._folder = params_of, folder
        self._epochs: dict[str, Epochs] = {}

    def epoch_s(self, task: str, epochs: int) -> float:
        """See `Epochs.epoch_s`."""
        return self._of(task).epoch_s(epochs)

    def runner_s(self, task: str, epochs: int) -> float:
        """See `Epochs.runner_s`."""
        return self._of(task).runner_s(epochs)

    def floor_s(self, task: str, times: int) -> float:
        """See `Epochs.floor_s`."""
        return self._of(task).floor_s(times)

    def pool_s(self, task: str, candidates: int, epochs: int, workers: int) -> float:
        """Returns the seconds on the clock that a pool takes, each training in a process of its own.

        Args:
            task: what they train on.
            candidates: how many.
            epochs: of each.
            workers: as PORSE_WORKERS says it.
        """
        params = self._params_of(task)
        jobs = [_job(f"candidate-{n}", params, self._folder, n, epochs) for n in range(candidates)]
        begun = time.perf_counter()
        self._run(jobs, params, workers, lambda _: None)
        return time.perf_counter() - begun

    def memory_mb(self, task: str, epochs: int) -> float:
        """Returns the most memory (MB of 10^6 bytes) that a training had to itself, seen after each of its epochs.

        What counts is what the system would get back if it ended: what it shares with the process that it was forked from,
        as with the pipeline's warm server, does not.
        """
        params, seen = self._params_of(task), [0]

        def look(report: Report) -> None:
            for child in psutil.Process().children():
                # It may have ended since it reported.
                with suppress(psutil.NoSuchProcess):
                    seen.append(child.memory_full_info().uss)

        self._run([_job("measured", params, self._folder, params.seed, epochs)], params, 1, look)
        return max(seen) / 1e6

    def learning(self, task: str, seed: int, epochs: int) -> tuple[float, float]:
        """Returns the MTS of a whole training, and the processor seconds that it took, checkpoint included.

        Args:
            task: what it trains on.
            seed: of its first policy and of all its draws.
            epochs: how many.
        """
        params = self._params_of(task)
        fitness: list[float] = []
        job = _job("measured", params, self._folder, seed, epochs)
        begun = time.process_time()
        _well("measured", train_candidate(job, params, lambda epoch, value: fitness.append(value)))
        return max(fitness), time.process_time() - begun

    def _of(self, task: str) -> Epochs:
        if task not in self._epochs:
            self._epochs[task] = Epochs(self._params_of(task), self._folder)
        return self._epochs[task]

    @staticmethod
    def _run(jobs: list[Job], params: Params, workers: int, told: Callable[[Report], None]) -> None:
        os.environ[WORKERS_VARIABLE] = str(workers)

        def tell(news: Report | Ended) -> None:
            if isinstance(news, Ended):
                _well(news.name, news.outcome)
            else:
                told(news)

        Local(limits_from_environment()).run(jobs, params, tell)


def _job(name: str, params: Params, folder: Path, seed: int, until: int) -> Job:
    """Returns a training of the human reward, whose first policy is drawn and written."""
    start, finish = (folder / f"{params.task}-{name}-{seed}-{part}.safetensors" for part in ("start", "finish"))
    write_checkpoint(start, random_policy(params.with_seed(seed), 1))
    return Job(name, "", "", 0.0, start, finish, until, seed)


def _well(name: str, outcome: Outcome) -> None:
    if outcome.failure:
        raise PorseError(f"expected the training {name} to end well, found that {outcome.failure}; run it by itself")
