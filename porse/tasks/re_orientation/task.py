"""ReOrientation: each of two fixed hands turns its cube to a goal orientation, again and again."""

import mujoco
import torch
from torch import Tensor

from porse.sim import rotations
from porse.tasks.hands.observations import fixed_hands, goal_and_turn, hand_observations, moving_body
from porse.tasks.hands.pair import PairTask, pair_variables
from porse.tasks.re_orientation import scene

TOLERANCE = 0.1
"""Angle (rad) from the goal below which an orientation is reached."""

HIT_BONUS = 500.0
AVERAGING = 0.01


class ReOrientation(PairTask):
    """Turn two cubes to their goal orientations.

    As in the original, only the second cube counts as a hit; a hit gives both cubes a new goal. The statistic is a
    moving average of the hits of the episodes that end, so it can exceed 1.
    """

    NAME = "ReOrientation"
    DESCRIPTION = (
        "two shadow hands with fixed bases each hold an object on their upward palms and turn it in the hand to its "
        "target orientation"
    )
    STARTS = (
        "a cube is above each palm, within 1 cm of one place on each axis, both in one random orientation; their "
        "goals share another one; the joints of the hands are drawn at random, the same for both"
    )
    ENDS = "as soon as one of the cubes is at 0.2 m or lower"
    FITNESS = (
        "how often in an episode the left hand's cube (object_another) came within 0.1 rad of its goal's "
        "orientation, as a running mean over the episodes that ended; each time, both cubes get a new goal, and "
        "the right hand's cube does not count"
    )
    NUM_OBSERVATIONS = 422
    NUM_ACTIONS = 40
    EPISODE_LENGTH = TIME_LIMIT = 600
    FREE = False
    VARIABLES = pair_variables(
        NUM_ACTIONS, NUM_OBSERVATIONS, "the right hand's cube", "the left hand's cube", goals=("its goal", "its goal")
    )
    OBSERVATION_HELPERS = (hand_observations, fixed_hands, moving_body, goal_and_turn)
    MEASURED = (*PairTask.MEASURED, "_hit")
    PLACES = scene.PLACES

    @classmethod
    def add_objects(cls, spec: mujoco.MjSpec) -> None:
        """Adds the cubes and their goals."""
        scene.add_objects(spec)

    def _prepare(self) -> None:
        super()._prepare()
        self._hit = torch.zeros(self.num_envs, dtype=torch.bool)

    def _place(self, ids: Tensor) -> None:
        turn = self.random_rotations(len(ids))[:, rotations.WXYZ_FROM_XYZW].to(self._physics.real)
        self._place_pair(ids, turn)
        self._hit[ids] = False
        self._new_goals(ids)

    def _new_goals(self, ids: Tensor) -> None:
        """Draws one goal orientation for both cubes."""
        turn = self.random_rotations(len(ids))[:, rotations.WXYZ_FROM_XYZW].to(self._physics.real)
        self._physics.mocap_quat[ids] = turn.unsqueeze(1).expand(-1, 2, -1)

    def _act(self) -> None:
        # The goal that was hit stays until the next action, so that rewards and variables of a step agree with it.
        self._for_some(self._new_goals, self._hit)
        super()._act()

    def _name_measurements(self) -> None:
        for name in self.OBJECT_BODIES:
            self._name_body(name, name)

    def compute_observations(self) -> Tensor:
        """Returns the observations, `(num_envs, 422)`: two hands of 187, then each cube with its goal."""
        return torch.cat(
            (
                fixed_hands(self),
                moving_body(self.object_pose, self.object_linvel, self.object_angvel),
                goal_and_turn(self.object_pose, self.goal_pose),
                moving_body(self.object_another_pose, self.object_another_linvel, self.object_another_angvel),
                goal_and_turn(self.object_another_pose, self.goal_another_pose),
            ),
            dim=-1,
        )

    def turns(self) -> tuple[Tensor, Tensor]:
        """Returns the angles (rad) of both cubes from their goals, `(num_envs,)` each."""
        return (
            rotations.rotation_distance(self.object_rot, self.goal_rot),
            rotations.rotation_distance(self.object_another_rot, self.goal_another_rot),
        )

    def succeeded(self) -> Tensor:
        """Returns where the second cube has its goal orientation."""
        return self.turns()[1] < TOLERANCE

    def _record(self) -> None:
        self._hit = self.succeeded()
        self.successes = self.successes + self._hit
        finished = self._finished()
        # Whole numbers: their sum is exact in any order.
        mean = (self.successes * finished).sum() / finished.sum().clamp(min=1)
        averaged = AVERAGING * mean + (1.0 - AVERAGING) * self.outcomes
        self.outcomes = torch.where(finished.any(), averaged, self.outcomes)

    def human_reward(self) -> Tensor:
        """Returns -10 (d1 + d2) + 1 / (r1 + 0.1) + 1 / (r2 + 0.1) - 0.0002 sum of actions^2 + 500 on a hit."""
        first, second = self.turns()
        distance = torch.norm(self.goal_pos - self.object_pos, dim=-1)
        distance = distance + torch.norm(self.goal_another_pos - self.object_another_pos, dim=-1)
        effort = (self.actions * self.actions).sum(dim=-1)
        aligned = 1.0 / (first + 0.1) + 1.0 / (second + 0.1)
        return -10.0 * distance + aligned - 0.0002 * effort + torch.where(self._hit, HIT_BONUS, 0.0)
