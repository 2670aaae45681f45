"""The base of the tasks in which an egg flies from one hand to the other: Over and its relatives.

An episode starts with the egg above the right hand and a goal pose above the left one; both orientations are random.
"""

from typing import ClassVar

import mujoco
import torch
from torch import Tensor

from porse.sim import rotations
from porse.tasks.hands.free_hands import FreeHandTask
from porse.tasks.hands.observations import free_hands, goal_and_turn, hand_observations, moving_body
from porse.tasks.hands.two_hands import TwoHandTask
from porse.tasks.hands.variables import FREE_ACTIONS, body_variables, goal_variables, two_hand_variables
from porse.variables import Variable

EGG_RADII = (0.03, 0.03, 0.04)
EGG_DENSITY = 500.0
NEAR = 0.03
"""Distance (m) from the goal below which the egg is caught."""


def add_egg(spec: mujoco.MjSpec, name: str) -> None:
    """Adds a free egg."""
    egg = spec.worldbody.add_body(name=name)
    egg.add_freejoint(name=name)
    egg.add_geom(
        name=name, type=mujoco.mjtGeom.mjGEOM_ELLIPSOID, size=EGG_RADII, density=EGG_DENSITY, condim=4,
        rgba=[0.9, 0.7, 0.3, 1],
    )  # fmt: skip


def add_goal_egg(spec: mujoco.MjSpec, name: str) -> None:
    """Adds a goal that looks like the egg and touches nothing; the task moves it."""
    goal = spec.worldbody.add_body(name=name, mocap=True)
    goal.add_geom(
        name=name, type=mujoco.mjtGeom.mjGEOM_ELLIPSOID, size=EGG_RADII, contype=0, conaffinity=0,
        rgba=[0.3, 0.8, 0.4, 0.4],
    )  # fmt: skip


SPREAD_STARTS = (
    "the object is above the right hand, within 1 cm of one place on each axis, in a random orientation, and the goal is "
    "at one place above the left hand, in another one; the joints of the hands are drawn at random, the same for both"
)
"""How an episode starts where there is noise, in words for prompts."""

STRAY = 0.1
"""Distance (m) of a hand from its place at which it has strayed."""


def dropped_at(height: float) -> str:
    """Returns when the egg is lost, as a clause for prompts."""
    return f"as soon as the object is at {height:g} m or lower"


def toss_reward(scale: float, distance: Tensor, turn: Tensor) -> Tensor:
    """Returns exp(-0.2 (scale distance + turn)), what the originals pay for an egg near its goal, `(num_envs,)`.

    Args:
        scale: weight of the distance.
        distance: of the egg from its goal (m).
        turn: angle (rad) from the goal's orientation.
    """
    return torch.exp(-0.2 * (scale * distance + turn))


def strayed(places: tuple[Tensor, Tensor], right: Tensor, left: Tensor) -> Tensor:
    """Returns where a hand is 10 cm or more from its place, bool `(num_envs,)`.

    Args:
        places: where the right and the left hand belong (m).
        right: where the right hand is, `(num_envs, 3)`.
        left: where the left hand is.
    """
    offsets = (right - places[0], left - places[1])
    far = [torch.norm(offset, dim=-1) >= STRAY for offset in offsets]
    return far[0] | far[1]


def catch_variables(actions: int, observations: int) -> tuple[Variable, ...]:
    """Returns what the tasks with one egg offer."""
    return (
        *body_variables("object", "the egg"),
        *goal_variables("goal", "the goal of the egg"),
        *two_hand_variables(actions, observations, objects=2, actors=2),
    )


class CatchTask(TwoHandTask):
    """One egg and one goal.

    Attributes:
        EGG_START: start position of the egg (m), world frame.
        EGG_NOISE: half width (m) of the start noise on each axis.
        GOAL: position of the goal (m), world frame.
        DROPPED: height (m) at which the egg is lost.
        DISTANCE_SCALE: weight of the distance in the human reward.
    """

    EPISODE_LENGTH: ClassVar[int] = 75
    TIME_LIMIT: ClassVar[int] = 75
    OBJECT_BODIES: ClassVar[tuple[str, ...]] = ("object", "goal")
    ACTORS: ClassVar[tuple[str, ...]] = ("object", "goal")
    FITNESS: ClassVar[str] = (
        "the share of episodes in which the object came within 3 cm of its goal; its orientation does not count"
    )
    EGG_START: ClassVar[tuple[float, float, float]]
    EGG_NOISE: ClassVar[float] = 0.0
    GOAL: ClassVar[tuple[float, float, float]]
    DROPPED: ClassVar[float]
    DISTANCE_SCALE: ClassVar[float] = 50.0

    @classmethod
    def add_objects(cls, spec: mujoco.MjSpec) -> None:
        """Adds the egg and its goal."""
        add_egg(spec, "object")
        add_goal_egg(spec, "goal")

    def _place(self, ids: Tensor) -> None:
        n = len(ids)
        physics = self._physics
        start = int(physics.model.joint("object").qposadr[0])
        position = torch.tensor(self.EGG_START) + self._uniform(-self.EGG_NOISE, self.EGG_NOISE, n, 3)
        orientation = self.random_rotations(n)[:, rotations.WXYZ_FROM_XYZW]
        physics.qpos[ids, start : start + 7] = torch.cat((position, orientation), dim=-1).to(physics.real)
        physics.mocap_pos[ids, 0] = torch.tensor(self.GOAL).to(physics.real)
        physics.mocap_quat[ids, 0] = self.random_rotations(n)[:, rotations.WXYZ_FROM_XYZW].to(physics.real)

    def _name_measurements(self) -> None:
        self._name_body("object", "object")
        self._name_body("goal", "goal")

    def distance(self) -> Tensor:
        """Returns the distance (m) between the egg and its goal, `(num_envs,)`."""
        return torch.norm(self.goal_pos - self.object_pos, dim=-1)

    def succeeded(self) -> Tensor:
        """Returns where the egg is within 3 cm of its goal."""
        return self.distance() < NEAR

    def failed(self) -> Tensor:
        """Returns where the egg was dropped."""
        return self.object_pos[:, 2] <= self.DROPPED

    def human_reward(self) -> Tensor:
        """Returns exp(-0.2 (DISTANCE_SCALE d + angle to the goal's orientation))."""
        turn = rotations.rotation_distance(self.object_rot, self.goal_rot)
        return toss_reward(self.DISTANCE_SCALE, self.distance(), turn)


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
