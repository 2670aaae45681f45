"""GraspAndPlace: a cube is picked up and put into a bucket."""

from porse.tasks.grasp_and_place.task import GraspAndPlace

__all__ = ["GraspAndPlace"]
