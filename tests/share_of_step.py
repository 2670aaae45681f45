"""`python tests/share_of_step.py PROFILE NUM_ENVS`: what reward, mapping and bonus take of a training step, in processor time.

Trainings and payments take turns, so that what else the machine does falls on both alike; the share is the median of the
turns. What evaluates, copies, counts, scales and writes down is counted, all of it. Counts and bins are those of a rung.
"""

import dataclasses
import statistics
import sys
import tempfile
import time
from pathlib import Path

from porse import numerics

TURNS = 7


def main(profile, num_envs):
    import torch

    from porse.checkpoint import write_checkpoint
    from porse.config import load_params
    from porse.tasks import make_task
    from porse.training.candidate import reward_of
    from porse.training.job import Job
    from porse.training.start import random_policy
    from porse.training.trainer import Trainer
    from samples import MAPPING, REWARD, program

    torch.set_num_threads(1)
    params = load_params(Path(__file__).resolve().parent.parent / "params.yaml")
    params = dataclasses.replace(params, numerics=profile, train=dataclasses.replace(params.train, num_envs=num_envs))
    steps = params.train.steps_per_epoch
    with tempfile.TemporaryDirectory() as folder:
        start = Path(folder) / "start"
        write_checkpoint(start, random_policy(params, 1))
        job = Job("one", program(REWARD), program(MAPPING), 1.0, start, Path(folder) / "end", TURNS + 1, 7)
        task, other = make_task(params.task, num_envs, 0), make_task(params.task, num_envs, 0)
        trainer = Trainer(task, reward_of(job, task, params), params.train, job.seed)
        trainer.load(job.start)
    reward, ends = reward_of(job, other, params), torch.zeros((steps, num_envs), dtype=torch.bool)
    paid, spent = [], []
    for epoch in range(1, TURNS + 2):
        began = time.process_time()
        trainer.train(epoch, lambda *_: None, lambda *_: None)
        trained = time.process_time()
        with torch.inference_mode():
            for _ in range(steps):
                reward.see(other)
            reward.pay(epoch, ends)
        paid.append((time.process_time() - trained) / steps)
        spent.append((trained - began) / steps)
    paid, spent = paid[1:], spent[1:]  # bins are fixed and lists made ready in the first
    share = statistics.median(cost / step for cost, step in zip(paid, spent, strict=True))
    cost, step = statistics.median(paid), statistics.median(spent)
    print(
        f"{profile}, {num_envs} environments: {cost * 1e6:.0f} of {step * 1e6:.0f} microseconds, a share of {share:.4f}"
    )


if __name__ == "__main__":
    numerics.apply(sys.argv[1])
    main(sys.argv[1], int(sys.argv[2]))
