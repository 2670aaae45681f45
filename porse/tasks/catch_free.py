"""The base of the catching tasks whose hands move as wholes: one egg, one goal, 422 observations."""

from typing import ClassVar

import torch
from torch import Tensor

from porse.sim import rotations
from porse.tasks.catch import CatchTask, catch_variables
from porse.tasks.free_hands import FreeHandTask, free_hands
from porse.tasks.hands import hand_observations
from porse.variables import Variable


class FreeCatchTask(CatchTask, FreeHandTask):
    """Throw and catch with hands that move."""

    NUM_OBSERVATIONS: ClassVar[int] = 422
    NUM_ACTIONS: ClassVar[int] = 52
    VARIABLES: ClassVar[tuple[Variable, ...]] = catch_variables(NUM_ACTIONS, NUM_OBSERVATIONS)
    OBSERVATION_HELPERS = (hand_observations, free_hands)
    PER_ENV_STATISTIC: ClassVar[bool] = True

    def _name_measurements(self) -> None:
        FreeHandTask._name_measurements(self)

    def compute_observations(self) -> Tensor:
        """Returns the observations, `(num_envs, 422)`: two hands, the egg, its goal, and the turn between them."""
        return torch.cat(
            (
                free_hands(self, self.root_state_tensor[:, 0, 0:3], self.root_state_tensor[:, 1, 0:3]),
                self.object_pose,
                self.object_linvel,
                0.2 * self.object_angvel,
                self.goal_pose,
                rotations.multiply(self.object_rot, rotations.conjugate(self.goal_rot)),
            ),
            dim=-1,
        )
