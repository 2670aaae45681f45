"""The base of the tasks with two objects, one in each hand at the start, and a goal for each."""

from typing import ClassVar

import torch
from torch import Tensor

from porse.tasks.hands import shadow
from porse.tasks.hands.objects import Vector
from porse.tasks.hands.two_hands import TwoHandTask
from porse.tasks.hands.variables import body_variables, goal_variables, root_variable, two_hand_variables
from porse.variables import Variable

NOISE = 0.01
"""Half width (m) of the start noise on each axis."""


def pair_variables(
    actions: int, observations: int, right: str, left: str, goals: tuple[str, str]
) -> tuple[Variable, ...]:
    """Returns what the tasks with two objects offer.

    Args:
        actions: width of an action.
        observations: width of an observation.
        right: the object that starts in the right hand, in words for prompts.
        left: the other one.
        goals: their goals, in words.
    """
    return (
        *body_variables("object", right),
        *goal_variables("goal", goals[0]),
        *body_variables("object_another", left),
        *goal_variables("goal_another", goals[1]),
        *two_hand_variables(actions, observations, objects=4, actors=4),
        root_variable("object_another_indices", "the left hand's object"),
    )


class PairTask(TwoHandTask):
    """Two free objects and two goals: "object" and "goal", "object_another" and "goal_another".

    Attributes:
        PLACES: start positions of both objects (m), world frame.
        DROPPED: height (m) at which an object is lost.
    """

    OBJECT_BODIES: ClassVar[tuple[str, ...]] = ("object", "goal", "object_another", "goal_another")
    ACTORS: ClassVar[tuple[str, ...]] = OBJECT_BODIES
    RIGHT: ClassVar[shadow.BasePose] = shadow.palms_up(1.15)[0]
    LEFT: ClassVar[shadow.BasePose] = shadow.palms_up(1.15)[1]
    JOINT_NOISE: ClassVar[float] = 0.2
    PLACES: ClassVar[tuple[Vector, Vector]]
    DROPPED: ClassVar[float] = 0.2

    object_another_pose: Tensor
    object_another_pos: Tensor
    object_another_rot: Tensor
    object_another_linvel: Tensor
    object_another_angvel: Tensor
    goal_another_states: Tensor
    goal_another_pose: Tensor
    goal_another_pos: Tensor
    goal_another_rot: Tensor

    def _place_pair(self, ids: Tensor, turn: Tensor) -> None:
        """Writes start poses of both objects: positions with noise, and one turn (MuJoCo's order) for both."""
        physics = self._physics
        for name, place in zip(("object", "object_another"), self.PLACES, strict=True):
            start = int(physics.model.joint(name).qposadr[0])
            position = torch.tensor(place) + self._uniform(-NOISE, NOISE, len(ids), 3)
            physics.qpos[ids, start : start + 3] = position.to(physics.real)
            physics.qpos[ids, start + 3 : start + 7] = turn

    def failed(self) -> Tensor:
        """Returns where one of the objects was dropped."""
        return torch.minimum(self.object_pos[:, 2], self.object_another_pos[:, 2]) <= self.DROPPED
