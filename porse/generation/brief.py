"""The brief of an iteration, from the folder that the previous one left."""

from pathlib import Path

from porse import tables
from porse.generation.conversations import Brief
from porse.tasks import find_task


def read_brief(task: str, start: Path, prompts: Path) -> Brief:
    """Returns the brief for a task, with the winner and the feedback in the folder `start`.

    Raises:
        TaskError: the task is unknown.
        TableError: a table in `start` is missing or is not as declared.
    """
    found = find_task(task)
    winners = tables.read(start / "winner.parquet", tables.CANDIDATES)
    feedback = tables.read(start / "feedback.parquet", tables.FEEDBACK)
    return Brief(
        prompts, found.DESCRIPTION, found.observation_source().strip(), winners[0] if winners else None, feedback
    )
