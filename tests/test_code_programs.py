"""Random programs: their operator lists give what Python gives, for other states and other numbers of environments."""

import math
import random

import pytest
import torch

from code_cases import VARIABLES, RewardFunction, traced, values
from porse.functions.verdict import CodeError, words

UNARY = sorted(
    words("""
    torch.abs torch.exp torch.tanh torch.sin torch.cos torch.sigmoid torch.sqrt torch.acos torch.asin torch.atan torch.tan
    torch.square torch.floor torch.sign torch.neg torch.relu torch.log10 torch.log1p torch.expm1 torch.erf
    torch.nan_to_num F.softplus F.elu F.silu F.gelu F.leaky_relu torch.round torch.zeros_like torch.ones_like torch.rsqrt
    """)
)
BINARY = [
    "+",
    "-",
    "*",
    "/",
    "torch.maximum",
    "torch.minimum",
    "torch.atan2",
    "torch.hypot",
    "torch.fmod",
    "torch.copysign",
]
NUMBERS = [
    "0.5",
    "2",
    "-1.5",
    "1e-3",
    "0",
    "math.pi",
    "1",
    "3.0",
    "-0.0",
    "1 / 3",
    "scale",
    "len('abc')",
    "w['k']",
    "1 / num_envs",
]
REDUCE = ["sum", "mean", "amax", "amin", "prod", "norm", "std", "logsumexp"]
SCAN = ["cumsum", "softmax"]


class Writer:
    """Draws the lines of a function; every vector has a row for each environment, every matrix three or four columns."""

    def __init__(self, seed):
        self.draw = random.Random(seed)
        self.vectors = ["a[:, 0]", "b[:, 2]", "q[:, 3]", "self_free"]
        self.matrices = ["a", "b", "a[:, [2, 0, 1]]", "bodies[:, 1, :3]"]
        self.lines = ["w = {'k': 0.25, 'n': 3}", "self_free = steps * 0.1"]
        self.count = 0

    def name(self):
        self.count += 1
        return f"v{self.count}"

    def vector(self, depth=2):
        pick = self.draw.random()
        if depth == 0 or pick < 0.2:
            return self.draw.choice(self.vectors)
        inner = self.vector(depth - 1)
        if pick < 0.4:
            return f"{self.draw.choice(UNARY)}({inner})"
        if pick < 0.6:
            return self.binary(inner, self.vector(depth - 1))
        if pick < 0.7:
            return self.binary(inner, self.draw.choice(NUMBERS))
        if pick < 0.8:
            return f"{self.matrix(depth - 1)}.{self.draw.choice(REDUCE)}(dim=-1)"
        if pick < 0.86:
            return f"torch.where({inner} > {self.draw.choice(NUMBERS)}, {self.vector(depth - 1)}, {self.draw.choice(NUMBERS)})"
        if pick < 0.9:
            return f"{inner}.clamp({self.draw.choice(['-0.5', '0'])}, {self.draw.choice(['0.5', '2'])})"
        if pick < 0.93:
            return f"({inner} ** {self.draw.choice(['2', '0.5', '3', '-1', '1.7'])})"
        if pick < 0.96:
            return f"torch.sqrt(torch.sum(({self.matrix(depth - 1)} - {self.matrix(0)}) ** 2, dim=-1))"
        return f"({inner} > {self.vector(depth - 1)}).{self.draw.choice(['float()', 'int()', 'to(torch.float32)'])}"

    def binary(self, left, right):
        sign = self.draw.choice(BINARY)
        if not sign.startswith("torch."):
            return f"({left} {sign} {right})"
        return f"{sign}({left} * 1.0, torch.zeros_like({left}).float() + {right})"

    def matrix(self, depth=1):
        pick = self.draw.random()
        if depth == 0 or pick < 0.4:
            return self.draw.choice(self.matrices)
        inner = self.matrix(depth - 1)
        if pick < 0.6:
            return f"{self.draw.choice(['torch.exp', 'torch.abs', 'torch.tanh'])}({inner})"
        if pick < 0.7:
            return f"({inner} {self.draw.choice('+-*')} {self.draw.choice([self.draw.choice(NUMBERS), 'torch.tensor([0.5, 1, -2.0])'])})"
        if pick < 0.8:
            return f"torch.stack([{', '.join(self.vector(depth - 1) for _ in range(3))}], dim=-1)"
        if pick < 0.9:
            return f"F.normalize({inner}, dim=-1)"
        return f"{inner}.{self.draw.choice(SCAN)}(dim=-1)"

    def statement(self):
        pick, name = self.draw.random(), self.name()
        vector = self.vector()
        if pick < 0.4:
            self.lines.append(f"{name} = {vector}")
        elif pick < 0.5:
            self.lines += [f"{name} = {vector} * 1.0", f"{name} {self.draw.choice('+-*')}= {self.vector(1)}"]
        elif pick < 0.58:
            self.lines += [
                f"{name} = {vector}.clone().float()",
                f"{name}[{self.vector(1)} > 0.1] = {self.draw.choice(['0.0', '1.5'])}",
            ]
        elif pick < 0.64:
            self.lines += [
                f"{name} = {vector}.clone().float()",
                f"{name}[{self.vector(1)} > 0.1] *= {self.draw.choice(['0.5', '2.0'])}",
            ]
        elif pick < 0.72:
            self.lines += [
                f"{name} = 0.0", "for i in range(5):", "    if i == 3:", "        break", "    if i == 1:", "        continue",
                f"    {name} = {name} + {vector} * i",
            ]  # fmt: skip
        elif pick < 0.8:
            self.lines.append(f"{name} = sum(y * k for k, y in enumerate([{vector}, {self.vector(1)}]) if k != 5)")
        elif pick < 0.88:
            self.lines += [
                f"def h{name}(y, k=2):",
                "    return torch.tanh(y) * k",
                f"{name} = h{name}({vector}) + h{name}({self.vector(1)}, k=0.5)",
            ]
        elif pick < 0.94:
            self.lines += [
                f"parts = {{'x': {vector}, f'y_{{1}}': {self.vector(1)}}}",
                f"{name} = parts['x'] - parts['y_1']",
            ]
        else:
            self.lines += [
                f"m{name} = {self.matrix()}.clone()",
                f"m{name}[:, 1] = {vector}.float()",
                f"{name} = m{name}.sum(dim=-1)",
            ]
        self.vectors.append(name)

    def source(self):
        for _ in range(self.draw.randint(2, 6)):
            self.statement()
        last = self.vectors[-1]
        body = "".join(f"    {line}\n" for line in self.lines)
        result = f"    return {last} + 0.5 * {self.vectors[-2]}, {{'x': {last}, 'y': {self.vectors[-2]}, 'mean': {last}.float().mean()}}\n"
        return f"def compute_reward(a, b, q, bodies, steps, scale, num_envs):\n{body}{result}"


