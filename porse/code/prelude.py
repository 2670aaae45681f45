"""TorchScript source of the helpers that generated code may call without defining them."""

HELPER_SOURCES: dict[str, str] = {
    "dist": """\
def porse_dist(a: Tensor, b: Tensor):
    return torch.linalg.vector_norm((a - b), 2, [-1])
""",
    "rot_dist": """\
def porse_rot_dist(a: Tensor, b: Tensor):
    x = ((a[..., 0] * b[..., 3]) - (a[..., 3] * b[..., 0])) - ((a[..., 1] * b[..., 2]) - (a[..., 2] * b[..., 1]))
    y = ((a[..., 1] * b[..., 3]) - (a[..., 3] * b[..., 1])) - ((a[..., 2] * b[..., 0]) - (a[..., 0] * b[..., 2]))
    z = ((a[..., 2] * b[..., 3]) - (a[..., 3] * b[..., 2])) - ((a[..., 0] * b[..., 1]) - (a[..., 1] * b[..., 0]))
    return 2.0 * torch.asin(torch.clamp(torch.linalg.vector_norm(torch.stack([x, y, z], -1), 2, [-1]), max=1.0))
""",
    "sum": """\
def porse_sum(values: List[Tensor]):
    total = values[0]
    for i in range(1, len(values)):
        total = total + values[i]
    return total
""",
}
"""`rot_dist` is the angle of q1 * conjugate(q2), quaternions xyzw."""
