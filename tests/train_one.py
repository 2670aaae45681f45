"""Trains one candidate in a process of its own: `python train_one.py START FINISH UNTIL NUM_ENVS`. For tests."""

import dataclasses
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from porse import numerics  # noqa: E402

numerics.apply("portable")

from porse.config import load_params  # noqa: E402
from porse.training.candidate import train_candidate  # noqa: E402
from porse.training.job import Job  # noqa: E402
from samples import MAPPING, REWARD, program  # noqa: E402


def main(start: str, finish: str, until: str, num_envs: str) -> None:
    params = load_params(ROOT / "params.yaml", ROOT)
    train = dataclasses.replace(params.train, num_envs=int(num_envs))
    job = Job("one", program(REWARD), program(MAPPING), 1.0, Path(start), Path(finish), int(until), 7)
    outcome = train_candidate(job, dataclasses.replace(params, train=train), lambda epoch, fitness: None)
    assert not outcome.failure, outcome.failure


if __name__ == "__main__":
    main(*sys.argv[1:])
