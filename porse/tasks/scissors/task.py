"""Scissors: two hands open a pair of scissors that lies on a table."""

from typing import ClassVar

import mujoco
import torch
from torch import Tensor

from porse.tasks import dress, objects
from porse.tasks.free_hands import Handle
from porse.tasks.hand_observations import free_hands, moving_body
from porse.tasks.hand_variables import body_variables, free_hand_variables, goal_variables, point_variables
from porse.tasks.handle_task import HandleTask
from porse.variables import Variable

THICKNESS = 0.012
OPEN = -0.3
"""Angle (rad) of the scissors above which they count as open; closed is -0.597."""

CLOSED = -0.59


def _add_half(body: mujoco.MjsBody, name: str, side: int) -> None:
    """Adds a blade toward -x and a handle toward +x and side * z, in one plane."""
    low, high = -THICKNESS / 2, THICKNESS / 2
    objects.add_box(body, f"{name}_blade", (-0.2, low, -0.012), (0.02, high, 0.012), 0.03)
    near, far = sorted((0.0, 0.06 * side))
    objects.add_box(body, f"{name}_neck", (0.0, low, near), (0.14, high, far), 0.03)
    near, far = sorted((0.06 * side, 0.12 * side))
    objects.add_box(body, f"{name}_grip", (0.12, low, near), (0.24, high, far), 0.04)


class Scissors(HandleTask):
    """Open the scissors."""

    NAME: ClassVar[str] = "Scissors"
    DESCRIPTION: ClassVar[str] = (
        "two shadow hands open a pair of scissors: the hands reach for the two handles and spread them"
    )
    STARTS: ClassVar[str] = "the scissors lie shut on the table, at -0.59 rad"
    ENDS: ClassVar[str] = "as soon as the distances of one hand's five fingertips from its handle sum to 1.75 m or more"
    FITNESS: ClassVar[str] = "the share of episodes in which the scissors once were open beyond -0.3 rad"
    NUM_OBSERVATIONS: ClassVar[int] = 417
    EPISODE_LENGTH: ClassVar[int] = 150
    TIME_LIMIT: ClassVar[int] = 150
    OBJECT_BODIES: ClassVar[tuple[str, ...]] = ("object", "link_1", "link_0", "goal", "table")
    ACTORS: ClassVar[tuple[str, ...]] = ("object", "goal", "table")
    HANDLES: ClassVar[tuple[Handle, ...]] = (
        Handle("scissors_right_handle", "link_0", (0.2, 0.0, -0.1)),
        Handle("scissors_left_handle", "link_1", (0.15, 0.0, 0.1)),
    )
    RIGHT_HANDLE: ClassVar[str] = "scissors_right_handle"
    LEFT_HANDLE: ClassVar[str] = "scissors_left_handle"
    LOST: ClassVar[float] = 1.75
    START_JOINTS: ClassVar[dict[str, tuple[float, float]]] = {"scissors": (CLOSED, 0.0)}
    VARIABLES: ClassVar[tuple[Variable, ...]] = (
        *body_variables("object", "the scissors"),
        *goal_variables("goal", "the goal (10 m above the scissors' own place)"),
        *point_variables("scissors_right_handle", "the handle for the right hand"),
        *point_variables("scissors_left_handle", "the handle for the left hand"),
        Variable("object_dof_pos", "tensor", (1,), "rad", "joint", "angle of the scissors: -0.597 closed, 0.4 wide"),
        *free_hand_variables(NUM_OBSERVATIONS, OBJECT_BODIES, ACTORS),
    )

    scissors_right_handle_pos: Tensor
    scissors_left_handle_pos: Tensor
    object_dof_pos: Tensor

    @classmethod
    def add_objects(cls, spec: mujoco.MjSpec) -> None:
        """Adds the table, the scissors, and the goal."""
        objects.add_table(spec, (0.5, 1.0, 0.6))
        base = objects.add_base(spec, "object", (0.0, 0.0, 0.607), (0.0, 0.0, 1.57))
        fixed = objects.add_link(base, "link_1")
        _add_half(fixed, "link_1", side=1)
        moving = fixed.add_body(name="link_0", pos=[-0.0698, 0.0, 0.0034])
        _add_half(moving, "link_0", side=-1)
        objects.add_hinge(moving, "scissors", (0.0, 1.0, 0.0), (-0.5969, 0.4), damping=0.02, friction=0.01)
        objects.add_goal(spec, (0.0, 0.0, 0.607), (0.0, 0.0, 1.57), lift=objects.LIFT)
        dress.dress_scissors(spec)

    def compute_observations(self) -> Tensor:
        """Returns the observations, `(num_envs, 417)`: two hands, the scissors, their handles."""
        return torch.cat(
            (
                free_hands(self, self.right_hand_pos, self.left_hand_pos),
                moving_body(self.object_pose, self.object_linvel, self.object_angvel),
                self.scissors_right_handle_pos,
                self.scissors_left_handle_pos,
            ),
            dim=-1,
        )

    def _name_measurements(self) -> None:
        super()._name_measurements()
        self.object_dof_pos = self.joint_position("scissors").unsqueeze(-1)

    def opening(self) -> Tensor:
        """Returns five times the angle (rad) opened since the start, where both hands are near, else 0."""
        right, left = self.reaches()
        near = (right < 0.7) & (left < 0.7)
        return torch.where(near, 5.0 * (0.59 + self.object_dof_pos[:, 0]), 0.0)

    def succeeded(self) -> Tensor:
        """Returns where the scissors are open."""
        return self.object_dof_pos[:, 0] > OPEN

    def failed(self) -> Tensor:
        """Returns where the scissors were closed further or a hand is lost."""
        return (self.opening() < -0.5) | super().failed()

    def human_reward(self) -> Tensor:
        """Returns 2 + 5 * opening (with both hands near) minus both reaches."""
        right, left = self.reaches()
        return 2.0 + self.opening() - right - left
