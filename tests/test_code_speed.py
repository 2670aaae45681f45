"""What generated functions cost of a training, in processor time, which is steadier than the clock."""

import dataclasses
import time

import pytest
import torch

from porse.checkpoint import write_checkpoint
from porse.exploration import VisitCounts
from porse.functions.run.execute import MappingFunction, RewardFunction
from porse.tasks import make_task
from porse.training.candidate import train_candidate
from porse.training.job import Job
from porse.training.start import random_policy
from samples import MAPPING, REWARD, program


def seconds(call, rounds):
    """Returns the processor time of one call, the least of five turns."""
    turns = []
    for _ in range(5):
        started = time.process_time()
        for _ in range(rounds):
            call()
        turns.append((time.process_time() - started) / rounds)
    return min(turns)


@pytest.mark.slow
@pytest.mark.parametrize("portable", [False, True])
@pytest.mark.parametrize(("num_envs", "share"), [(128, 0.03), (1024, 0.01)])
def test_reward_mapping_and_bonus_take_little_of_a_training_step(params, tmp_path, num_envs, share, portable):
    torch.set_num_threads(1)
    changed = dataclasses.replace(
        params,
        numerics="portable" if portable else "fast",
        train=dataclasses.replace(params.train, num_envs=num_envs),
    )
    write_checkpoint(tmp_path / "start", random_policy(changed, 1))
    job = Job("one", program(REWARD), program(MAPPING), 1.0, tmp_path / "start", tmp_path / "end", 3, 7)
    started = time.process_time()
    assert not train_candidate(job, changed, lambda *_: None).failure
    step = (time.process_time() - started) / (3 * params.train.steps_per_epoch)
    reward, mapping = RewardFunction(job.reward_program, portable), MappingFunction(job.mapping_program, portable)
    counts = VisitCounts(mapping.rises, params.exploration.cells, params.exploration.lambda_)
    states = make_task(params.task, num_envs, 0).variables()
    with torch.inference_mode():

        def pay():
            reward(states)
            counts.bonus(torch.stack(mapping(states)[0], dim=1))

        pay()
        cost = seconds(pay, 200)
    print(f"{num_envs} environments: {cost * 1e6:.0f} of {step * 1e6:.0f} microseconds, {cost / step:.2%}")
    assert cost <= share * step
