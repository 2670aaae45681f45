"""What draws here: MuJoCo's renderers, chosen and tried before MuJoCo is imported; and how to do without one."""

import ctypes
import ctypes.util
import os
import subprocess
import sys

from porse.errors import PorseError

_DRAW = """
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><light pos='0 0 3'/><geom size='1'/></worldbody></mujoco>")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 24, 32) as renderer:
    renderer.update_scene(data)
    assert renderer.render().any(), "the picture is black"
"""

_DRAW_S = 60


def has_display() -> bool:
    """Returns whether a window can be opened: DISPLAY may name an X server that is no more."""
    if sys.platform == "darwin":
        return True
    if not os.environ.get("DISPLAY"):
        return False
    name = ctypes.util.find_library("X11")
    if name is None:
        return False
    x11 = ctypes.CDLL(name)
    x11.XOpenDisplay.restype = ctypes.c_void_p
    x11.XCloseDisplay.argtypes = [ctypes.c_void_p]
    display = x11.XOpenDisplay(None)
    if display:
        x11.XCloseDisplay(display)
    return bool(display)


def choose_renderer() -> None:
    """Names the renderer that works without a display, before MuJoCo is imported; MUJOCO_GL goes first.

    Raises:
        PorseError: there is no display, and neither EGL nor OSMesa.
    """
    if os.environ.get("MUJOCO_GL") or has_display():
        return
    for library, name in (("EGL", "egl"), ("OSMesa", "osmesa")):
        if ctypes.util.find_library(library):
            os.environ["MUJOCO_GL"] = name
            return
    raise PorseError("expected a display, EGL or OSMesa to draw with, found none; install libegl1 or libosmesa6")


def draws() -> str:
    """Draws a small picture in a process of its own, and returns the name of what drew it.

    Raises:
        PorseError: nothing can draw here, or what was chosen does not.
    """
    choose_renderer()
    back_end = os.environ.get("MUJOCO_GL") or "the display"
    try:
        done = subprocess.run(
            [sys.executable, "-c", _DRAW], capture_output=True, text=True, check=False, timeout=_DRAW_S
        )
    except subprocess.TimeoutExpired:
        found = f"nothing after {_DRAW_S} s"
    else:
        if not done.returncode:
            return back_end
        found = (done.stderr.strip().splitlines() or [f"that the process ended with {done.returncode}"])[-1]
    raise PorseError(
        f"expected {back_end} to draw a picture, found {found}; install libegl1 or libosmesa6, or set MUJOCO_GL to "
        "egl or osmesa"
    )


def no_renderer() -> str:
    """Returns why nothing can be drawn here, empty where it can; called before MuJoCo is imported.

    MuJoCo is imported without a renderer then: it looks for what MUJOCO_GL names, and the import fails where that is not there.
    """
    try:
        draws()
    except PorseError as error:
        os.environ["MUJOCO_GL"] = "disable"
        return str(error)
    return ""


def import_without_drawing() -> None:
    """Sees to it that MuJoCo can be imported by who draws nothing; without MUJOCO_GL it always can, and nothing is tried."""
    if os.environ.get("MUJOCO_GL"):
        no_renderer()
