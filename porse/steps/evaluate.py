"""Step evaluate: trains the winning lineage again with further seeds, and lets the run's winner play."""

import math
import tempfile
from collections.abc import Sequence
from pathlib import Path

from porse import tables
from porse.config import Params
from porse.pool import policy_file
from porse.printing import counted
from porse.report.run import read_lineage
from porse.search.lengths import rung_epochs
from porse.search.lineage import episodes_seed
from porse.tables import Row
from porse.training.evaluation import evaluate as evaluated


def evaluate(params: Params, run: Path, out: Path) -> str:
    """Writes the tables evaluation, seeds and episodes of the run in the folder `run` to `out`; returns what to say about it."""
    lineage = read_lineage(run, params)
    until = rung_epochs(params) * max(rung.until for rung in params.rungs)
    with tempfile.TemporaryDirectory() as scratch:
        rows, seeds = evaluated(lineage, until, params, Path(scratch))
    tables.write(out / "evaluation.parquet", tables.EVALUATION, rows)
    tables.write(out / "seeds.parquet", tables.SEEDS, seeds)
    episodes = _episodes(params, lineage[-1], run)
    tables.write(out / "episodes.parquet", tables.EPISODES, episodes)
    return "\n".join([*_said(lineage, seeds), _success(episodes)])


def _episodes(params: Params, winner: Row, run: Path) -> list[Row]:
    """Returns the rows of the episodes table: the run's winner, as it was at the end of the iteration that it won."""
    # Imported here, after the trainings were forked: they have a torch of their own.
    from porse.sim.placement import placed
    from porse.tasks import make_task
    from porse.training.actor import policy_actor
    from porse.training.device import made_ready
    from porse.training.episodes import play_episodes

    policy = policy_file(run / str(winner["iteration"]) / params.fuse.pool, winner["policy"])
    device = made_ready(params)
    with placed(device.torch):
        task = make_task(params.task, params.evaluate.episodes, episodes_seed(params), device=device)
        played = play_episodes(task, policy_actor(task, policy, params.train))
    return [
        {"episode": number, "candidate_id": winner["candidate_id"], "steps": episode.steps, "outcome": episode.outcome}
        for number, episode in enumerate(played)
    ]


def _said(lineage: Sequence[Row], seeds: Sequence[Row]) -> list[str]:
    """Returns a line about the further seeds, and one about each that failed."""
    failed = [row for row in seeds if row["failure"]]
    end = ""
    if failed:
        end = (
            f", {len(failed)} of them failed"
            if len(failed) < len(seeds)
            else ": all of them failed, there is no evaluation"
        )
    return [
        f"{counted(len(lineage), 'link')} of the winning lineage, {counted(len(seeds), 'further seed')}{end}",
        *(f"seed {row['seed']} failed after {counted(row['links'], 'link')}: {row['failure']}" for row in failed),
    ]


def _success(episodes: Sequence[Row]) -> str:
    mean = math.fsum(row["outcome"] for row in episodes) / len(episodes)
    return f"the winner's mean action in {len(episodes)} whole episodes: {mean:.3f}"
