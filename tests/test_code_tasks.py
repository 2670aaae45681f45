"""Sound functions over every task: what uses only offered variables and ordinary torch operations is accepted."""

from itertools import cycle

import pytest

from code_cases import values
from porse.functions.read.confine import Limits
from porse.functions.read.sandbox import Sandbox
from porse.functions.read.states import packed
from porse.tasks import TASKS

REWARDS = [
    "d = torch.norm({p} - {q}, dim=-1)\nx = torch.exp(-d / 0.3)",
    "d = torch.norm({p} - {q}, p=2, dim=-1)\nx = 1.0 / (1.0 + d ** 2)\nx *= x\nx = torch.where(d < 0.1, x * 2, x)",
    "x = -torch.sum(torch.square({p} - {q}), dim=-1)\nx = torch.clamp(x, min=-10.0, max=0.0)",
    "d = torch.linalg.norm({p} - {q}, dim=1)\nx = torch.zeros_like(d)\nx[d < 1.0] = 1.0\nx = x - 0.1 * d",
    "e = torch.abs({p} - {q})\nx = torch.exp(-e.max(dim=-1)[0]) + torch.exp(-e.mean(dim=-1))",
    "c = F.cosine_similarity({p}, {q} + 0.1, dim=-1)\nx = torch.tanh(c) + torch.sigmoid({p}[:, 2])",
    "u = F.normalize({p} - {q} + 1e-6, dim=-1)\nx = torch.sum(u * {p}, dim=-1).clamp(-1.0, 1.0)\nx = torch.acos(x * 0.99)",
    "both = torch.stack([{p}, {q}], dim=1)\nx = torch.norm(both[:, 0] - both[:, 1], dim=-1).neg()",
    "x = torch.bmm({p}.unsqueeze(1), {q}.unsqueeze(2)).squeeze(-1).squeeze(-1)",
    "x = torch.einsum('ij,ij->i', {p}, {q})\nx = torch.where(torch.logical_and(x > 0, x < 9), x, -x)",
    "x = torch.zeros({p}.shape[0], device={p}.device)\nfor v in [{p}, {q}]:\n    x = x + torch.norm(v, dim=-1)\nx = -x / 2",
    "x = torch.cat([{p}, {q}], dim=-1).pow(2).mean(dim=-1)\nx = torch.log(1.0 + x) + torch.sqrt(x + 1e-6)",
    "a: float = 2.0\nb = 3\nx = a * {p}[:, 0] ** b + torch.cos({q}[:, 1]) * torch.sin({p}[:, 1])",
    "near = ({p} - {q}).norm(dim=-1, keepdim=True) < 0.5\nx = near.float().squeeze(-1) + {p}[:, 0]",
    "x = torch.min({p}[:, 0], {q}[:, 0]) + torch.maximum({p}[:, 1], {q}[:, 1])\nx = x.masked_fill(x > 5.0, 5.0)",
    "def squash(v, t):\n    return torch.exp(-v / t)\nx = squash(torch.norm({p}, dim=-1), 0.5) + squash(torch.norm({q}, dim=-1), 2.0)",
    "w = [0.5, 0.3, 0.2]\nx = {p}[:, 0] * 0\nfor i in range(3):\n    x = x + w[i] * torch.abs({p}[:, i] - {q}[:, i])",
    "m = {p}.shape[-1]\nif m > 3:\n    x = {p}[:, 3]\nelse:\n    x = {q}[:, 0]\nx = x + 1.0",
    "k = torch.cross({p}, {q}, dim=-1)\nx = F.softplus(k[:, 0]) - F.relu(k[:, 1]) + k[:, 2].abs()",
    "t = torch.tensor([0.0, 0.0, 1.0], device={p}.device)\nx = ({p} * t).sum(dim=-1) + torch.atan2({q}[:, 0], {q}[:, 1] + 2.0)",
    "x = 0.0\nfor i in range(3):\n    x += torch.exp(-torch.abs({p}[:, i] - {q}[:, i]))\nx /= 3",
    "w = {{'near': 1, 'high': 0.5}}\nc = {{'near': torch.exp(-torch.norm({p} - {q}, dim=-1)), 'high': {p}[:, 2]}}\nc = {{k: w[k] * v for k, v in c.items()}}\nx = sum(c.values())",
    "parts = []\nnames = []\nfor i, n in enumerate(['x', 'y', 'z']):\n    parts.append({p}[:, i] - {q}[:, i])\n    names.append(n)\nx = torch.stack(parts, dim=-1).abs().sum(dim=-1) * len(names)",
    "x = torch.zeros_like({p}[:, 0])\nfor w, v in ((1, {p}), (0.5, {q})):\n    x += w * torch.norm(v, dim=-1)",
    "def soft(d, t=1):\n    return torch.exp(-d / t)\nd = torch.norm({p} - {q}, dim=-1)\nx = soft(d) + soft(d, 0.1) + soft(d, t=2)",
    "c = {{'p': {p}.norm(dim=-1)}}\nc = {{**c, 'q': {q}.norm(dim=-1)}}\nx = sum(w * v for w, v in zip([1, 0.5], c.values()))",
    "x = -torch.norm({p} - {q}, dim=-1)\nbonus = 0\nif {p}.shape[1] == 3:\n    bonus = (x > -0.1).float() * 10\nx = x + bonus",
    "terms = [('p', {p}[:, 0], 2), ('q', {q}[:, 1], 0.5)]\nx = 0\nfor _, v, w in terms:\n    x = x + w * torch.tanh(v)",
]
MAPPINGS = [
    "[self.dist(self.{p}, self.{q})], [False], ['distance']",
    "[(self.dist(self.{p}, self.{q}) + self.{p}[:, 2]) / 2, self.obs_buf[:, -2]], [False, True], ['mean', 'seen']",
    "self.{p}[:, 0] - self.{q}[:, 1], True, 'side'",
    "(dist(self.{p}, self.{q}), torch.norm(self.{q}, dim=-1)), (False, True), ('reach', 'far')",
    "[self.{p}[:, i] for i in range(3)], [True] * 3, [f'axis_{{i}}' for i in range(3)]",
    "[v for _, v in [('a', self.{p}[:, 0]), ('b', self.{q}[:, 1])]], [True] + [False], ['a'] + ['b']",
]


