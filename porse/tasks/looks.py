"""How scenes look: sky, floor, light, materials, and shapes that are seen and touch nothing.

What is only seen has no mass and meets nothing, so it changes no bit of the physics. Where a body has such a look, the
geoms that do collide are in group 3, which MuJoCo's renderer and viewer leave out unless they are asked for (key 3).
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

Colour = tuple[float, float, float, float]
Point = tuple[float, float, float]

WOOD: Colour = (0.66, 0.48, 0.32, 1.0)
STEEL: Colour = (0.68, 0.71, 0.75, 1.0)
DARK: Colour = (0.16, 0.17, 0.19, 1.0)
WHITE: Colour = (0.93, 0.93, 0.9, 1.0)
BLUE: Colour = (0.16, 0.38, 0.72, 1.0)
RED: Colour = (0.76, 0.2, 0.17, 1.0)
ORANGE: Colour = (0.95, 0.55, 0.13, 1.0)
GREEN: Colour = (0.22, 0.62, 0.4, 1.0)

HIDDEN = 3
"""Group of geoms that collide and are not seen."""

_SEEN = 1
_SIDES = 24
"""Corners of a circle."""

_TEXELS = 16
_CUBE_SIDES = ((214, 63, 52), (242, 145, 36), (247, 206, 70), (72, 158, 92), (58, 116, 196), (142, 88, 168))
_CUBE_EDGE = (240, 240, 236)
_SKY, _HORIZON = (0.36, 0.55, 0.78), (0.86, 0.91, 0.96)
_TILES = ((0.62, 0.65, 0.68), (0.56, 0.59, 0.63), (0.5, 0.53, 0.57))
_TILE_SIZE = 1.0
"""Width (m) of two floor tiles."""


def read_scene(module: str) -> mujoco.MjSpec:
    """Returns the scene in `scene.xml` beside a module, which gives its own `__file__`."""
    return mujoco.MjSpec.from_string(Path(module).with_name("scene.xml").read_text(encoding="utf-8"))


def surround(spec: mujoco.MjSpec, extent: float = 2.0, centre: Point = (0.0, 0.0, 0.5)) -> None:
    """Gives a scene with a plane "floor" and a light "light" a sky, tiles, and light that shows shapes and shadows.

    Args:
        spec: the scene.
        extent: size (m) of what is to be looked at; MuJoCo's own estimate takes in goals that hang in the air.
        centre: its middle (m).
    """
    spec.add_texture(
        name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=_SKY, rgb2=_HORIZON, width=128, height=128,
    )  # fmt: skip
    spec.add_texture(
        name="tiles", type=mujoco.mjtTexture.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        mark=mujoco.mjtMark.mjMARK_EDGE, rgb1=_TILES[0], rgb2=_TILES[1], markrgb=_TILES[2], width=256, height=256,
    )  # fmt: skip
    tiles = spec.add_material(name="tiles", texuniform=True, texrepeat=[1.0 / _TILE_SIZE, 1.0 / _TILE_SIZE])
    tiles.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
    floor = spec.geom("floor")
    floor.material, floor.rgba = "tiles", [1.0, 1.0, 1.0, 1.0]
    floor.size = [0.0, 0.0, 0.1]  # seen without an end; a plane has none in the physics either
    light = spec.light("light")
    # A spot light: the renderer speckles an endless floor with shadows of its own under a directional one.
    light.pos = [centre[0] + 1.0, centre[1] - 0.8, 4.5]
    light.dir, light.cutoff, light.exponent = [-0.25, 0.2, -1.0], 75.0, 2.0
    light.diffuse, light.specular = [0.45, 0.45, 0.43], [0.2, 0.2, 0.2]
    visual = spec.visual
    visual.headlight.ambient, visual.headlight.diffuse = [0.5, 0.51, 0.53], [0.3, 0.3, 0.3]
    visual.headlight.specular = [0.05, 0.05, 0.05]
    visual.rgba.haze = [*_HORIZON, 1.0]
    visual.quality.shadowsize = 4096
    visual.map.znear = 0.01
    spec.stat.extent, spec.stat.center = extent, centre


def add_cube_material(spec: mujoco.MjSpec) -> None:
    """Adds the material "cube", whose six sides have colours of their own, once."""
    if spec.material("cube") is not None:
        return
    sides = np.empty((6, _TEXELS, _TEXELS, 3), np.uint8)
    for side, colour in enumerate(_CUBE_SIDES):
        sides[side] = _CUBE_EDGE
        sides[side, 1:-1, 1:-1] = colour
    spec.add_texture(
        name="cube", type=mujoco.mjtTexture.mjTEXTURE_CUBE, width=_TEXELS, height=6 * _TEXELS, nchannel=3,
        data=sides.ravel().tolist(),
    )  # fmt: skip
    spec.add_material(name="cube").textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "cube"


def look(body: mujoco.MjsBody, name: str, mesh: str, colour: Colour, place: Point = (0.0, 0.0, 0.0)) -> None:
    """Adds a mesh of the scene to a body, to be seen only."""
    body.add_geom(
        name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh, pos=place, rgba=colour, mass=0.0, contype=0,
        conaffinity=0, group=_SEEN,
    )  # fmt: skip


def look_sphere(body: mujoco.MjsBody, name: str, place: Point, radius: float, colour: Colour) -> None:
    """Adds a ball to a body, to be seen only."""
    body.add_geom(
        name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], pos=place, rgba=colour, mass=0.0,
        contype=0, conaffinity=0, group=_SEEN,
    )  # fmt: skip


def hide(spec: mujoco.MjSpec, *starts: str) -> None:
    """Takes out of sight the geoms that collide and whose names start so."""
    for geom in spec.geoms:
        if geom.name.startswith(starts) and geom.contype:
            geom.group = HIDDEN


def paint(spec: mujoco.MjSpec, start: str, colour: Colour) -> None:
    """Gives the geoms whose names start so a colour."""
    for geom in spec.geoms:
        if geom.name.startswith(start):
            geom.rgba = colour


def add_lathe(spec: mujoco.MjSpec, name: str, profile: Sequence[tuple[float, float]]) -> None:
    """Adds a mesh that is round about the y axis.

    Args:
        spec: the scene.
        name: of the mesh.
        profile: radius and height (m) from the axis at the bottom to the axis at the top, along the outside.
    """
    rings = [
        [(radius * math.cos(turn), height, radius * math.sin(turn)) for turn in _turns()] for radius, height in profile
    ]
    _add_mesh(spec, name, rings)


def add_tube(
    spec: mujoco.MjSpec, name: str, path: Sequence[Point], radii: Sequence[float], closed: bool = False
) -> None:
    """Adds a mesh: a round tube along a smooth way through some points (m), with a radius (m) at each.

    Args:
        spec: the scene.
        name: of the mesh.
        path: the points.
        radii: the radii, or one for all.
        closed: whether the way ends where it began.
    """
    points, sizes = _smooth(np.array(path), np.array(radii if len(radii) > 1 else [radii[0]] * len(path)), closed)
    rings: list[list[Point]] = []
    side = np.zeros(3)
    for place in range(len(points)):
        before, after = (
            (points[place - 1], points[(place + 1) % len(points)])
            if closed
            else (points[max(place - 1, 0)], points[min(place + 1, len(points) - 1)])
        )
        ahead = (after - before) / np.linalg.norm(after - before)
        if not side.any():
            side = np.cross(ahead, [1.0, 0.0, 0.0] if abs(ahead[0]) < 0.9 else [0.0, 1.0, 0.0])
        side = side - ahead * (side @ ahead)
        side = side / np.linalg.norm(side)
        other = np.cross(side, ahead)
        rings.append(
            [
                tuple(points[place] + sizes[place] * (math.cos(turn) * side + math.sin(turn) * other))
                for turn in _turns(12)
            ]
        )
    if closed:
        _add_mesh(spec, name, [*rings, rings[0]])
        return
    ends = [[tuple(points[end])] * 12 for end in (0, -1)]
    _add_mesh(spec, name, [ends[0], *rings, ends[1]])


def _turns(sides: int = _SIDES) -> Iterator[float]:
    return (2.0 * math.pi * side / sides for side in range(sides))


def _smooth(
    points: NDArray[np.float64], sizes: NDArray[np.float64], closed: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns four points for each step of a way, on the Catmull-Rom spline through its points."""
    count = len(points)
    both = np.concatenate([points, sizes[:, None]], axis=1)
    found = []
    for start in range(count if closed else count - 1):
        a, b, c, d = (
            both[i % count] if closed else both[min(max(i, 0), count - 1)] for i in range(start - 1, start + 3)
        )
        for share in (0.0, 0.25, 0.5, 0.75):
            found.append(
                0.5
                * (
                    2 * b
                    + (c - a) * share
                    + (2 * a - 5 * b + 4 * c - d) * share**2
                    + (3 * b - a - 3 * c + d) * share**3
                )
            )
    if not closed:
        found.append(both[-1])
    made = np.array(found)
    return made[:, :3], made[:, 3]


