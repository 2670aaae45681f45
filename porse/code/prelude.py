"""TorchScript source of the helpers that generated code may call without defining them.

`dist` and `rot_dist` are in the contract. The quaternion helpers (xyzw) bear the names that functions written for the
original environments find in scope there; they are accepted, and no prompt advertises them.
"""

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
    "merged": """\
def porse_merged(first: Dict[str, Tensor], more: Dict[str, Tensor]):
    both = first.copy()
    both.update(more)
    return both
""",
    "cdist": """\
def porse_cdist(a: Tensor, b: Tensor, p: float = 2.0):
    if p == 2.0 and (a.size(-2) > 25 or b.size(-2) > 25):
        s = torch.sum((a * a), -1, True)
        t = torch.sum((b * b), -1, True)
        x = torch.cat([a * (-2.0), s, torch.ones_like(s)], -1)
        y = torch.cat([b, torch.ones_like(t), t], -1)
        return torch.sqrt(torch.clamp_min(torch.matmul(x, torch.transpose(y, -2, -1)), 0.0))
    return porse_cdist_kernel(a, b, p, 2)
""",
    "functional_normalize": """\
def porse_functional_normalize(x: Tensor, p: float = 2.0, dim: int = 1, eps: float = 1e-12):
    return x / torch.clamp_min(torch.linalg.vector_norm(x, p, [dim], True), eps).expand_as(x)
""",
    "quat_conjugate": """\
def porse_quat_conjugate(a: Tensor):
    return torch.cat([(-a[..., 0:3]), a[..., 3:4]], -1)
""",
    "quat_mul": """\
def porse_quat_mul(a: Tensor, b: Tensor):
    u = a[..., 0:3]
    v = b[..., 0:3]
    s = a[..., 3:4]
    t = b[..., 3:4]
    return torch.cat([((s * v) + (t * u)) + torch.linalg.cross(u, v, dim=-1), (s * t) - torch.sum((u * v), -1, True)], -1)
""",
    "quat_rotate": """\
def porse_quat_rotate(q: Tensor, v: Tensor):
    t = 2.0 * torch.linalg.cross(q[..., 0:3], v, dim=-1)
    return (v + (q[..., 3:4] * t)) + torch.linalg.cross(q[..., 0:3], t, dim=-1)
""",
    "quat_apply": """\
def porse_quat_apply(q: Tensor, v: Tensor):
    t = 2.0 * torch.linalg.cross(q[..., 0:3], v, dim=-1)
    return (v + (q[..., 3:4] * t)) + torch.linalg.cross(q[..., 0:3], t, dim=-1)
""",
    "quat_rotate_inverse": """\
def porse_quat_rotate_inverse(q: Tensor, v: Tensor):
    t = 2.0 * torch.linalg.cross(q[..., 0:3], v, dim=-1)
    return (v - (q[..., 3:4] * t)) + torch.linalg.cross(q[..., 0:3], t, dim=-1)
""",
    "normalize": """\
def porse_normalize(x: Tensor, eps: float = 1e-09):
    return x / torch.clamp(torch.linalg.vector_norm(x, 2, [-1], True), min=eps)
""",
    "tensor_clamp": """\
def porse_tensor_clamp(t: Tensor, low: Tensor, high: Tensor):
    return torch.maximum(torch.minimum(t, high), low)
""",
}
"""`rot_dist` is the angle of q1 * conjugate(q2). `sum` adds the tensors of a list, `merged` is `{**a, **b}`, `cdist` is torch.cdist as
torch computes it, with the square root where portable forms reach it; 2 asks for the kernel that subtracts. And
`functional_normalize` is torch.nn.functional.normalize, which takes longer to compile from its own source."""
