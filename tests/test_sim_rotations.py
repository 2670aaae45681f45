"""The rotation arithmetic against numbers that a pencil finds, and against torch where torch is accurate."""

import math

import torch

from porse.sim import rotations

HALF = math.sqrt(0.5)
QUARTER_Z = torch.tensor([0.0, 0.0, HALF, HALF])
QUARTER_X = torch.tensor([HALF, 0.0, 0.0, HALF])


def random_rotations(n: int) -> torch.Tensor:
    """Returns n random unit quaternions."""
    q = torch.randn(n, 4, generator=torch.Generator().manual_seed(3))
    return q / torch.norm(q, dim=-1, keepdim=True)


def test_a_quarter_turn_about_z_takes_x_to_y() -> None:
    """x -> y -> -x -> -y."""
    assert torch.allclose(
        rotations.rotate(QUARTER_Z, torch.tensor([1.0, 0.0, 0.0])), torch.tensor([0.0, 1.0, 0.0]), atol=1e-6
    )
    assert torch.allclose(
        rotations.rotate_inverse(QUARTER_Z, torch.tensor([0.0, 1.0, 0.0])), torch.tensor([1.0, 0.0, 0.0]), atol=1e-6
    )


def test_a_product_applies_its_right_factor_first() -> None:
    """y under the quarter turn about x becomes z, which the quarter turn about z keeps."""
    both = rotations.multiply(QUARTER_Z, QUARTER_X)
    assert torch.allclose(
        rotations.rotate(both, torch.tensor([0.0, 1.0, 0.0])), torch.tensor([0.0, 0.0, 1.0]), atol=1e-6
    )


def test_the_distance_of_a_turn_is_its_angle() -> None:
    """From no turn to a full half turn; both signs of a quaternion are one rotation."""
    for angle in (0.0, 0.1, 1.0, math.pi / 2, 3.0, math.pi):
        turned = rotations.about_axis(1, torch.tensor([angle]))
        distance = rotations.rotation_distance(turned, torch.tensor([[0.0, 0.0, 0.0, 1.0]]))
        assert abs(float(distance) - angle) < 1e-3 if angle > 3.1 else abs(float(distance) - angle) < 1e-5
    q = random_rotations(50)
    assert float(rotations.rotation_distance(q, -q).max()) < 1e-5


def test_asin_and_cos_match_torch_in_double() -> None:
    """Within 3e-7 of the double-precision value, on a grid that includes both ends."""
    x = torch.linspace(0, 1, 10001)
    assert float((rotations.asin(x).double() - torch.asin(x.double())).abs().max()) < 3e-7
    angle = torch.linspace(-7, 7, 1001)
    assert float((rotations.cos(angle).double() - torch.cos(angle.double())).abs().max()) < 1e-6


def test_sqrt_is_correctly_rounded() -> None:
    """The double-precision root, rounded once."""
    x = torch.rand(10000, generator=torch.Generator().manual_seed(0)) * 100
    assert torch.equal(rotations.sqrt(x), x.double().sqrt().float())


def test_euler_angles_rebuild_the_rotation() -> None:
    """Rz(yaw) Ry(pitch) Rx(roll) is the rotation again, and every angle lies in [0, 2 pi)."""
    q = random_rotations(200)
    angles = rotations.euler_xyz(q)
    assert float(angles.min()) >= 0.0
    assert float(angles.max()) < 2 * math.pi
    roll, pitch, yaw = (rotations.about_axis(axis, angles[:, axis]) for axis in range(3))
    rebuilt = rotations.multiply(rotations.multiply(yaw, pitch), roll)
    assert float(rotations.rotation_distance(rebuilt, q).max()) < 2e-3


def test_tilted_up_is_the_cosine_of_the_tilt() -> None:
    """Upright 1, on the side 0, upside down -1."""
    tilts = rotations.about_axis(0, torch.tensor([0.0, math.pi / 2, math.pi]))
    assert torch.allclose(rotations.tilted_up(tilts), torch.tensor([1.0, 0.0, -1.0]), atol=1e-6)
