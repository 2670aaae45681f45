"""What prompts say of a task: what is wanted, how an episode starts and ends, and what fitness measures."""

from collections.abc import Mapping

from porse.tasks.base import Task

About = Mapping[str, str | int]
"""The facts of `prompts/about.jinja`."""


def about(task: type[Task]) -> About:
    """Returns the facts about a task, in its own words; those that it leaves out are empty."""
    return {
        "description": task.DESCRIPTION,
        "starts": task.STARTS,
        "ends": task.ENDS,
        "fitness": task.FITNESS,
        "limit": task.TIME_LIMIT,
    }
