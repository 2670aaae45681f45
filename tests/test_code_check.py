"""The static check: what it refuses, with which reason and on which line; and what a function reads."""

import pytest

from code_cases import VARIABLES, reward
from porse.functions.read.check import check_program
from porse.functions.read.source import parse
from porse.functions.verdict import CodeError

TABLE = {variable.name: variable for variable in VARIABLES}


def check(source):
    return check_program(parse(source), TABLE)


@pytest.mark.parametrize(
    ("line", "kind", "says"),
    [
        ("y = torch.svd(a)", "static", "torch.svd"),
        ("y = a.numpy()", "static", ".numpy"),
        ("y = torch.nn.Linear(3, 3)", "static", "torch.nn.Linear"),
        ("y = aa", "variable", "the nearest known names are a"),
        ("y = self.a", "static", "self"),
        ("y = range", "variable", "range"),
        ("y = 10000001", "static", "larger than 10000000"),
        ("y = 1j", "static", "complex"),
        ("y = b'x'", "static", "bytes"),
        ("y = x.to('cuda')", "device", "'cuda'"),
        ("y = torch.zeros(3, device='cpu')", "device", "'cpu'"),
        ("y = x.cuda()", "device", ".cuda()"),
        ("y = torch.zeros(3, pin_memory=True)", "static", "pin_memory"),
        ("y = torch.manual_seed(3)", "static", "torch.manual_seed"),
        ("y = torch.normal(a, b)", "static", "torch.normal"),
        ("y = (lambda v: v)(x)", "static", "only named functions"),
        ("y = [v for v in (lambda: 1)]", "static", "lambda"),
        ("for i in range(2000):\n    x = x + i", "static", "1000 rounds"),
        ("if x:\n    pass\nelse:\n    while True:\n        pass", "static", "while"),
        ("match x:\n    case 1:\n        pass", "static", "Match"),
        ("nonlocal_ = 1\nclass C:\n    pass", "static", "classes"),
        ("y = a[()]", "static", "empty index"),
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
        check("def mapping_function(self):\n    return self.wwwwwwww\n")


def test_reads_are_what_is_not_declared():
    source = (
        "T = 0.5\n"
        "def near(self, p):\n    return self.dist(p, self.b) / T\n"
        "def compute_reward(self, q):\n    x = self.near(self.a) + steps + q[:, 0]\n    return x, {'x': x}\n"
    )
    reads = check(source)
    assert reads["near"].variables == {"b"}
    assert reads["compute_reward"].variables == {"a", "steps"}
    assert reads["compute_reward"].helpers == {"near"}


@pytest.mark.parametrize(
    "source",
    [
        "x = open('y')\n" + reward("x = a[:, 0]"),
        "print('x')\n" + reward("x = a[:, 0]"),
        "@torch.jit.script\n" + reward("x = a[:, 0]"),
        "class C:\n    pass\n" + reward("x = a[:, 0]"),
        "",
    ],
)
def test_a_stored_source_holds_functions_constants_and_imports_only(source):
    with pytest.raises(CodeError):
        check(source)
