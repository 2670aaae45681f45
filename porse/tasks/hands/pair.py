"""The base of the tasks with two objects, one in each hand at the start, and a goal for each."""

from typing import ClassVar

import torch
from torch import Tensor

from porse.tasks.hands.two_hands import TwoHandTask

OBJECTS = ("object", "object_another")


class PairTask(TwoHandTask):
    """Two free objects and two goals: "object" and "goal", "object_another" and "goal_another"."""

    OBJECT_BODIES: ClassVar[tuple[str, ...]] = ("object", "goal", "object_another", "goal_another")
    ACTORS: ClassVar[tuple[str, ...]] = OBJECT_BODIES

    object_another_pose: Tensor
    object_another_pos: Tensor
    object_another_rot: Tensor
    object_another_linvel: Tensor
    object_another_angvel: Tensor
    goal_another_states: Tensor
    goal_another_pose: Tensor
    goal_another_pos: Tensor
    goal_another_rot: Tensor

    def _place_pair(
        self, ids: Tensor, starts: tuple[tuple[float, float, float], ...], noise: float, turn: Tensor
    ) -> None:
        """Writes start poses of both objects: positions (m) with noise, and one turn (MuJoCo's order) for both."""
        physics = self._physics
        for name, place in zip(OBJECTS, starts, strict=True):
            start = int(physics.model.joint(name).qposadr[0])
            position = torch.tensor(place) + self._uniform(-noise, noise, len(ids), 3)
            physics.qpos[ids, start : start + 3] = position.double()
            physics.qpos[ids, start + 3 : start + 7] = turn
