"""Loosely typed Python, as models write it: it means here what it means there."""

import math
import textwrap

import numpy as np
import pytest
import torch

from code_cases import VARIABLES, compile_mapping, compile_reward, reward, traced, values
from porse.functions.contract import NUMPY_NAMES
from porse.functions.read.extract import extract
from porse.functions.verdict import CodeError

BOTH = pytest.mark.parametrize("portable", [False, True])
BODIES = {
    "weights": "w = {'a': 1, 'b': -0.5, 'c': 2 * 3, 'd': 1 / 3, 'e': math.pi}\nx = sum(w[k] * a[:, 0] for k in w)",
    "list of weights": "w = [1, 0.5]\nx = w[0] * a[:, 0] + w[1] * a[:, 1]",
    "matrix": "m = torch.tensor([[1, 0.5, 0], [0, 1, 0], [0, 0, 1]])\nx = (a @ m)[:, 1]",
    "called dictionary": "w = dict(near=1, far=0.5)\nx = w['near'] * a[:, 0] + w['far']",
    "one number or another": "w = 2 if a.shape[0] > 3 else 0.5\nx = w * a[:, 0]",
    "rows": "x = a[:, 0] * 0\nfor w, y in ((1, a), (0.5, b)):\n    x = x + w * y[:, 0]",
    "rows in a list": "x = 0\nfor name, w, y in [('a', 1, a[:, 0]), ('b', 0.5, b[:, 0])]:\n    x += w * y",
    "pairs": "c = {'a': a[:, 0], 'b': b[:, 0]}\nc = {k: 2 * v for k, v in c.items()}\nx = sum(v for _, v in c.items())",
    "two lists": "x = sum(w * y for w, y in zip([1, 0.5], [a[:, 0], b[:, 0]]))",
    "numbered": "x = sum([(i + 1) * y for i, y in enumerate([a[:, 0], b[:, 0]])])",
    "pairs in pairs": "x = 0.0\nfor i, (w, y) in enumerate(zip([1.0, 0.5], [a[:, 0], b[:, 0]])):\n    x = x + (i + 1) * w * y",
    "pairs of pairs": "x = sum(i * w * y for i, (w, y) in enumerate(zip([1.0, 0.5], [a[:, 0], b[:, 0]])))",
    "sum": "x = 0.0\nfor i in range(3):\n    x += a[:, i]",
    "sum from an integer": "x = 0\nfor i in range(3):\n    x = x + a[:, i]",
    "annotated sum": "x: float = 0.0\nn: int = 0\nfor i in range(3):\n    x = x + a[:, i]\n    n += 1\nx = x / n",
    "product": "x = 1.0\nfor i in range(3):\n    x *= torch.exp(a[:, i])",
    "two sums": "x, y = 0.0, 0\nfor i in range(3):\n    x += a[:, i]\n    y -= b[:, i]\nx = x * y",
    "one start for two": "x = y = 0.0\nfor i in range(3):\n    x = x + a[:, i]\n    y = y + b[:, i]\nx = x - y",
    "sum of weights": "x = 0.0\nt = 0\nfor w in [0.5, 0.25]:\n    t += w\n    x += w * a[:, 0]\nx = x / t",
    "truth values": "ok = True\nfor i in range(3):\n    ok = ok & (a[:, i] < 0.5)\nx = ok.float()",
    "set in a branch": "x = 0.0\nif a.shape[0] > 1:\n    x = a[:, 0]",
    "number in the other branch": "if a.shape[0] > 1:\n    x = a[:, 0]\nelse:\n    x = 0.0\nx = x + b[:, 0]",
    "integer that becomes a float": "k = 1\nif a.shape[0] > 1:\n    k = 0.5\nx = k * a[:, 0]",
    "integer that shrinks in a loop": "k = 1\nfor w in [0.5, 0.25]:\n    k = k * w\nx = k * a[:, 0]",
    "list of floats": "w = []\nfor i in range(3):\n    w.append(0.5 ** i)\nx = w[0] * a[:, 0] + w[2] * b[:, 0]",
    "list of rows": "rows = []\nrows.append((1.0, a[:, 0]))\nrows.append((0.5, b[:, 0]))\nx = sum(w * y for w, y in rows)",
    "list of lists": "rows = []\nrows.append([a[:, 0], b[:, 0]])\nx = rows[0][1]",
    "list of names": "names = []\nnames += ['a']\nnames = names + ['b']\nx = a[:, 0] * len(names)",
    "dictionary of floats": "w = {}\nw['a'] = 0.5\nw.update({'b': 0.25})\nx = w['a'] * a[:, 0] + w['b'] * b[:, 0]",
    "lists added": "y = [a[:, 0]] + [b[:, 0]]\ny += [a[:, 1]]\nx = torch.stack(y).sum(0)",
    "list multiplied": "n = 2\nw = [0.5] * n + [1.0] * 1\nx = a[:, 0] * (w[0] + w[2]) * len(w)",
    "dictionaries merged": "c = {'a': a[:, 0]}\nd = {**c, 'b': b[:, 0], **{'a': a[:, 1]}}\nc['a'] = b[:, 2]\nx = d['a'] + d['b']",
    "copy of a dictionary": "c = {'a': a[:, 0]}\nd = {**c}\nd['a'] = b[:, 0]\nx = c['a'] + 2 * d['a']",
    "condition in a comprehension": "c = {'a': a[:, 0], 'b': b[:, 0], 'c': a[:, 1]}\nx = sum(v for k, v in c.items() if k != 'b')",
    "conditions": "x = sum([a[:, i] * i for i in range(9) if i % 2 if i < 3 or i == 1])",
    "condition in a dictionary": "c = {'a': a[:, 0], 'b': b[:, 0]}\nd = {k: 2 * v for k, v in c.items() if k == 'b'}\nx = d['b'] + len(d)",
    "two loops in a comprehension": "x = sum(w * y[:, i] for w, y in [(1, a), (0.5, b)] for i in range(3))",
    "comprehension in a comprehension": "x = sum(sum(y[:, i] for i in range(3)) for y in [a, b] if y.shape[1] == 3)",
    "names of a comprehension are its own": "k = 2.0\ny = [k for k in range(5) if k > 2]\nx = a[:, 0] * k * len(y)",
    "condition in a branch and a loop": "x = a[:, 0]\nfor y in [v for v in [a, b] if v.shape[0] > 1]:\n    if len([i for i in range(3) if i > 0]) == 2:\n        x = x + y[:, 1]",
    "tuples side by side": "x = 0\nfor w, y in zip((1, 0.5), (a[:, 0], b[:, 0])):\n    x = x + w * y",
    "tuple with numbers": "x = 0\nfor i, y in enumerate((a[:, 0], b[:, 0])):\n    x = x + i * y",
    "named tuples side by side": "names, w = ('a', 'b'), (1, 0.5)\nys = (a[:, 0], b[:, 0])\nx = 0\nfor n, y in zip(names, ys):\n    x = x + y * len(n)\nfor y in ys:\n    x = x + y",
    "named rows": "rows = ((1, a), (0.5, b))\nx = 0\nfor w, y in rows:\n    x = x + w * y[:, 0]",
    "a tuple that is taken apart": "pair = (a[:, 0], b[:, 0])\np, q = pair\nx = p - q",
    "columns of rows": "rows = [(a[:, 0], 'p'), (b[:, 0], 'qq')]\nys, names = zip(*rows)\nx = ys[0] * len(names[1]) + ys[1]",
    "columns as lists": "rows = [(a[:, 0], 2), (b[:, 0], 3)]\nys, ws = map(list, zip(*rows))\nx = ys[0] * ws[1] + ys[1]",
    "parts of a call": "parts = (a[:, 0], b[:, 0])\nx = torch.maximum(*parts) + torch.minimum(*[a[:, 1], b[:, 1]]) + torch.zeros(*a.shape).sum(-1)",
    "a list of texts that is filled": "names = ['a']\nnames.append('bb')\nx = 0\nfor n in names:\n    x = x + len(n) * a[:, 0]",
    "a list that is changed": "w = [1.0, 2.0]\nw[0] = 3.0\nx = torch.maximum(*[a[:, 0], b[:, 0]]) * w[0]",
    "parts of a list that is filled": "parts = []\nparts.append(a[:, 0])\nparts.append(b[:, 0])\nx = torch.maximum(*parts)",
    "sorted dictionary": "w = {'b': a[:, 0], 'a': b[:, 0]}\nx = 0\nfor i, k in enumerate(sorted(w)):\n    x = x + i * w[k]",
    "another name for a function": "norm = torch.norm\ndef h(y):\n    return 2 * y\ntwice = h\nx = twice(norm(a - b, dim=-1))",
    "inner function that fills a dictionary": "c = {}\ndef add(name, y):\n    c[name] = 2 * y\nadd('a', a[:, 0])\nadd('b', b[:, 0])\nx = c['a'] - c['b']",
    "inner function that fills lists": "ys, names, ups, ws = [], [], [], []\ndef add(y, name, up=False, w=1.0):\n    ys.append(y)\n    names.append(name)\n    ups.append(up)\n    ws.append(w)\nadd(a[:, 0], 'a', up=True)\nadd(b[:, 0], 'bb', w=0.5)\nx = ys[0] * len(names[1]) - ys[1] * ws[1] if ups[0] else b[:, 1]",
    "helper that is given a dictionary": "def total(terms, weights):\n    return sum(weights[k] * v for k, v in terms.items())\nx = total({'a': a[:, 0], 'b': b[:, 0]}, {'a': 1, 'b': 0.5})",
    "numbers by name and formula": "def soft(y, t):\n    return torch.exp(-y / t)\nt = 0.5\nhalf = t / 2\nx = soft(a[:, 0], half) + soft(a[:, 1], 2 * t) + soft(a[:, 2], math.pi)",
    "bounds as a pair": "def inside(y, bounds=(0.0, 1.0), margin: float = 0):\n    low, high = bounds\n    if low > high:\n        raise ValueError(f'wrong {bounds}')\n    return ((y > low) & (y < high)).float() + margin\nx = inside(a[:, 0]) + inside(a[:, 1], (0, 0.5), margin=1)",
    "new tensor": "up = a.new_tensor([0, 0, 1])\nx = (a * up).sum(-1)",
    "distances between many points": "x = torch.cdist(a, b)[:, 3] + torch.cdist(a.repeat(9, 1), b).sum(-1)[:a.shape[0]] + torch.cdist(a, b, p=2)[:, 0]",
    "distances between points": "x = torch.cdist(a.unsqueeze(1), torch.stack([a, b], dim=1)).squeeze(1).sum(-1) + torch.cdist(a[None], b[None], p=1.0)[0, :, 0]",
    "texts": "x = 0\nfor leg in ['LF', 'RF']:\n    if leg.lower().startswith('l'):\n        x = x + a[:, 0]\nx = x * len('a_b'.replace('_', '').upper())",
    "builtins": "w = {'b': 0.5, 'a': 1.0}\nok = all([True, 1 < 2]) and not any([False])\nx = pow(a[:, 0], 2) * pow(2, 3)\nfor k in sorted(w.keys()):\n    x = x * 2 + w[k]\nx = x if ok else b[:, 0]",
    "a number for good before a list of names": "k = 0.0\nk = math.sqrt(2.0)\nn = []\nn.append('a')\nx = a[:, 0] * len(n) * k",
    "bare types": "y: list = []\nn: dict = {'n': 1}\ny.append(a[:, 0])\nx = y[0] * n['n']",
    "helper with an integer default": "def soft(y, t=1):\n    return torch.exp(-y / t)\nt = 0.5\nx = soft(a[:, 0]) + soft(a[:, 1], t) + soft(a[:, 2], t=2)",
    "helper that wants a float": "def soft(y, t: float):\n    return torch.exp(-y / t)\nx = soft(a[:, 0], 1) + soft(a[:, 1], t=2)",
    "helper with an expression": "def soft(y, t=1.0):\n    return torch.exp(-y / t)\nt = 0.5\nx = soft(a[:, 0], 2 * t) + soft(a[:, 1], 2)",
    "numbers of numpy": "k = 1\nk = np.sqrt(0.5) * np.cos(np.deg2rad(30.0)) - np.abs(-1)\nx = k * a[:, 0] + np.arctan2(1.0, 2)",
    "helper that sums": "def summed(y):\n    s = 0\n    for i in range(3):\n        s += y[:, i]\n    return s\nx = summed(a) - summed(b)",
    "helper that takes lists": "def weighted(ys: list, ws):\n    return ys[0] * ws\nx = weighted([a[:, 0], b[:, 0]], 0.5)",
}  # fmt: skip