def _add_mesh(spec: mujoco.MjSpec, name: str, rings: Sequence[Sequence[Point]]) -> None:
    """Adds a mesh of rings of as many corners each; a ring of equal corners is a tip."""
    corners: list[Point] = []
    number: dict[Point, int] = {}
    index = []
    for ring in rings:
        row = []
        for corner in ring:
            key = (round(float(corner[0]), 9), round(float(corner[1]), 9), round(float(corner[2]), 9))
            if key not in number:
                number[key] = len(corners)
                corners.append(key)
            row.append(number[key])
        index.append(row)
    faces = []
    for low, high in itertools.pairwise(index):
        for i in range(len(low)):
            j = (i + 1) % len(low)
            for face in ((low[i], high[i], high[j]), (low[i], high[j], low[j])):
                if len(set(face)) == 3:
                    faces.append(face)
    sides = np.array(corners)[np.array(faces)]
    if np.einsum("ij,ij->i", sides[:, 0], np.cross(sides[:, 1], sides[:, 2])).sum() < 0.0:  # its volume: inside out
        faces = [(a, c, b) for a, b, c in faces]
    spec.add_mesh(
        name=name, uservert=np.array(corners).ravel(), userface=np.array(faces).ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL, smoothnormal=True,
    )  # fmt: skip