def in_python(source, states):
    space = {"torch": torch, "math": math, "F": torch.nn.functional}
    exec(source, space)
    names = ("a", "b", "q", "bodies", "steps", "scale", "num_envs")
    given = [states[name].clone() if isinstance(states[name], torch.Tensor) else states[name] for name in names]
    total, components = space["compute_reward"](*given)
    return [value.to(torch.float32).expand(states["num_envs"]) for value in (total, *components.values())]


def differ(source):
    """Returns what is wrong with the lists of a random program, "" for nothing."""
    try:
        in_python(source, values(16))
    except (RuntimeError, TypeError):  # Python's torch does not take it, so nor may we
        with pytest.raises(CodeError):
            traced(source, "reward", VARIABLES)
        return ""
    text = traced(source, "reward", VARIABLES).text
    functions = [RewardFunction(text, portable) for portable in (False, True)]
    for rows, seed in ((16, 0), (7, 1), (130, 2)):
        states = values(rows, seed=seed)
        expected = in_python(source, states)
        with torch.inference_mode():
            results = [function(states) for function in functions]
        plain, portable = ([total, *components.values()] for total, components in results)
        for wanted, fast, same in zip(expected, plain, portable, strict=True):
            if not torch.equal(fast.nan_to_num(7.0, 8.0, 9.0), wanted.nan_to_num(7.0, 8.0, 9.0)):
                return f"{rows} rows, fast: {fast[:5]}, Python: {wanted[:5]}"
            double = wanted.double()
            off = (same.double() - double).abs() > 2e-4 * (1 + double.abs())
            if bool((off & wanted.isfinite() & same.isfinite()).sum() > rows // 8):
                return f"{rows} rows, portable: {same[:5]}, Python: {wanted[:5]}"
    return ""


def mismatches(seeds):
    found = {}
    for seed in seeds:
        source = Writer(seed).source()
        if wrong := differ(source):
            found[seed] = f"{source}\n{wrong}"
    return found


def test_random_programs_mean_what_they_mean_in_python():
    assert mismatches(range(40)) == {}


@pytest.mark.slow
def test_two_thousand_random_programs_mean_what_they_mean_in_python():
    assert mismatches(range(1000, 3000)) == {}
