"""The base of the two switch tasks: each hand presses a rocker switch on a table.

The tracked point of a rocker rises as the rocker turns, from 0.6917 m to 0.7023 m.
"""

import math
from typing import ClassVar

import mujoco
import torch
from torch import Tensor

from porse.tasks import looks
from porse.tasks.hands import objects
from porse.tasks.hands.free_hands import Handle, handle_variables
from porse.tasks.hands.handles import TableTask
from porse.tasks.hands.observations import free_hands, moving_body
from porse.tasks.hands.variables import body_variables, free_hand_variables, goal_variables
from porse.variables import Variable

LIMIT = 0.5585
FRICTION = 1.0


def add_switch(spec: mujoco.MjSpec, name: str, y: float) -> None:
    """Adds a fixed switch with its rocker up: bodies `name`, `name`_link_1 (housing), `name`_link_0 (rocker)."""
    base = objects.add_base(spec, name, (0.0, y, 0.65), (math.pi, 1.57, 0.0), free=False)
    housing = objects.add_link(base, f"{name}_link_1")
    objects.add_box(housing, f"{name}_housing", (-0.0513, -0.0755, -0.095), (0.0512, 0.0755, 0.025), 0.68)
    rocker = housing.add_body(name=f"{name}_link_0", pos=[0.0502, -0.0109, 0.0417])
    objects.add_hinge(rocker, f"{name}_rocker", (-1.0, 0.0, 0.0), (0.0, LIMIT), damping=0.01, friction=0.02)
    objects.add_box(rocker, f"{name}_rocker", (-0.081, -0.0505, -0.013), (-0.021, 0.0505, 0.013), 0.042)
    looks.paint(spec, f"{name}_housing", looks.WHITE)
    looks.paint(spec, f"{name}_rocker", looks.RED)


class SwitchTask(TableTask):
    """Two switches on a table, one for each hand."""

    DESCRIPTION: ClassVar[str] = "two shadow hands, each with its fingers, press the desired button of a switch"
    ENDS: ClassVar[str] = "never"
    NUM_OBSERVATIONS: ClassVar[int] = 417
    OBJECT_BODIES: ClassVar[tuple[str, ...]] = (
        "object", "object_link_1", "object_link_0", "other", "other_link_1", "other_link_0", "goal", "table",
    )  # fmt: skip
    ACTORS: ClassVar[tuple[str, ...]] = ("object", "other", "goal", "table")
    HANDLES: ClassVar[tuple[Handle, ...]] = (
        Handle(
            "switch_right_handle", "object_link_0", "the rocker for the right hand", (-0.05, -0.02, 0.0), hand="right"
        ),
        Handle("switch_left_handle", "other_link_0", "the rocker for the left hand", (-0.05, -0.02, 0.0), hand="left"),
    )
    VARIABLES: ClassVar[tuple[Variable, ...]] = (
        *body_variables("object", "the right switch"),
        *goal_variables("goal", "the goal (10 m above the right switch's own place)"),
        *handle_variables(HANDLES),
        *free_hand_variables(NUM_OBSERVATIONS, OBJECT_BODIES, ACTORS),
    )

    switch_right_handle_pos: Tensor
    switch_left_handle_pos: Tensor

    @classmethod
    def add_objects(cls, spec: mujoco.MjSpec) -> None:
        """Adds the table, both switches, and the goal."""
        objects.add_table(spec, (0.5, 1.0, 0.55))
        add_switch(spec, "object", 0.2)
        add_switch(spec, "other", -0.2)
        objects.add_goal(spec, (0.0, 0.2, 0.65), (math.pi, 1.57, 0.0), lift=objects.LIFT)

    def compute_observations(self) -> Tensor:
        """Returns the observations, `(num_envs, 417)`: two hands, the right switch, both rockers."""
        return torch.cat(
            (
                free_hands(self, self.right_hand_pos, self.left_hand_pos),
                moving_body(self.object_pose, self.object_linvel, self.object_angvel),
                self.switch_right_handle_pos,
                self.switch_left_handle_pos,
            ),
            dim=-1,
        )

    def depth(self) -> Tensor:
        """Returns 1.4 m minus the sum of the heights of both tracked points, `(num_envs,)`."""
        return 1.4 - (self.switch_right_handle_pos[:, 2] + self.switch_left_handle_pos[:, 2])

    def failed(self) -> Tensor:
        """Returns nowhere: only the time limit ends an episode."""
        return torch.zeros(self.num_envs, dtype=torch.bool)

    def human_reward(self) -> Tensor:
        """Returns 2 minus both reaches plus 50 times the depth."""
        right, left = self.reaches()
        return 2.0 - right - left + 50.0 * self.depth()
