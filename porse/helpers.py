"""Helpers that generated code may call without defining them.

`dist` and `rot_dist` are in the contract. The others (quaternions xyzw) bear the names that functions written for the
original environments find in scope there, by `from ...torch_jit_utils import *`; they compute what those compute, are
accepted, and no prompt advertises them. Those that draw random numbers are left out.
"""

import inspect
import math
from collections.abc import Callable
from typing import Any

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


def quat_apply(a: Tensor, b: Tensor) -> Tensor:
    """Returns the vectors `b`, rotated."""
    t = 2.0 * torch.linalg.cross(a[..., 0:3], b, dim=-1)
    return (b + (a[..., 3:4] * t)) + torch.linalg.cross(a[..., 0:3], t, dim=-1)


def _rotate_parts(q: Tensor, v: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    u, w = q[..., 0:3], q[..., 3:4]
    along = u * (torch.sum(u * v, -1, True) * 2.0)
    return v * (2.0 * w * w - 1.0), torch.linalg.cross(u, v, dim=-1) * w * 2.0, along


def quat_rotate(q: Tensor, v: Tensor) -> Tensor:
    """Returns the vector, rotated: (2 w w - 1) v + 2 w (u x v) + 2 u (u . v). Without norm 1 it is not `quat_apply`."""
    straight, across, along = _rotate_parts(q, v)
    return straight + across + along


def quat_rotate_inverse(q: Tensor, v: Tensor) -> Tensor:
    """Returns the vector, rotated by the inverse."""
    straight, across, along = _rotate_parts(q, v)
    return straight - across + along


def normalize(x: Tensor, eps: float = 1e-09) -> Tensor:
    """Returns the vector of length 1."""
    return x / torch.clamp(torch.linalg.vector_norm(x, 2, [-1], True), min=eps)


def quat_axis(q: Tensor, axis: int = 0) -> Tensor:
    """Returns a coordinate axis, rotated."""
    basis = torch.zeros_like(q[..., 0:3])
    basis[..., axis] = 1.0
    return quat_rotate(q, basis)


def quat_from_angle_axis(angle: Tensor, axis: Tensor) -> Tensor:
    """Returns the rotation by an angle about an axis of any length."""
    half = (angle / 2.0).unsqueeze(-1)
    return normalize(torch.cat([normalize(axis) * torch.sin(half), torch.cos(half)], -1))


def quat_to_angle_axis(q: Tensor) -> tuple[Tensor, Tensor]:
    """Returns angle in [-pi, pi] and axis; angle 0 about z where there is hardly a turn."""
    w = q[..., 3]
    sine = torch.sqrt(1.0 - w * w)
    turns = torch.abs(sine) > 1e-5
    angle = torch.where(turns, normalize_angle(2.0 * torch.acos(w)), torch.zeros_like(w))
    return angle, torch.where(turns.unsqueeze(-1), q[..., 0:3] / sine.unsqueeze(-1), _upward(q))


def quat_from_euler_xyz(roll: Tensor, pitch: Tensor, yaw: Tensor) -> Tensor:
    """Returns the rotation Rz(yaw) Ry(pitch) Rx(roll)."""
    (cr, cp, cy), (sr, sp, sy) = ([f(angle * 0.5) for angle in (roll, pitch, yaw)] for f in (torch.cos, torch.sin))
    x = cy * sr * cp - sy * cr * sp
    y = cy * cr * sp + sy * sr * cp
    z = sy * cr * cp - cy * sr * sp
    return torch.stack([x, y, z, cy * cr * cp + sy * sr * sp], -1)


def get_euler_xyz(q: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Returns roll, pitch and yaw of Rz(yaw) Ry(pitch) Rx(roll), each in [0, 2 pi)."""
    x, y, z, w = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    roll = torch.atan2(2.0 * (w * x + y * z), w * w - x * x - y * y + z * z)
    sine = 2.0 * (w * y - z * x)
    pitch = torch.where(torch.abs(sine) >= 1.0, copysign(math.pi / 2.0, sine), torch.asin(sine))
    yaw = torch.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return roll % (2.0 * math.pi), pitch % (2.0 * math.pi), yaw % (2.0 * math.pi)


def normalize_angle(x: Tensor) -> Tensor:
    """Returns the angle in [-pi, pi]."""
    return torch.atan2(torch.sin(x), torch.cos(x))


def copysign(a: float, b: Tensor) -> Tensor:
    """Returns the size of `a` with the sign of `b`, 0 where that is 0."""
    return abs(a) * torch.sign(b)


def slerp(q0: Tensor, q1: Tensor, t: Tensor) -> Tensor:
    """Returns the rotation a share `t` `(..., 1)` of the shorter way from one to another."""
    cosine = torch.sum(q0 * q1, -1, True)
    q1 = torch.where(cosine < 0.0, -q1, q1)
    cosine = torch.abs(cosine)
    half, sine = torch.acos(cosine), torch.sqrt(1.0 - cosine * cosine)
    between = (torch.sin((1.0 - t) * half) / sine) * q0 + (torch.sin(t * half) / sine) * q1
    between = torch.where(torch.abs(sine) < 0.001, 0.5 * q0 + 0.5 * q1, between)
    return torch.where(torch.abs(cosine) >= 1.0, q0, between)


def tf_inverse(q: Tensor, t: Tensor) -> tuple[Tensor, Tensor]:
    """Returns the inverse of a frame, given as rotation and position."""
    inverse = quat_conjugate(q)
    return inverse, -quat_apply(inverse, t)


def tf_apply(q: Tensor, t: Tensor, v: Tensor) -> Tensor:
    """Returns a point of a frame in the outer one."""
    return quat_apply(q, v) + t


def tf_combine(q1: Tensor, t1: Tensor, q2: Tensor, t2: Tensor) -> tuple[Tensor, Tensor]:
    """Returns the second frame, which lies in the first, in the outer one."""
    return quat_mul(q1, q2), quat_apply(q1, t2) + t1


def get_axis_params(value: float, axis_idx: int, x_value: float = 0.0, n_dims: int = 3) -> list[float]:
    """Returns numbers that are 0 but for one, and the first."""
    found = [value if place == axis_idx else 0.0 for place in range(n_dims)]
    return [x_value, *found[1:]]


def to_torch(x: Any, dtype: torch.dtype = torch.float32, device: Any = None, requires_grad: bool = False) -> Tensor:
    """Returns numbers as a tensor, on the device of the variables."""
    return torch.tensor(x, dtype=dtype)


def scale(x: Tensor, lower: Tensor, upper: Tensor) -> Tensor:
    """Returns what lies in [-1, 1], stretched to [lower, upper]."""
    return (0.5 * (x + 1.0) * (upper - lower)) + lower


def unscale(x: Tensor, lower: Tensor, upper: Tensor) -> Tensor:
    """Returns what lies in [lower, upper], brought to [-1, 1]."""
    return (2.0 * x - upper - lower) / (upper - lower)


def tensor_clamp(t: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Returns the tensor between two others."""
    return torch.maximum(torch.minimum(t, high), low)


def local_to_world_space(pos_offset_local: Tensor, pose_global: Tensor) -> Tensor:
    """Returns a point in the frame of a pose `(..., 7)` in the world's."""
    return tf_apply(pose_global[..., 3:7], pose_global[..., 0:3], pos_offset_local)


def normalise_quat_in_pose(pose: Tensor) -> Tensor:
    """Returns the pose with a quaternion of norm 1."""
    turn = pose[..., 3:7]
    return torch.cat([pose[..., 0:3], turn / torch.linalg.vector_norm(turn, 2, [-1], True)], -1)


def calc_heading(q: Tensor) -> Tensor:
    """Returns the angle of the rotated x axis in the horizontal plane."""
    ahead = quat_axis(q, 0)
    return torch.atan2(ahead[..., 1], ahead[..., 0])


def calc_heading_quat(q: Tensor) -> Tensor:
    """Returns the rotation about z by that angle."""
    return quat_from_angle_axis(calc_heading(q), _upward(q))


def calc_heading_quat_inv(q: Tensor) -> Tensor:
    """Returns its inverse."""
    return quat_from_angle_axis(-calc_heading(q), _upward(q))


def _upward(q: Tensor) -> Tensor:
    axis = torch.zeros_like(q[..., 0:3])
    axis[..., 2] = 1.0
    return axis


def compute_heading_and_up(
    torso_rotation: Tensor, inv_start_rot: Tensor, to_target: Tensor, vec0: Tensor, vec1: Tensor, up_idx: int
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Returns a torso's turn, how far it is up and heads to its target, and its up and forward axes."""
    turn = quat_mul(torso_rotation, inv_start_rot)
    up, ahead = quat_rotate(turn, vec1), quat_rotate(turn, vec0)
    return turn, up[..., up_idx], torch.sum(ahead * normalize(to_target), -1), up, ahead


def compute_rot(
    torso_quat: Tensor, velocity: Tensor, ang_velocity: Tensor, targets: Tensor, torso_positions: Tensor
) -> tuple[Tensor, ...]:
    """Returns both velocities in the torso's frame, roll, pitch, yaw, and the angle to the target.

    The last is the original's: that of the offset's x and z, less the yaw.
    """
    roll, pitch, yaw = get_euler_xyz(torso_quat)
    offset = targets - torso_positions
    bearing = torch.atan2(offset[..., 2], offset[..., 0])
    own = (quat_rotate_inverse(torso_quat, velocity), quat_rotate_inverse(torso_quat, ang_velocity))
    return (*own, roll, pitch, yaw, bearing - yaw)


HELPERS_IN_SCOPE: dict[str, Callable[..., Any]] = {
    **{name: held for name, held in globals().items() if inspect.isfunction(held) and not name.startswith("_")},
    "quat_unit": normalize,
    "quat_diff_rad": rot_dist,
    "tf_vector": quat_apply,
    "get_basis_vector": quat_rotate,
    "my_quat_rotate": quat_rotate,
    "scale_transform": unscale,
    "unscale_transform": scale,
    "saturate": tensor_clamp,
}
"""Functions in scope by name: all of this module, and further names of some."""
