"""The brief of an iteration, from the folder that the previous one left."""

from pathlib import Path

from porse import tables
from porse.config import Params
from porse.generation.about import about
from porse.generation.conversations import Brief
from porse.search.breeding import plan
from porse.tasks import find_task


def read_brief(params: Params, iteration: int, start: Path, prompts: Path) -> Brief:
    """Returns the brief for the run's task, with the winner, the feedback and the islands in the folder `start`.

    Raises:
        TaskError: the task is unknown.
        TableError: a table in `start` is missing or is not as declared.
    """
    task = find_task(params.task)
    winners = tables.read(start / "winner.parquet", tables.CANDIDATES)
    members = tables.read(start / "members.parquet", tables.MEMBERS)
    return Brief(
        prompts=prompts,
        about=about(task),
        environment=task.observation_source().strip(),
        has_bonus=params.candidate.bonus != "none",
        beyond_goal=params.generate.beyond_goal,
        winner=winners[0] if winners else None,
        feedback=tables.read(start / "feedback.parquet", tables.FEEDBACK),
        breedings={breeding.slot: breeding for breeding in plan(members, params, iteration)},
        members={row["candidate_id"]: row for row in members},
        member_feedback=tables.read(start / "member_feedback.parquet", tables.MEMBER_FEEDBACK),
    )
