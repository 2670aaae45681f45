"""The winning lineage trained again with other seeds: how far a run's result depends on its draws."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

from porse.checkpoint import policy_checkpoint, read_checkpoint, write_checkpoint
from porse.config import Params
from porse.search.fusion import fuse
from porse.search.lineage import evaluation_seed
from porse.tables import Row
from porse.training.job import Job, Outcome
from porse.training.population import train_pool
from porse.training.rung import job_for, rung_bar
from porse.training.start import random_policy


def evaluate(lineage: Sequence[Row], until: int, params: Params, scratch: Path) -> tuple[list[Row], list[Row]]:
    """Returns the rows of the evaluation table and of the seeds table: every link trained to epoch `until`, for every seed.

    A link starts as it did in the run: from a random policy, or from its own fusion of the link before with one. All
    seeds of a link are trained side by side. A training that fails leaves no row in the evaluation table, and its seed ends
    there; the seeds table says why.

    Args:
        lineage: rows of the candidates table, the first link first.
        until: epochs of each link.
        params: the run's parameters; evaluate.seeds says how many seeds.
        scratch: an empty folder for checkpoints.
    """
    seeds = {number: _with_seed(params, number) for number in range(1, params.evaluate.seeds + 1)}
    alive, rows = sorted(seeds), list[Row]()
    ends = {number: {"seed": number, "links": len(lineage), "failure": ""} for number in alive}
    for index, link in enumerate(lineage):
        jobs = [_job(lineage, index, number, seeds[number], until, scratch / str(number)) for number in alive]
        with rung_bar(params, f"evaluation, iteration {link['iteration']}", len(jobs), len(jobs) * until) as bar:
            outcomes = train_pool(jobs, params, bar.tell)
        results = dict(zip(alive, outcomes, strict=True))
        rows += _rows(results, link)
        for number in [number for number in alive if results[number].failure]:
            ends[number] |= {"links": index, "failure": results[number].failure}
            alive.remove(number)
    return rows, list(ends.values())


def _with_seed(params: Params, number: int) -> Params:
    return params.with_seed(evaluation_seed(params, number))


def _job(lineage: Sequence[Row], index: int, number: int, params: Params, until: int, folder: Path) -> Job:
    """Returns the training of one link with further seed `number`, that of `params`, after writing the policy that it starts from."""
    link = lineage[index]
    random = random_policy(params, link["iteration"])
    start = folder / f"start-{index}.safetensors"
    if index == 0:
        write_checkpoint(start, random)
    else:
        before = read_checkpoint(_finish(folder, index - 1)).policy()
        write_checkpoint(start, policy_checkpoint(fuse(before, random.policy(), link["alpha"])))
    name = f"{link['candidate_id']} seed {number}"
    return dataclasses.replace(job_for(link, start, until, params, folder), name=name, finish=_finish(folder, index))


def _finish(folder: Path, index: int) -> Path:
    return folder / f"finish-{index}.safetensors"


def _rows(results: Mapping[int, Outcome], link: Row) -> list[Row]:
    return [
        {
            "seed": number,
            "iteration": link["iteration"],
            "candidate_id": link["candidate_id"],
            "epoch": epoch,
            "fitness": value,
        }
        for number, outcome in results.items()
        for epoch, series, value in outcome.rows
        if series == "fitness"
    ]