def points(task):
    """Returns the names of the task's variables of shape (num_envs, 3)."""
    return [variable.name for variable in TASKS[task].VARIABLES if variable.kind == "tensor" and variable.shape == (3,)]


def functions(task, count):
    """Returns `count` rewards and a mapping for each four of them, on the task's own variables, in turn."""
    names = points(task)
    pairs = cycle((p, q) for i, p in enumerate(names) for q in names[i + 1 :])
    start = sorted(TASKS).index(task) * count
    for number in range(count):
        p, q = next(pairs)
        body = REWARDS[(start + number) % len(REWARDS)].format(p=p, q=q).replace("\n", "\n    ")
        yield f'def compute_reward({p}, {q}):\n    {body}\n    return x, {{"x": x}}\n', "reward"
        if number % 4 == 0:
            result = MAPPINGS[(start + number) // 4 % len(MAPPINGS)].format(p=p, q=q)
            yield f"def mapping_function(self):\n    return {result}\n", "mapping"


def refused(sandbox, folder, task, count):
    """Returns how many functions were judged, and those that were refused with their verdicts."""
    variables = TASKS[task].VARIABLES
    sandbox.prepare(packed(values(32, variables)))
    judged = [(source, sandbox.judge(source, kind)[0]) for source, kind in functions(task, count)]
    return len(judged), [(task, source, verdict) for source, verdict in judged if not verdict.passed]


@pytest.fixture(scope="module")
def sandbox():
    with Sandbox(Limits()) as running:
        yield running


def test_every_task_offers_points_to_write_about():
    assert {task for task in TASKS if len(points(task)) < 2} == set()


def test_sound_functions_are_accepted_over_all_tasks(sandbox, tmp_path):
    found = [refused(sandbox, tmp_path, task, 2) for task in TASKS]
    assert sum(count for count, _ in found) >= 3 * len(TASKS)
    assert [each for _, bad in found for each in bad] == []


@pytest.mark.slow
def test_all_sound_functions_are_accepted_over_all_tasks(sandbox, tmp_path):
    """Twenty-eight rewards and seven mappings for every task: at least 98 % must be accepted."""
    found = [refused(sandbox, tmp_path, task, len(REWARDS)) for task in TASKS]
    total, bad = sum(count for count, _ in found), [each for _, bad in found for each in bad]
    assert len(bad) <= 0.02 * total, bad
