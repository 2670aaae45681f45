"""Kettle (PourWater): one hand tilts a kettle over a bucket that the other hand holds.

Departure: the water is 8 balls of 1 cm radius instead of 30 of half a centimetre, which are too small for this time
step; no ball enters a reward. As in the original, the bucket's point lies 10 cm below the bucket.
"""

import math

import mujoco
import torch
from torch import Tensor

from porse.sim.physics import Capacity
from porse.tasks.hands import shadow
from porse.tasks.hands.free_hands import Handle, handle_variables
from porse.tasks.hands.handles import TableTask
from porse.tasks.hands.observations import free_hands, moving_body
from porse.tasks.hands.variables import body_variables, free_hand_variables, goal_variables
from porse.tasks.kettle import scene

DROPPED = 0.2
POURING = 0.05
"""Distance (m) between spout and bucket point below which the task is solved."""


class Kettle(TableTask):
    """Bring spout and bucket together."""

    NAME = "Kettle"
    DESCRIPTION = (
        "one shadow hand holds a kettle and the other holds a bucket; together they pour the water from the "
        "kettle into the bucket"
    )
    STARTS = "the kettle, with the water in it, and the bucket stand on the table"
    ENDS = "as soon as the bucket's point (bucket_handle_pos) is at 0.2 m or lower"
    FITNESS = (
        "the share of episodes in which the spout once was within 5 cm of the bucket's point, which lies 10 cm "
        "below the bucket; the water itself does not count"
    )
    NUM_OBSERVATIONS = 417
    CAPACITY = Capacity(contacts=128, rows=512)
    RIGHT = shadow.BasePose((0.55, 0.2, 0.6), (math.pi, 1.57, 1.57))
    LEFT = shadow.BasePose((0.55, -0.2, 0.6), (math.pi, -1.57, 1.57))
    OBJECT_BODIES = (
        "object", "link_1", "link_0", "bucket", "bucket_link_1", "goal", "table", *(f"drop{i}" for i in range(scene.DROPS)),
    )  # fmt: skip
    ACTORS = ("object", "bucket", "goal", "table")
    HANDLES = (
        Handle(
            "kettle_handle", "object", "the handle of the kettle, for the right hand", (0.15, 0.0, 0.0), hand="right"
        ),
        Handle("kettle_spout", "object", "the spout of the kettle", (-0.2, 0.0, 0.07)),
        Handle("bucket_handle", "bucket", "the point of the bucket, for the left hand", (0.0, 0.0, -0.1), hand="left"),
    )
    VARIABLES = (
        *body_variables("object", "the kettle"),
        *goal_variables("goal", "the goal (10 m above the kettle's own place)"),
        *handle_variables(HANDLES),
        *free_hand_variables(NUM_OBSERVATIONS, OBJECT_BODIES, ACTORS),
    )

    kettle_handle_pos: Tensor
    kettle_spout_pos: Tensor
    bucket_handle_pos: Tensor

    @classmethod
    def add_objects(cls, spec: mujoco.MjSpec) -> None:
        """Adds the table, the kettle with lid and water, the bucket, and the goal."""
        scene.add_objects(spec)

    def compute_observations(self) -> Tensor:
        """Returns the observations, `(num_envs, 417)`: two hands, the kettle, its handle, the bucket."""
        return torch.cat(
            (
                free_hands(self, self.right_hand_pos, self.left_hand_pos),
                moving_body(self.object_pose, self.object_linvel, self.object_angvel),
                self.kettle_handle_pos,
                self.bucket_handle_pos,
            ),
            dim=-1,
        )

    def gap(self) -> Tensor:
        """Returns the distance (m) between spout and bucket point, `(num_envs,)`."""
        return torch.norm(self.bucket_handle_pos - self.kettle_spout_pos, dim=-1)

    def succeeded(self) -> Tensor:
        """Returns where the spout is within 5 cm of the bucket point."""
        return self.gap() < POURING

    def failed(self) -> Tensor:
        """Returns where the bucket fell."""
        return self.bucket_handle_pos[:, 2] <= DROPPED

    def human_reward(self) -> Tensor:
        """Returns 1 minus both reaches, plus 0.5 - 2 gap with both hands near."""
        right, left = self.reaches()
        pouring = torch.where((right < 0.7) & (left < 0.7), 0.5 - 2.0 * self.gap(), 0.0)
        return 1.0 + pouring - right - left
