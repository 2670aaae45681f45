"""The static check: what it refuses, with which reason and on which line; and what a function reads."""

import pytest

from code_cases import VARIABLES, reward
from porse.functions.read.check import check_source
from porse.functions.read.extract import extract
from porse.functions.verdict import CodeError

TABLE = {variable.name: variable for variable in VARIABLES}


def check(source, kind="reward"):
    check_source(extract(source, kind), TABLE)


@pytest.mark.parametrize(
    ("line", "kind", "says"),
    [
        ("y = torch.svd(a)", "static", "torch.svd"),
        ("y = a.numpy()", "static", ".numpy"),
        ("y = torch.nn.Linear(3, 3)", "static", "torch.nn.Linear"),
        ("y = aa", "variable", "the nearest known names are a"),
        ("y = self.a", "static", "self"),
        ("y = 10000001", "static", "larger than 10000000"),
        ("y = 1j", "static", "complex"),
        ("y = b'x'", "static", "bytes"),
        ("y = x.to('cuda')", "device", "'cuda'"),
        ("y = torch.zeros(3, device='cpu')", "device", "'cpu'"),
        ("y = x.cuda()", "device", ".cuda()"),
        ("y = torch.zeros(3, pin_memory=True)", "static", "pin_memory"),
        ("y = torch.manual_seed(3)", "static", "torch.manual_seed"),
        ("y = torch.normal(a, b)", "static", "torch.normal"),
        ("y = torch", "static", "stands alone"),
        ("y = lambda v=open: v", "variable", "open"),
        ("raise SystemExit('x')", "static", "raise"),
        ("global y", "static", "global"),
        ("yield x", "static", "Yield"),
        ("y = x._base", "static", "._base"),
        ("for i in range(2000):\n    x = x + i", "static", "1000 rounds"),
        ("if x:\n    pass\nelse:\n    while True:\n        pass", "static", "while"),
        ("match x:\n    case 1:\n        pass", "static", "Match"),
        ("nonlocal_ = 1\nclass C:\n    pass", "static", "classes"),
        ("import os", "static", "os"),
        ("from . import x", "static", "."),
    ],
)
def test_what_is_not_on_the_list_is_refused_with_its_reason(line, kind, says):
    with pytest.raises(CodeError, match=says.replace("(", r"\(").replace(")", r"\)").replace(".", r"\.")) as error:
        check(reward("x = a[:, 0]", line))
    assert error.value.check == kind
    assert error.value.line >= 3


def test_an_unknown_argument_names_the_nearest_variables():
    with pytest.raises(CodeError, match="found bodie, which it does not offer; the nearest are bodies") as error:
        check("def compute_reward(bodie):\n    return bodie, {}\n")
    assert (error.value.check, error.value.line) == ("variable", 1)


def test_an_unknown_name_without_neighbours_lists_what_there_is():
    with pytest.raises(CodeError, match="it offers a, b, bodies, device"):
        check("def mapping_function(self):\n    return self.wwwwwwww\n", "mapping")


@pytest.mark.parametrize(
    "lines",
    [
        "for i in range(5):\n    if i == 3:\n        break\n    if i == 1:\n        continue\n    x = x + i",
        "y = sorted([3, 1], key=lambda v: -v)[0]",
        "x = x + (y := 2.0) * y",
        "print(f'{y:.3f} {x}' for y in [1.0])\nassert x.shape[0] == 16, f'{x!r:>20}'",
        "n = 0\ndef add():\n    nonlocal n\n    n += 1\nadd()",
        "def h(*parts, scale=1.0, **more):\n    return sum(parts) * scale\nx = h(x, x, scale=0.5)",
    ],
)
def test_pythons_own_ways_are_let_through(lines):
    check(reward("x = a[:, 0]", lines))


@pytest.mark.parametrize(
    "beside",
    [
        "print('x')",
        "@torch.jit.script",
        "class C:\n    pass",
        "x = a.mean()",
        "import torch",
        "k = 1.0",
        "num_envs = 4",
    ],
)
def test_a_source_holds_functions_and_what_they_read_alone(beside):
    function = reward("x = a[:, 0]")
    assert extract(f"{beside}\n{function}", "reward").text == function
