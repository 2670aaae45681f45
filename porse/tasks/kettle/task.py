"""Kettle (PourWater): one hand tilts a kettle over a bucket that the other hand holds.

Departure: the water is 8 balls of 1 cm radius instead of 30 of half a centimetre, which are too small for this time
step; no ball enters a reward. As in the original, the bucket's point lies 10 cm below the bucket.
"""

import math
from typing import ClassVar

import mujoco
import torch
from torch import Tensor

from porse.tasks import dress, objects, shadow
from porse.tasks.free_hands import Handle
from porse.tasks.hand_observations import free_hands, moving_body
from porse.tasks.hand_variables import body_variables, free_hand_variables, goal_variables, point_variables
from porse.tasks.handle_task import HandleTask
from porse.variables import Variable

DROPPED = 0.2
POURING = 0.05
"""Distance (m) between spout and bucket point below which the task is solved."""

DROPS = 8
DROP_RADIUS = 0.01
"""The water."""


class Kettle(HandleTask):
    """Bring spout and bucket together."""

    NAME: ClassVar[str] = "Kettle"
    DESCRIPTION: ClassVar[str] = (
        "one shadow hand holds a kettle and the other holds a bucket; together they pour the water from the "
        "kettle into the bucket"
    )
    STARTS: ClassVar[str] = "the kettle, with the water in it, and the bucket stand on the table"
    ENDS: ClassVar[str] = "as soon as the bucket's point (bucket_handle_pos) is at 0.2 m or lower"
    FITNESS: ClassVar[str] = (
        "the share of episodes in which the spout once was within 5 cm of the bucket's point, which lies 10 cm "
        "below the bucket; the water itself does not count"
    )
    NUM_OBSERVATIONS: ClassVar[int] = 417
    EPISODE_LENGTH: ClassVar[int] = 125
    TIME_LIMIT: ClassVar[int] = 125
    RIGHT: ClassVar[shadow.BasePose] = shadow.BasePose((0.55, 0.2, 0.6), (math.pi, 1.57, 1.57))
    LEFT: ClassVar[shadow.BasePose] = shadow.BasePose((0.55, -0.2, 0.6), (math.pi, -1.57, 1.57))
    OBJECT_BODIES: ClassVar[tuple[str, ...]] = (
        "object", "link_1", "link_0", "bucket", "bucket_link_1", "goal", "table", *(f"drop{i}" for i in range(DROPS)),
    )  # fmt: skip
    ACTORS: ClassVar[tuple[str, ...]] = ("object", "bucket", "goal", "table")
    HANDLES: ClassVar[tuple[Handle, ...]] = (
        Handle("kettle_handle", "object", (0.15, 0.0, 0.0)),
        Handle("kettle_spout", "object", (-0.2, 0.0, 0.07)),
        Handle("bucket_handle", "bucket", (0.0, 0.0, -0.1)),
    )
    RIGHT_HANDLE: ClassVar[str] = "kettle_handle"
    LEFT_HANDLE: ClassVar[str] = "bucket_handle"
    VARIABLES: ClassVar[tuple[Variable, ...]] = (
        *body_variables("object", "the kettle"),
        *goal_variables("goal", "the goal (10 m above the kettle's own place)"),
        *point_variables("kettle_handle", "the handle of the kettle, for the right hand"),
        *point_variables("kettle_spout", "the spout of the kettle"),
        *point_variables("bucket_handle", "the point of the bucket, for the left hand"),
        *free_hand_variables(NUM_OBSERVATIONS, OBJECT_BODIES, ACTORS),
    )

    kettle_handle_pos: Tensor
    kettle_spout_pos: Tensor
    bucket_handle_pos: Tensor

    @classmethod
    def add_objects(cls, spec: mujoco.MjSpec) -> None:
        """Adds the table, the kettle with lid and water, the bucket, and the goal."""
        objects.add_table(spec, (0.5, 1.0, 0.4))
        base = objects.add_base(spec, "object", (0.0, 0.0, 0.5), (0.0, 0.0, 1.57))
        body = objects.add_link(base, "link_1")
        objects.add_tub(body, "kettle", (-0.09, -0.074, -0.09), (0.09, 0.06, 0.09), 0.012, up=1, mass=2.2)
        objects.add_rod(body, "spout", (0.0, 0.0, 0.09), (0.0, 0.07, 0.2), 0.015, 0.13)
        objects.add_rod(body, "handle_upper", (0.0, 0.05, -0.09), (0.0, 0.05, -0.15), 0.01, 0.04)
        objects.add_rod(body, "handle_bar", (0.0, -0.05, -0.15), (0.0, 0.05, -0.15), 0.012, 0.05)
        objects.add_rod(body, "handle_lower", (0.0, -0.05, -0.09), (0.0, -0.05, -0.15), 0.01, 0.04)
        lid = body.add_body(name="link_0")
        objects.add_slide(lid, "lid", (0.0, 1.0, 0.0), (0.0, 0.032), damping=1.0, friction=1.0)
        objects.add_box(lid, "lid", (-0.074, 0.061, -0.074), (0.074, 0.072, 0.074), 0.16)
        bucket = objects.add_base(spec, "bucket", (0.0, -0.3, 0.5))
        tub = objects.add_link(bucket, "bucket_link_1")
        objects.add_tub(tub, "bucket", (-0.057, -0.053, -0.057), (0.057, 0.0445, 0.057), 0.008, up=1, mass=0.2)
        for i in range(DROPS):
            place = (0.025 * (i % 4 - 1.5), 0.03 * (i // 4 - 0.5), 0.46)
            drop = objects.add_base(spec, f"drop{i}", place)
            drop.add_geom(
                name=f"drop{i}", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[DROP_RADIUS, 0, 0], mass=0.004,
                contype=objects.OBJECT_BIT, conaffinity=objects.HAND_BIT | objects.OBJECT_BIT,
                rgba=[0.2, 0.4, 0.9, 1],
            )  # fmt: skip
        objects.add_goal(spec, (0.0, 0.0, 0.5), (0.0, 0.0, 1.57), lift=objects.LIFT)
        dress.dress_kettle(spec)
        dress.dress_bucket(spec, "bucket_link_1")

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
