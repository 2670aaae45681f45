"""Rotations as quaternions (x, y, z, w), with the same bits on every CPU in the `portable` numeric profile.

`torch.sqrt`, `pow(0.5)`, `acos` and `asin` go through vector libraries that choose their code by the CPU's vendor, so
none of them is used here. A square root is NumPy's (one correctly rounded instruction), an arcsine is a polynomial,
and a cosine is a shifted sine. Quaternions are float32 tensors `(..., 4)` of norm 1 unless said.
"""

import math

import numpy as np
import torch
from torch import Tensor

XYZW_FROM_WXYZ = [1, 2, 3, 0]
"""Indices that turn MuJoCo's quaternions into ours."""

WXYZ_FROM_XYZW = [3, 0, 1, 2]
"""Indices that turn our quaternions into MuJoCo's."""

_TURNS = torch.tensor((3, 2, 1, 0, 2, 3, 0, 1, 1, 0, 3, 2))
_TURN_SIGNS = torch.tensor((1, -1, 1, -1, 1, 1, -1, -1, -1, 1, 1, -1.0))
"""Signed components of q by which x, y and z of p are multiplied in the product p q."""


def sqrt(x: Tensor) -> Tensor:
    """Returns the square root; on the CPU it is correctly rounded, and so the same on every CPU."""
    return torch.from_numpy(np.sqrt(x.numpy())) if x.device.type == "cpu" else torch.sqrt(x)


def cos(x: Tensor) -> Tensor:
    """Returns the cosine, from the sine."""
    return torch.sin(x + math.pi / 2)


def asin(x: Tensor) -> Tensor:
    """Returns the arcsine of `x` in [0, 1], to 3e-7: the Cephes polynomial, above 1/2 by the half angle."""
    high = x > 0.5
    z = torch.where(high, (1.0 - x) * 0.5, x * x)
    s = torch.where(high, sqrt(z), x)
    p = 4.2163199048e-2 * z + 2.4181311049e-2
    p = (p * z + 4.5470025998e-2) * z + 7.4953002686e-2
    small = s + s * z * (p * z + 1.6666752422e-1)
    return torch.where(high, math.pi / 2 - 2.0 * small, small)


def multiply(p: Tensor, q: Tensor) -> Tensor:
    """Returns the product p q: the rotation q, then p. Shapes broadcast to `(..., 4)`."""
    # Row i holds what part i of p is multiplied by, x, y and z after w: few operations on all rows instead of many small ones.
    turned = (q.index_select(-1, _TURNS) * _TURN_SIGNS).view(*q.shape[:-1], 3, 4)
    x, y, z = (p[..., :3].unsqueeze(-1) * turned).unbind(-2)
    return p[..., 3:] * q + x + y + z


def conjugate(q: Tensor) -> Tensor:
    """Returns the inverse rotation."""
    return torch.cat((-q[..., :3], q[..., 3:]), dim=-1)


def rotate(q: Tensor, v: Tensor) -> Tensor:
    """Returns the vectors `v` `(..., 3)` turned by `q`: v + 2 w (u x v) + 2 u x (u x v), with q = (u, w)."""
    return _rotate(q[..., :3], q[..., 3:], v)


def _rotate(u: Tensor, w: Tensor, v: Tensor) -> Tensor:
    if u.shape != v.shape:
        u, v = torch.broadcast_tensors(u, v)
    t = 2.0 * torch.cross(u, v, dim=-1)
    return v + w * t + torch.cross(u, t, dim=-1)


def rotate_inverse(q: Tensor, v: Tensor) -> Tensor:
    """Returns the vectors `v` `(..., 3)` turned back by `q`: a world vector in the frame of q."""
    return _rotate(-q[..., :3], q[..., 3:], v)


def about_axis(axis: int, angle: Tensor) -> Tensor:
    """Returns the rotations by `angle` (rad) `(...)` about a coordinate axis (0, 1, 2): `(..., 4)`."""
    q = torch.zeros(*angle.shape, 4, dtype=angle.dtype, device=angle.device)
    q[..., axis] = torch.sin(angle * 0.5)
    q[..., 3] = cos(angle * 0.5)
    return q


def rotation_distance(p: Tensor, q: Tensor) -> Tensor:
    """Returns the angle (rad) between two orientations, 2 asin(min(1, |vec(p q*)|)), `(...)`."""
    vector = multiply(p, conjugate(q))[..., :3]
    return 2.0 * asin(torch.norm(vector, dim=-1).clamp(max=1.0))


def euler_xyz(q: Tensor) -> Tensor:
    """Returns roll, pitch and yaw (rad) `(..., 3)` of Rz(yaw) Ry(pitch) Rx(roll), each in [0, 2 pi)."""
    x, y, z, w = q.unbind(-1)
    roll = torch.atan2(2.0 * (w * x + y * z), w * w - x * x - y * y + z * z)
    sine = (2.0 * (w * y - z * x)).clamp(-1.0, 1.0)
    pitch = torch.sign(sine) * asin(torch.abs(sine))
    yaw = torch.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return torch.remainder(torch.stack((roll, pitch, yaw), dim=-1), 2.0 * math.pi)


def tilted_up(q: Tensor) -> Tensor:
    """Returns the z component `(...)` of the frame's z axis: 1 upright, -1 upside down."""
    return 1.0 - 2.0 * (q[..., 0] * q[..., 0] + q[..., 1] * q[..., 1])
