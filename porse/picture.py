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

WIDTH, HEIGHT = 480, 360
"""Of a film's frames, and of gymnasium's."""

View = tuple[tuple[float, float, float], float, float, float]

_TABLE: View = ((0.16, 0.0, 0.66), 1.35, 28.0, -24.0)
_FACING: View = ((0.0, -0.55, 0.5), 1.25, 20.0, -22.0)
VIEWS: dict[str, View] = {
    "Quadcopter": ((0.0, 0.0, 1.0), 0.9, 130.0, -18.0),
    "FrankaCabinet": ((0.45, 0.0, 0.45), 2.1, 130.0, -18.0),
    "Anymal": ((0.0, 0.0, 0.4), 1.9, 130.0, -15.0),
    "Humanoid": ((0.0, 0.0, 0.95), 2.8, 150.0, -10.0),
    **dict.fromkeys(("Over", "ReOrientation", "CatchUnderarm", "TwoCatchUnderarm"), _FACING),
    "CatchAbreast": ((-0.22, -0.85, 0.5), 1.35, 68.0, -28.0),
    "CatchOver2Underarm": ((0.0, -0.35, 0.68), 1.6, 15.0, -14.0),
    "LiftUnderarm": ((0.0, -0.6, 0.45), 1.45, 20.0, -22.0),
    **{
        f"Door{action}": ((0.25, 0.0, 0.62), 2.1, 152.0, -14.0)
        for action in ("CloseInward", "CloseOutward", "OpenInward", "OpenOutward")
    },
    "BottleCap": ((0.0, -0.63, 0.52), 1.0, 20.0, -16.0),
    "Kettle": ((0.14, -0.05, 0.47), 1.25, 28.0, -26.0),
    **dict.fromkeys(
        ("BlockStack", "GraspAndPlace", "Pen", "PushBlock", "Scissors", "Switch", "SwitchReachable"), _TABLE
    ),
    "SwingCup": ((0.14, 0.0, 0.68), 1.05, 12.0, -22.0),
}
"""Where the camera looks (m), from how far (m), at what azimuth and elevation (degrees).

Other tasks are seen as their scene's <statistic> and <visual><global> say.
"""

FOLLOWED: dict[str, tuple[str, tuple[float, float, float]]] = {
    "Quadcopter": ("chassis", (0.5, 0.5, 0.5)),
    "Anymal": ("base", (1.0, 1.0, 0.0)),
    "Humanoid": ("torso", (1.0, 1.0, 0.0)),
}
"""Bodies that move far, and what share of the way from the view's place to them the camera goes on each axis.

It steps back by the rest of the way, so that the place, the quadcopter's target, stays in sight.
"""


def picture(task: Task, width: int, height: int) -> Pixels:
    """Returns the first environment as it is now, `(height, width, 3)`, 8-bit RGB."""
    with camera(task, width, height) as take:
        return take(0)


@contextmanager
def camera(
    task: Task, width: int, height: int, view_from: View | None = None, shadows: int | None = None
) -> Iterator[Callable[[int], Pixels]]:
    """Sets a camera up, once for many pictures, and gives what takes one of an environment as it is then.

    Args:
        task: what is drawn.
        width: of a picture, in pixels.
        height: of a picture, in pixels.
        view_from: where the camera looks and stands, which then follows nothing; None for the task's own view.
        shadows: the side of the shadow map, in texels; None for the scene's own.
    """
    model, data = first_simulation(task)
    view = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, view)
    chosen = view_from or VIEWS.get(task.NAME)
    if chosen:
        view.lookat[:], view.distance, view.azimuth, view.elevation = chosen
    # The default frame buffer of a scene may be smaller than what is asked for.
    model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
    model.vis.global_.offheight = max(model.vis.global_.offheight, height)
    with _shadows(model, shadows), mujoco.Renderer(model, height, width) as renderer:

        def take(index: int) -> Pixels:
            simulation(task, index, data)
            mujoco.mj_forward(model, data)
            if view_from is None:
                follow(task.NAME, data, view)
            renderer.update_scene(data, view)
            return renderer.render()

        yield take


@contextmanager
def _shadows(model: mujoco.MjModel, side: int | None) -> Iterator[None]:
    """Has the renderers that are made meanwhile draw shadows of this size; others see no difference."""
    own = model.vis.quality.shadowsize
    model.vis.quality.shadowsize = own if side is None else side
    try:
        yield
    finally:
        model.vis.quality.shadowsize = own


def follow(name: str, data: mujoco.MjData, view: mujoco.MjvCamera) -> None:
    """Turns the camera of a task of `FOLLOWED` to where its body is; others stay as they are."""
    if name in FOLLOWED:
        (body, shares), (place, distance, *_) = FOLLOWED[name], VIEWS[name]
        way = data.body(body).xpos - np.array(place)
        view.lookat[:] = place + np.array(shares) * way
        view.distance = distance + float(np.linalg.norm((1.0 - np.array(shares)) * way))


def first_simulation(task: Task, data: mujoco.MjData | None = None) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Returns the model and the state of the first environment, as `simulation` does."""
    return simulation(task, 0, data)


def simulation(task: Task, index: int, data: mujoco.MjData | None = None) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Returns the model and the state of an environment, into `data` when it is given; derived fields are not."""
    physics = task._physics
    assert isinstance(physics, CpuPhysics)
    return physics.model, physics._batch.get_data(index, data)


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
