"""Helpers that generated code may call without defining them.

`dist` and `rot_dist` are in the contract. The quaternion helpers (xyzw) bear the names that functions written for the
original environments find in scope there; they are accepted, and no prompt advertises them.
"""

from collections.abc import Callable

import torch
from torch import Tensor


def dist(a: Tensor, b: Tensor) -> Tensor:
    """Returns the Euclidean distance along the last dimension."""
    return torch.linalg.vector_norm(a - b, 2, [-1])


def rot_dist(q1: Tensor, q2: Tensor) -> Tensor:
    """Returns the angle of q1 * conjugate(q2), in radians."""
    a, b = q1, q2
    x = ((a[..., 0] * b[..., 3]) - (a[..., 3] * b[..., 0])) - ((a[..., 1] * b[..., 2]) - (a[..., 2] * b[..., 1]))
    y = ((a[..., 1] * b[..., 3]) - (a[..., 3] * b[..., 1])) - ((a[..., 2] * b[..., 0]) - (a[..., 0] * b[..., 2]))
    z = ((a[..., 2] * b[..., 3]) - (a[..., 3] * b[..., 2])) - ((a[..., 0] * b[..., 1]) - (a[..., 1] * b[..., 0]))
    return 2.0 * torch.asin(torch.clamp(torch.linalg.vector_norm(torch.stack([x, y, z], -1), 2, [-1]), max=1.0))


def quat_conjugate(a: Tensor) -> Tensor:
    """Returns the conjugate."""
    return torch.cat([-a[..., 0:3], a[..., 3:4]], -1)


def quat_mul(a: Tensor, b: Tensor) -> Tensor:
    """Returns the product."""
    u, v, s, t = a[..., 0:3], b[..., 0:3], a[..., 3:4], b[..., 3:4]
    return torch.cat([((s * v) + (t * u)) + torch.linalg.cross(u, v, dim=-1), (s * t) - torch.sum(u * v, -1, True)], -1)


def quat_rotate(q: Tensor, v: Tensor) -> Tensor:
    """Returns the vector, rotated."""
    t = 2.0 * torch.linalg.cross(q[..., 0:3], v, dim=-1)
    return (v + (q[..., 3:4] * t)) + torch.linalg.cross(q[..., 0:3], t, dim=-1)


def quat_rotate_inverse(q: Tensor, v: Tensor) -> Tensor:
    """Returns the vector, rotated by the inverse."""
    t = 2.0 * torch.linalg.cross(q[..., 0:3], v, dim=-1)
    return (v - (q[..., 3:4] * t)) + torch.linalg.cross(q[..., 0:3], t, dim=-1)


def normalize(x: Tensor, eps: float = 1e-09) -> Tensor:
    """Returns the vector of length 1."""
    return x / torch.clamp(torch.linalg.vector_norm(x, 2, [-1], True), min=eps)


def tensor_clamp(t: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Returns the tensor between two others."""
    return torch.maximum(torch.minimum(t, high), low)


_FUNCTIONS = (dist, rot_dist, quat_conjugate, quat_mul, quat_rotate, quat_rotate_inverse, normalize, tensor_clamp)
HELPERS_IN_SCOPE: dict[str, Callable[..., Tensor]] = {f.__name__: f for f in _FUNCTIONS} | {"quat_apply": quat_rotate}
"""Functions in scope by name."""
