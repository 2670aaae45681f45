"""Results that come as one list: the same names, order and numbers as the function wrote."""

import pytest
import torch

from code_cases import VARIABLES, reward, values
from porse.code.compile import compile_mapping, compile_reward
from porse.code.results import list_components, list_progress
from porse.code.script import script

BOTH = pytest.mark.parametrize("portable", [False, True])
TABLE = {variable.name: variable for variable in VARIABLES}


def mapping(*body, result):
    lines = "".join(f"    {line}\n" for line in body)
    return f"def mapping_function(a, b):\n{lines}    return {result}\n"


def listed(source):
    """Returns what stands around the tensors of a source, and what its graph returns then."""
    graph = script(source, TABLE).graph.copy()
    around = list_progress(graph) if "mapping_function" in source else list_components(graph)
    return around, next(graph.outputs()).type().str()


@pytest.mark.parametrize(
    ("source", "names"),
    [
        (reward("x = a[:, 0]"), ("x",)),
        (reward("x = a[:, 0]", result='x * 2, {"x": x, "far away": x + 1, "z": b[:, 0]}'), ("x", "far_away", "z")),
        (reward("c = {'x': a[:, 0], 'y': b[:, 1]}", "x = a[:, 0] + b[:, 1]", result="x, c"), ("x", "y")),
        (reward("x = a[:, 0]", "c = {'x': x}", "c['y'] = x", result="x, c"), None),
        (reward("c = {'x': a[:, 0]}", "x = c[list(c.keys())[0]] * 2", result="x, c"), None),
        (reward("x = a[:, 0]", result='x, {"a b": x, "a_b": x}'), ("a b", "a_b")),
        (reward("x = a[:, 0]", result='x, {"x": x, "x": x + 1}'), None),
        (reward("x = a[:, 0]", "if scale > 0:", "    return x, {'y': x}", arguments="a, scale"), None),
    ],
)
def test_components_are_listed_where_their_names_are_written_out(source, names):
    around, type_ = listed(source)
    assert (around.names if around else None) == names
    assert type_ == ("Tensor[]" if names else "(Tensor, Dict(str, Tensor))")


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        (mapping(result="[a[:, 0], b[:, 1]], [True, False], ['up', 'to go (m)']"), (["up", "to_go_m"], [True, False])),
        (mapping("v = [a[:, 0]]", "v.append(b[:, 0])", result="v, [True, False], ['x', 'y']"), (["x", "y"], [True, False])),
        (mapping("n = ['x']", "n.append('y')", result="[a[:, 0], b[:, 0]], [True, True], n"), None),
        (mapping(result="a[:, 0], True, 'x'"), None),
    ],
)  # fmt: skip
def test_progress_variables_are_listed_where_names_and_directions_are_written_out(source, expected):
    around, type_ = listed(source)
    assert ((around.names, around.rises) if around else None) == expected
    assert (type_ == "Tensor[]") == (expected is not None)


@BOTH
def test_components_and_the_total_do_not_change_places(portable):
    source = reward("x = a[:, 0]", result='x * 10, {"one": x, "two": x * 2, "three": x * 3}')
    states = values()
    function = compile_reward(source, VARIABLES, portable)
    for _ in range(3):
        total, components = function(states)
        assert list(components) == ["one", "two", "three"]
        for factor, value in zip((10, 1, 2, 3), (total, *components.values()), strict=True):
            assert torch.equal(value, states["a"][:, 0] * factor)


@BOTH
def test_progress_variables_keep_their_names_and_directions(portable):
    source = mapping(result="[a[:, 0], b[:, 1] * 2.0], [True, False], ['up', 'to go']")
    states = values()
    function = compile_mapping(source, VARIABLES, portable)
    for _ in range(3):
        progress, rises, names = function(states)
        assert (rises, names) == ([True, False], ["up", "to_go"])
        assert torch.equal(progress[0], states["a"][:, 0])
        assert torch.equal(progress[1], states["b"][:, 1] * 2)
        rises.append(True)  # a caller's list is the caller's
        names.clear()


@BOTH
def test_a_total_that_is_its_own_component_is_one_tensor(portable):
    total, components = compile_reward(reward("x = a[:, 0]"), VARIABLES, portable)(values())
    assert components["x"] is total


@BOTH
@pytest.mark.parametrize(
    ("result", "converted"),
    [
        ('x, {"x": x}', 0),
        ('x > 0, {"x": x}', 1),
        ('x, {"near": x > 0, "mean": x.mean(), "count": steps.sum()}', 4),
        ("x.double(), {'x': x.half()}", 2),
    ],
)
def test_what_is_no_vector_of_floats_is_made_one_in_the_graph_from_the_second_call_on(result, converted, portable):
    function = compile_reward(reward("x = a[:, 0]", result=result, arguments="a, steps"), VARIABLES, portable)
    before = len(list(function._graph.nodes()))
    for rows in (16, 16, 16, 5, 5):
        states = values(rows)
        total, components = function(states)
        for value in (total, *components.values()):
            assert (value.dtype, value.shape) == (torch.float32, (rows,))
        if "near" in components:
            assert torch.equal(components["near"], (states["a"][:, 0] > 0).float())
            assert torch.equal(components["mean"], states["a"][:, 0].mean().expand(rows))
            assert torch.equal(components["count"], states["steps"].sum().float().expand(rows))
    kinds = [node.kind() for node in list(function._graph.nodes())]
    assert (len(kinds) > before) == bool(converted)
    assert kinds.count("aten::to") + kinds.count("aten::expand") >= converted


@BOTH
@pytest.mark.parametrize(
    "body",
    [
        ["v = [a[:, 0] > 0]", "v.append(b[:, 0] > 0)", "v.append(v[0] & v[1])"],
        ["v = [a[:, 0] > 0, b[:, 0] > 0]", "v.append(v[0] & v[1])"],
        ["w = [a[:, 0] > 0, b[:, 0] > 0]", "v = [w[0], w[1], w[0] & w[1]]"],
        ["v = [a[:, 0] > 0, b[:, 0] > 0, a[:, 0] > 9]", "v[2] = v[0] & v[1]"],
    ],
)
def test_truth_values_in_a_list_that_is_filled_or_read_become_floats_for_the_caller_alone(body, portable):
    source = mapping(*body, result="v, [True, True, True], ['x', 'y', 'both']")
    function, states = compile_mapping(source, VARIABLES, portable), values()
    x, y = states["a"][:, 0] > 0, states["b"][:, 0] > 0
    for _ in range(3):
        progress, _, names = function(states)
        assert names == ["x", "y", "both"]
        assert [value.dtype for value in progress] == [torch.float32] * 3
        for found, expected in zip(progress, (x, y, x & y), strict=True):
            assert torch.equal(found, expected.float())


@BOTH
def test_progress_variables_become_floats_in_the_graph(portable):
    function = compile_mapping(mapping(result="[a[:, 0] > 0], [True], ['in front']"), VARIABLES, portable)
    states = values()
    for _ in range(3):
        assert torch.equal(function(states)[0][0], (states["a"][:, 0] > 0).float())
    assert "aten::to" in [node.kind() for node in function._graph.nodes()]
