"""What `porse tasks` prints of each task, from the tasks themselves: `python -m porse.report.task_rows` writes it."""

import json

import click

from porse.tables import Row
from porse.task_names import TASK_ROWS, TASK_TAGS
from porse.tasks import TASKS


def task_rows() -> list[Row]:
    """Returns a row for each task, in the order of docs/tasks.md."""
    return [
        {
            "task": name,
            "observations": task.NUM_OBSERVATIONS,
            "actions": task.NUM_ACTIONS,
            "family": task.FAMILY,
            "description": task.DESCRIPTION,
            "episode_length": task.EPISODE_LENGTH,
            "tags": [*TASK_TAGS[name]],
        }
        for name, task in TASKS.items()
    ]


@click.command()
def main() -> None:
    """Write the rows of `porse tasks`."""
    TASK_ROWS.write_text(json.dumps(task_rows(), indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
