"""Numbers held as tensors: the graph means the same, to the bit and to the type."""

from dataclasses import replace

import pytest
import torch

from code_cases import VARIABLES, reward, values
from porse.code.compile import compile_reward
from porse.code.graph import nodes
from porse.code.numbers import hold_numbers
from porse.code.script import script

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