def in_python(source, arguments):
    """Returns the total reward of a source of this file, run by Python."""
    namespace = {"torch": torch, "math": math, "np": np}
    exec(source, namespace)
    return namespace["compute_reward"](*arguments)[0]


@BOTH
@pytest.mark.parametrize("name", BODIES)
def test_types_change_as_in_python(name, portable):
    states, source = values(5), reward(BODIES[name])
    total, _ = compile_reward(source, VARIABLES, portable)(states)
    torch.testing.assert_close(total, in_python(source, (states["a"], states["b"])), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("name", sorted(NUMPY_NAMES))
def test_what_is_offered_of_numpy_is_numpys(name):
    found = getattr(np, name)
    text, expected = f"np.{name}", found
    if callable(found):
        given = (0.5, 2.0)[: found.nin]
        text, expected = f"{text}({', '.join(map(str, given))})", found(*given)
    total, _ = compile_reward(reward(f"x = 0 * a[:, 0] + {text}"), VARIABLES, False)(values(1))
    assert total.item() == pytest.approx(expected, nan_ok=True)


def test_functions_of_numpy_take_tensors_where_those_of_torch_do():
    source = reward("x = np.exp(-np.abs(a[:, 0]) / np.sqrt(0.25))", result='x, {"x": np.sqrt(x), "n": np.sqrt(4)}')
    total, components = compile_reward(source, VARIABLES, False)(states := values(3))
    torch.testing.assert_close(total, torch.exp(-2.0 * states["a"][:, 0].abs()))
    torch.testing.assert_close(components["x"], total.sqrt())
    assert components["n"].tolist() == [2.0] * 3


@BOTH
def test_lists_that_begin_empty_hold_what_they_are_given(portable):
    source = (
        "def mapping_function(self):\n"
        "    progress, rises, names = [], [], []\n"
        "    for i in range(2):\n"
        "        progress.append(self.a[:, i])\n"
        "        rises.append(i == 0)\n"
        "        names.append(f'a_{i}')\n"
        "    return progress, rises, names\n"
    )
    function, states = compile_mapping(source, VARIABLES, portable), values(3)
    progress, rises, names = function(states)
    assert [value.tolist() for value in progress] == states["a"].T[:2].tolist()
    assert (rises, names) == ([True, False], ["a_0", "a_1"])


@BOTH
def test_numbers_among_the_components_stand_for_every_environment(portable):
    body = "w = 2.0\nc = {'x': a[:, 0], 'w': w}\nc['half'] = w / 2"
    _, components = compile_reward(reward(body, result="a[:, 0], c"), VARIABLES, portable)(values(3))
    assert {name: value.tolist() for name, value in components.items() if name != "x"} == {
        "w": [2.0] * 3,
        "half": [1.0] * 3,
    }
    _, components = compile_reward(reward("pass", result="a[:, 0], {'one': 1}"), VARIABLES, portable)(values(3))
    assert components["one"].tolist() == [1.0] * 3


def test_helpers_share_self_and_other_names_for_its_functions():
    source = (
        "def height(self):\n    return self.a[:, 2]\n"
        "def mapping_function(self):\n"
        "    d = self.dist\n"
        "    return [height(self), d(self.a, self.b)], [True, False], ['height', 'distance']\n"
    )
    states = values(3)
    progress, _, _ = compile_mapping(source, VARIABLES, False)(states)
    assert torch.equal(progress[0], states["a"][:, 2])
    torch.testing.assert_close(progress[1], torch.norm(states["a"] - states["b"], dim=-1))


def test_variables_may_be_read_by_names_that_are_written_out():
    source = (
        "SIDES = ('a', 'b')\n"
        "def mapping_function(self):\n"
        "    x = torch.zeros(self.num_envs)\n"
        "    for side in SIDES:\n"
        "        x = x + getattr(self, side)[:, 0]\n"
        "    names = [f'{side}_1' for side in SIDES]\n"
        "    y = torch.stack([getattr(self, f'{side}')[:, 1] for side in ('a', 'b')]).sum(0)\n"
        "    return [x, y, getattr(self, 'ste' + 'ps')], [True] * 3, names + ['steps']\n"
    )
    states = values(3)
    (x, y, steps), _, names = compile_mapping(source, VARIABLES, False)(states)
    torch.testing.assert_close(x, states["a"][:, 0] + states["b"][:, 0])
    torch.testing.assert_close(y, states["a"][:, 1] + states["b"][:, 1])
    assert (steps.tolist(), names) == ([0.0, 1.0, 2.0], ["a_1", "b_1", "steps"])


@pytest.mark.parametrize(
    "text",
    ["getattr(self, self.name)", "getattr(torch, 'save')", "getattr(self, '__class__')", "getattr(self, 'a', 0)"],
)
def test_no_other_attribute_is_read_by_its_name(text):
    with pytest.raises(CodeError, match=r"getattr|__class__|name|torch|3 were given"):
        traced(f"def mapping_function(self):\n    return [{text}], [True], ['x']\n", "mapping", VARIABLES)


@pytest.mark.parametrize("made", ["W = Weights()", "W = Weights"])
@pytest.mark.parametrize("inside", [True, False])
def test_what_is_made_of_a_class_stands_for_its_constants_and_functions(made, inside):
    head = "@dataclass\nclass Weights:\n    near: float = 2.0\n    def __init__(self):\n        self.far = 0.5\n\n"
    head += "    @staticmethod\n    def twice(y):\n        return 2 * y\n\n"
    body = "near = a[:, 0]\nx = W.near * near + W.far * W.twice(b[:, 0])"
    reply = head + (reward(f"{made}\n{body}") if inside else f"{made}\n\n{reward(body)}")
    states = values(3)
    total, _ = compile_reward(extract(reply, "reward").text, VARIABLES, False)(states)
    torch.testing.assert_close(total, 2.0 * states["a"][:, 0] + states["b"][:, 0])


CLASS = """
class Reward(torch.nn.Module):
    def __init__(self, far: float = 0.5, *, near=2):
        super().__init__()
        self.far = far  # along b
        self.weights = {
            "near": near + far,
        }

    def reach(self, y):
        return self.weights["near"] * y[:, 0]

"""


@pytest.mark.parametrize("is_method", [True, False])
def test_a_class_is_made_with_the_defaults_of_its_arguments(is_method):
    owner = "self" if is_method else "r"
    body = f"reach = {owner}.reach(a)\nx = reach + {owner}.far * b[:, 0]"
    source = reward(body if is_method else f"r = Reward()\n{body}", arguments="self, a, b" if is_method else "a, b")
    reply = CLASS + (textwrap.indent(source, "    ") if is_method else source)
    states = values(3)
    total, _ = compile_reward(extract(reply, "reward").text, VARIABLES, False)(states)
    torch.testing.assert_close(total, 2.5 * states["a"][:, 0] + 0.5 * states["b"][:, 0])


def test_a_class_may_make_something_else_of_an_argument_under_its_name():
    reply = "class Reward:\n    def __init__(self, t=2, u=[3, 5]):\n        self.u = u[1]\n        self.t = float(t) / 4\n\n"
    reply += reward("r = Reward()\nx = a[:, 0] * r.t + r.u")
    states = values(3)
    total, _ = compile_reward(extract(reply, "reward").text, VARIABLES, False)(states)
    torch.testing.assert_close(total, 0.5 * states["a"][:, 0] + 5.0)


def test_a_helper_may_call_itself_until_it_ends_and_defaults_are_computed():
    source = "def folded(y, n=2 + len('p')):\n    return y if n == 0 else folded(2 * y, n - 1)\n\n" + reward(
        "x = folded(a[:, 0])"
    )
    states = values(3)
    total, _ = compile_reward(source, VARIABLES, False)(states)
    assert torch.equal(total, 8.0 * states["a"][:, 0])


def test_what_a_class_is_to_be_given_has_no_value():
    reply = "far = 3.0\nclass Reward:\n    def __init__(self, far):\n        self.far = far\n\n"
    reply += textwrap.indent(reward("x = self.far * a[:, 0]", arguments="self, a"), "    ")
    with pytest.raises(CodeError, match="None"):
        traced(extract(reply, "reward").text, "reward", VARIABLES)


def test_a_class_does_not_hide_what_every_task_has():
    reply = (
        "class Reward:\n    def __init__(self):\n        self.device = 'cuda:0'\n        self.t = 2.0\n\n"
        "    def compute_reward(self, a):\n        x = a[:, 0] * self.t + torch.zeros(1, device=self.device)\n"
        "        return x, {'x': x}\n"
    )
    states = values(3)
    total, _ = compile_reward(extract(reply, "reward").text, VARIABLES, False)(states)
    assert torch.equal(total, 2.0 * states["a"][:, 0])


def test_constants_may_be_computed_from_each_other_and_stand_in_a_class():
    source = "HALF = math.pi / 2\nANGLE = math.radians(90.0) + 0 * HALF\nNAMES = ('p', 'qq')\nclass_like = [HALF, 1]\n"
    source += "Kp = 0.5\nGain = Kp\n"
    source += reward("Kd = Gain\nx = a[:, 0] * ANGLE / Config.HALF * len(NAMES[1]) * class_like[1] * Kd / Kp")
    states = values(4)
    total, _ = compile_reward(source, VARIABLES, False)(states)
    torch.testing.assert_close(total, 2.0 * states["a"][:, 0])


def test_constants_beside_the_function_may_be_dictionaries_and_tensors():
    source = "W = {'near': 1, 'far': 0.5}\nUP = torch.tensor([0, 0, 2], dtype=torch.float32)\nS = 2 ** 0.5\n"
    states = values(4)
    total, _ = compile_reward(source + reward("x = W['near'] * (a * UP).sum(-1) * S"), VARIABLES, False)(states)
    torch.testing.assert_close(total, 2.0 * states["a"][:, 2] * math.sqrt(2.0))


@pytest.mark.parametrize(
    ("constant", "says"),
    [
        ("W = torch.load('x')", "the name load is not allowed"),
        ("W = torch.tensor(open('x'))", "the name open is not allowed"),
        ("W = torch.tensor([1.0], out=torch.ones(1))", "the keyword out is not allowed"),
        ("W = {'a': open('x')}", "the name open is not allowed"),
        ("W = [i for i in range(3)]", "the name W is not defined and not allowed"),
        ("W = 'cuda:0'", "the device 'cuda:0' is written into the code"),
        ("W = [1, 10000001]", "larger than 10000000"),
    ],
)
def test_constants_are_computed_from_numbers_alone(constant, says):
    with pytest.raises(CodeError, match=says):
        traced(f"{constant}\n" + reward("x = a[:, 0] * W"), "reward", VARIABLES)


@pytest.mark.parametrize(
    "body",
    [
        "x = a[:, 0] * (0 or 2) + (3 and 4)",
        "x = a[:, 0] * (1 == 1.0) + [[], 7][1]",
        "k: float = 1.0\nk = max(k, 2.0)\nx = a[:, 0] * k",
        "w = {'a': 1, 'b': 2}\nx = a[:, w['b']]",
        "k = 1\nk += 1\nx = a[:, k]",
    ],
)
def test_numbers_that_stay_numbers_stay_what_they_are(body):
    states, source = values(5), reward(body)
    total, _ = compile_reward(source, VARIABLES, False)(states)
    torch.testing.assert_close(total, in_python(source, (states["a"], states["b"])))
