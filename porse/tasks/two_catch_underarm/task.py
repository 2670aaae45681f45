"""TwoCatchUnderarm: each hand holds an egg, and both are thrown to the other hand at once."""

import mujoco
import torch
from torch import Tensor

from porse.sim import rotations
from porse.tasks.hands.free_hands import FreeHandTask
from porse.tasks.hands.observations import free_hands, goal_and_turn, hand_observations, moving_body
from porse.tasks.hands.pair import PairTask, pair_variables
from porse.tasks.hands.toss import add_egg, add_goal_egg, toss_reward
from porse.tasks.hands.variables import FREE_ACTIONS

GOALS = ((0.0, -0.79, 0.54), (0.0, -0.38, 0.54))
NEAR = 0.06
"""Sum of the distances (m) of the eggs from their goals below which both are caught."""


class TwoCatchUnderarm(PairTask, FreeHandTask):
    """Exchange two eggs by throwing."""

    NAME = "TwoCatchUnderarm"
    DESCRIPTION = (
        "two shadow hands with palms facing upwards stand opposite each other, and each holds an object; both objects "
        "must be thrown to the other hand at the same time and caught there"
    )
    STARTS = (
        "an object is above each hand, within 1 cm of one place on each axis, both in one random orientation, and "
        "the goal of each is at one place above the other hand, both in another orientation"
    )
    ENDS = "as soon as one of the objects is at 0.2 m or lower"
    FITNESS = (
        "the share of episodes in which the distances of both objects from their goals once summed to less than 6 "
        "cm; their orientations do not count"
    )
    NUM_OBSERVATIONS = 446
    EPISODE_LENGTH = TIME_LIMIT = 75
    BODIES = tuple((name, name) for name in PairTask.OBJECT_BODIES)
    VARIABLES = pair_variables(
        FREE_ACTIONS, NUM_OBSERVATIONS, "the right hand's egg", "the left hand's egg",
        goals=("its goal, in the left hand", "its goal, in the right hand"),
    )  # fmt: skip
    OBSERVATION_HELPERS = (hand_observations, free_hands, moving_body, goal_and_turn)
    FORCE_SCALE = 0.05
    TORQUE_SCALE = 0.5
    PLACES = ((0.0, -0.39, 0.54), (0.0, -0.78, 0.54))

    @classmethod
    def add_objects(cls, spec: mujoco.MjSpec) -> None:
        """Adds the eggs and their goals."""
        for word in ("", "_another"):
            add_egg(spec, f"object{word}")
            add_goal_egg(spec, f"goal{word}")

    def _place(self, ids: Tensor) -> None:
        n = len(ids)
        physics = self._physics
        turn = self.random_rotations(n)[:, rotations.WXYZ_FROM_XYZW].to(self._physics.real)
        goal_turn = self.random_rotations(n)[:, rotations.WXYZ_FROM_XYZW].to(self._physics.real)
        self._place_pair(ids, turn)
        physics.mocap_pos[ids] = torch.tensor(GOALS).to(physics.real)
        physics.mocap_quat[ids] = goal_turn.unsqueeze(1).expand(-1, 2, -1)

    def compute_observations(self) -> Tensor:
        """Returns the observations, `(num_envs, 446)`: two hands, then each egg with its goal."""
        return torch.cat(
            (
                free_hands(self, self.root_state_tensor[:, 0, 0:3], self.root_state_tensor[:, 1, 0:3]),
                moving_body(self.object_pose, self.object_linvel, self.object_angvel),
                goal_and_turn(self.object_pose, self.goal_pose),
                moving_body(self.object_another_pose, self.object_another_linvel, self.object_another_angvel),
                goal_and_turn(self.object_another_pose, self.goal_another_pose),
            ),
            dim=-1,
        )

    def distances(self) -> tuple[Tensor, Tensor]:
        """Returns the distances (m) of both eggs from their goals, `(num_envs,)` each."""
        return (
            torch.norm(self.goal_pos - self.object_pos, dim=-1),
            torch.norm(self.goal_another_pos - self.object_another_pos, dim=-1),
        )

    def succeeded(self) -> Tensor:
        """Returns where the distances of both eggs from their goals sum to less than 6 cm."""
        first, second = self.distances()
        return first + second < NEAR

    def human_reward(self) -> Tensor:
        """Returns the sum over the eggs of exp(-0.2 (50 d + angle to the goal's orientation))."""
        first, second = self.distances()
        first_turn = rotations.rotation_distance(self.object_rot, self.goal_rot)
        second_turn = rotations.rotation_distance(self.object_another_rot, self.goal_another_rot)
        return toss_reward(50.0, first, first_turn) + toss_reward(50.0, second, second_turn)
