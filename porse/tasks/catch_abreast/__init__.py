"""CatchAbreast: two hands side by side pass an egg, as one person does between the own hands."""

from porse.tasks.catch_abreast.task import CatchAbreast

__all__ = ["CatchAbreast"]
