"""Over: the right hand throws an egg, and the left hand catches it. Both hands are fixed, palms up, face to face."""

import torch
from torch import Tensor

from porse.tasks.hands import shadow
from porse.tasks.hands.observations import fixed_hands, goal_and_turn, hand_observations, moving_body
from porse.tasks.hands.toss import SPREAD_STARTS, CatchTask, catch_variables, dropped_at


class Over(CatchTask):
    """Throw from the right hand to the left one, with fixed bases."""

    NAME = "Over"
    DESCRIPTION = (
        "two shadow hands with palms facing upwards stand opposite each other, with fixed bases; an object starts above "
        "the right hand, which must throw it, since it can neither be rolled nor handed over, so that the left hand "
        "catches it and holds it at the goal"
    )
    STARTS = SPREAD_STARTS
    DROPPED = 0.2
    ENDS = dropped_at(DROPPED)
    NUM_OBSERVATIONS = 398
    NUM_ACTIONS = 40
    VARIABLES = catch_variables(NUM_ACTIONS, NUM_OBSERVATIONS)
    OBSERVATION_HELPERS = (hand_observations, fixed_hands, moving_body, goal_and_turn)
    RIGHT, LEFT = shadow.palms_up(1.0)
    FREE = False
    JOINT_NOISE = 0.2
    EGG_START = (0.0, -0.39, 0.54)
    EGG_NOISE = 0.01
    GOAL = (0.0, -0.64, 0.54)

    def compute_observations(self) -> Tensor:
        """Returns the observations, `(num_envs, 398)`: two hands of 187, then the egg and its goal."""
        return torch.cat(
            (
                fixed_hands(self),
                moving_body(self.object_pose, self.object_linvel, self.object_angvel),
                goal_and_turn(self.object_pose, self.goal_pose),
            ),
            dim=-1,
        )  # fmt: skip
