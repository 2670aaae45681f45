"""A picture of a task: the scene at an episode's start, by MuJoCo's renderer (EGL, or what MUJOCO_GL names)."""

import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from porse.sim.physics import CpuPhysics
from porse.tasks.base import Task

Pixels = NDArray[np.uint8]

_TABLE = ((0.2, 0.0, 0.65), 1.7, 50.0, -30.0)
VIEWS: dict[str, tuple[tuple[float, float, float], float, float, float]] = {
    "Quadcopter": ((0.3, 0.5, 1.6), 2.2, 130.0, -15.0),
    "FrankaCabinet": ((0.5, 0.0, 0.5), 2.4, 125.0, -20.0),
    "Anymal": ((0.0, 0.0, 0.4), 2.2, 130.0, -15.0),
    "Humanoid": ((0.0, 0.0, 0.9), 3.2, 150.0, -10.0),
    "Over": ((0.0, -0.5, 0.5), 1.5, 0.0, -30.0),
    "ReOrientation": ((0.0, -0.57, 0.5), 1.5, 0.0, -30.0),
    "CatchUnderarm": ((0.0, -0.57, 0.5), 1.5, 0.0, -30.0),
    "TwoCatchUnderarm": ((0.0, -0.57, 0.5), 1.5, 0.0, -30.0),
    "CatchAbreast": ((-0.2, -0.85, 0.5), 1.5, 90.0, -35.0),
    "CatchOver2Underarm": ((0.0, -0.4, 0.65), 1.7, 0.0, -20.0),
    "LiftUnderarm": ((0.0, -0.6, 0.45), 1.8, 20.0, -25.0),
    **{
        f"Door{action}": ((0.3, 0.0, 0.7), 2.4, 150.0, -15.0)
        for action in ("CloseInward", "CloseOutward", "OpenInward", "OpenOutward")
    },
    "BottleCap": ((0.0, -0.65, 0.5), 1.3, 20.0, -20.0),
    **dict.fromkeys(
        (
            "BlockStack",
            "GraspAndPlace",
            "Kettle",
            "Pen",
            "PushBlock",
            "Scissors",
            "SwingCup",
            "Switch",
            "SwitchReachable",
        ),
        _TABLE,
    ),
}
"""Where the camera looks (m), from how far (m), at what azimuth and elevation (degrees).

Other tasks are seen as their scene's <statistic> and <visual><global> say.
"""


def picture(task: Task, width: int, height: int) -> Pixels:
    """Returns the first environment as it is now, `(height, width, 3)`, 8-bit RGB."""
    with camera(task, width, height) as take:
        return take()


@contextmanager
def camera(task: Task, width: int, height: int) -> Iterator[Callable[[], Pixels]]:
    """Sets a camera up, once for many pictures, and gives what takes one of the first environment as it is then."""
    model, data = first_simulation(task)
    view = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, view)
    if task.NAME in VIEWS:
        view.lookat[:], view.distance, view.azimuth, view.elevation = VIEWS[task.NAME]
    with mujoco.Renderer(model, height, width) as renderer:

        def take() -> Pixels:
            first_simulation(task, data)
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, view)
            return renderer.render()

        yield take


def first_simulation(task: Task, data: mujoco.MjData | None = None) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Returns the model and the state of the first environment, into `data` when it is given; derived fields are not."""
    physics = task._physics
    assert isinstance(physics, CpuPhysics)
    return physics.model, physics._batch.get_data(0, data)


def write_png(path: Path, pixels: Pixels) -> None:
    """Writes an 8-bit RGB picture `(height, width, 3)` as PNG: the same pixels give the same bytes."""
    height, width, _ = pixels.shape
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows, 9)), (b"IEND", b""))
    content = b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    )
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + content)
