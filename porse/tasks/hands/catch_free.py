"""The base of the catching tasks whose hands move as wholes: one egg, one goal, 422 observations."""

from typing import ClassVar

import torch
from torch import Tensor

from porse.tasks.catch import CatchTask, catch_variables
from porse.tasks.free_hands import FreeHandTask
from porse.tasks.hand_observations import free_hands, goal_and_turn, hand_observations, moving_body
from porse.tasks.hand_variables import FREE_ACTIONS
from porse.variables import Variable


class FreeCatchTask(CatchTask, FreeHandTask):
    """Throw and catch with hands that move."""

    NUM_OBSERVATIONS: ClassVar[int] = 422
    VARIABLES: ClassVar[tuple[Variable, ...]] = catch_variables(FREE_ACTIONS, NUM_OBSERVATIONS)
    OBSERVATION_HELPERS = (hand_observations, free_hands, moving_body, goal_and_turn)
    PER_ENV_STATISTIC: ClassVar[bool] = True

    def _name_measurements(self) -> None:
        FreeHandTask._name_measurements(self)

    def compute_observations(self) -> Tensor:
        """Returns the observations, `(num_envs, 422)`: two hands, the egg, its goal, and the turn between them."""
        return torch.cat(
            (
                free_hands(self, self.root_state_tensor[:, 0, 0:3], self.root_state_tensor[:, 1, 0:3]),
                moving_body(self.object_pose, self.object_linvel, self.object_angvel),
                goal_and_turn(self.object_pose, self.goal_pose),
            ),
            dim=-1,
        )
