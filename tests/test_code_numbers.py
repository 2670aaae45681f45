"""Numbers held as tensors: the graph means the same, to the bit and to the type."""

import contextlib
from dataclasses import replace

import pytest
import torch

from code_cases import VARIABLES, reward, values
from porse.code.compile import compile_reward
from porse.code.graph import nodes
from porse.code.numbers import hold_numbers, hold_tensors
from porse.code.script import script
from porse.code.verdict import CodeError

_OPERANDS = {
    "floats": "a[:, 0]",
    "a float": "torch.mean(a)",
    "a root": "torch.sqrt(a[:, 0].abs())",
    "counts": "steps",
    "a count": "steps.sum()",
    "truths": "(a[:, 0] > 0)",
    "doubles": "a[:, 0].double()",
    "a double": "a.mean().to(torch.float64)",
    "halves": "a[:, 0].half()",
}
_EXPRESSIONS = [
    *("y + 0.1", "0.1 + y", "y - 0.1", "y * 0.1", "0.1 * y", "y / 0.1", "0.1 / y", "y + 3", "y - 3", "y * 3", "y / 3"),
    *(
        "1.0 - y",
        "1 - y",
        "torch.add(y, 0.1, alpha=2)",
        "torch.div(y, 0.3, rounding_mode='floor')",
        "y // 0.3",
        "-y * 3",
    ),
    *("y < 0.1", "y <= 0.1", "y > 0.1", "y >= 1", "y == 0.1", "y != 1", "y * 1e39", "y * 0.1 + 9999999"),
]


def _run(graph, compiled, given):
    try:
        return replace(compiled, graph=graph).callable()(*given)[0]
    except RuntimeError as error:
        return str(error).splitlines()[-1]


@pytest.mark.parametrize("operand", _OPERANDS)
@pytest.mark.parametrize("expression", _EXPRESSIONS)
def test_results_keep_their_bits_and_types(expression, operand):
    source = reward(f"y = {_OPERANDS[operand]}", f"x = {expression}", arguments="a, steps")
    compiled = script(source, {variable.name: variable for variable in VARIABLES})
    states = values(1025)
    given = [states[name] for name in compiled.arguments]
    graph = compiled.graph.copy()
    hold_numbers(graph)
    plain, held = _run(compiled.graph, compiled, given), _run(graph, compiled, given)
    if isinstance(plain, str):
        assert held == plain
    else:
        torch.testing.assert_close(held, plain, rtol=0, atol=0, equal_nan=True)  # compares shape and type too


def _held(*body):
    graph = compile_reward(reward(*body, arguments="a, steps"), VARIABLES, True)._script.graph
    found = [node.output().toIValue() for node in nodes(graph) if node.kind() == "prim::Constant"]
    return sorted(float(value) for value in found if isinstance(value, torch.Tensor))


def test_floats_are_held():
    assert _held("x = torch.exp(-a[:, 0] / 0.5) * 2.0 + 0.25") == [0.25, 0.5, 2.0]


def test_integers_are_held_beside_what_is_certainly_a_float():
    assert _held("x = 3 * torch.exp(a[:, 0]) + steps * 5") == [3.0]


@pytest.mark.parametrize("wide", ["y.double()", "y.to(torch.float64)", "torch.sum(y, dtype=torch.float64)", "y.half()"])
def test_nothing_is_held_where_there_are_other_floats(wide):
    assert _held("y = a[:, 0] * 0.5", f"x = y + {wide}") == []


_TENSORS = {
    "torch.tensor(0.5)": True,
    "torch.tensor([0.0, 0.0, 1.0])": True,
    "torch.tensor([[1.0, 2.0, 3.0]], dtype=torch.float32)": True,
    "torch.tensor([1, 2, 3], dtype=torch.float)": True,
    "torch.tensor([True, False, True])": True,
    "torch.as_tensor(2)": True,
    "torch.tensor([0.0, 0.0, 1.0], device=a.device)": True,
    "torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)": False,
    "torch.tensor([scale, 1.0, 2.0])": False,
    "torch.tensor(a.shape[0])": False,
}


@pytest.mark.parametrize("expression", _TENSORS)
def test_tensors_of_numbers_that_are_written_out_are_made_once(expression):
    source = reward(f"w = {expression}", "x = (a * w).sum(-1)", arguments="a, scale")
    compiled = script(source, {variable.name: variable for variable in VARIABLES})
    kinds = {node.kind() for node in nodes(compiled.graph)}
    assert ("aten::tensor" not in kinds and "aten::as_tensor" not in kinds) == _TENSORS[expression]
    states = values(5)
    weights = eval(expression.replace("a.", "states['a'].").replace("scale", "0.5"), {"torch": torch, "states": states})
    total, _ = compile_reward(source, VARIABLES, False)(states)
    assert torch.equal(total, (states["a"] * weights).sum(-1).float())


@pytest.mark.parametrize("write", ["w += 1.0", "v = w[0:2]\nv *= 2.0", "c = {'w': w}\nc['w'].add_(1.0)"])
def test_tensors_that_are_written_to_are_made_anew_in_every_call(write):
    function = compile_reward(
        reward("w = torch.tensor([1.0, 2.0, 3.0])", write, "x = (a * w).sum(-1)"), VARIABLES, True
    )
    first, second, third = (function(values(5))[0] for _ in range(3))
    assert torch.equal(first, second)
    assert torch.equal(first, third)


def test_the_lists_of_such_numbers_leave_the_graph():
    source = reward("x = (a * torch.tensor([[0.0, 0.0, 1.0]])).sum((1, ))")
    graph = script(source, {variable.name: variable for variable in VARIABLES}).graph
    lists = [node for node in nodes(graph) if node.kind() == "prim::ListConstruct"]
    assert [len(list(node.inputs())) for node in lists] == [1]  # the dimensions of the sum
    assert not hold_tensors(graph)


@pytest.mark.parametrize("expression", ["[[1.0], [2.0, 3.0]]", "[-1], dtype=torch.uint8", "300, dtype=torch.uint8"])
def test_what_is_no_tensor_is_a_verdict(expression):
    """Whatever torch says of it in a call; it does not fail while it is compiled."""
    with contextlib.suppress(CodeError):
        compile_reward(reward(f"w = torch.tensor({expression})", "x = a[:, 0] * w.sum()"), VARIABLES, False)(values(5))


@pytest.mark.parametrize("fill", ["n.append(3.0)", "n[1] = 3.0", "for i in range(2):\n    n.append(3.0)"])
def test_a_list_that_is_filled_later_is_no_list_that_is_written_out(fill):
    function = compile_reward(reward("n = [1.0, 2.0]", fill, "x = a[:, 0] * torch.tensor(n).sum()"), VARIABLES, True)
    states, total = values(5), {"n.append(3.0)": 6.0, "n[1] = 3.0": 4.0}.get(fill, 9.0)
    assert torch.equal(function(states)[0], states["a"][:, 0] * total)
