"""Compiled functions: numbers that can be checked with a pencil, what may be changed in place, and errors with lines."""

import math
import warnings

import pytest
import torch

from code_cases import VARIABLES, compile_mapping, compile_reward, reward, values
from porse.functions.verdict import CodeError, plain_name

BOTH = pytest.mark.parametrize("portable", [False, True])


def run(source, portable=False, rows=4, **given):
    """Returns the total reward of a source on random states, some of them given."""
    return compile_reward(source, VARIABLES, portable)(values(rows) | given)[0]


@BOTH
def test_a_reward_is_total_and_components_by_name(portable):
    source = reward("d = torch.norm(a - b, dim=-1)", "r = torch.exp(-d / 0.5)", result='2 * r, {"near": r, "d": d}')
    function = compile_reward(source, VARIABLES, portable)
    states = values(2) | {"a": torch.tensor([[3.0, 0, 0], [0, 0, 0]]), "b": torch.tensor([[0.0, 4.0, 0], [0, 0, 0]])}
    total, components = function(states)
    # |(3, -4, 0)| = 5 and exp(-10); the second pair is at the same place
    assert list(components) == ["near", "d"]
    assert components["d"].tolist() == [5.0, 0.0]
    assert total.tolist() == pytest.approx([2 * math.exp(-10), 2.0])


def test_arguments_are_task_variables_in_the_order_of_the_function():
    assert compile_reward(reward("x = b[:, 0] + a[:, 0]", arguments="b, a"), VARIABLES, False).program.variables == (
        "b",
        "a",
    )


def test_a_method_takes_what_it_reads():
    source = "def mapping_function(self):\n    return [self.dist(self.b, self.a)], [False], ['d']\n"
    function = compile_mapping(source, VARIABLES, False)
    assert sorted(function.program.variables) == ["a", "b"]
    assert (function.names, function.rises) == (("d",), (False,))


def test_the_original_indexing_by_body_handle_works():
    source = (
        "def mapping_function(self):\n"
        "    p = self.bodies[:, self.handle][:, 0:3]\n"
        "    return [p[:, 1]], [True], ['y']\n"
    )
    states = values(3)
    progress, _, _ = compile_mapping(source, VARIABLES, False)(states)
    assert torch.equal(progress[0], states["bodies"][:, 2, 1])


@BOTH
def test_rotation_distance_is_the_angle_between_the_rotations(portable):
    half = math.sqrt(0.5)
    turns = torch.tensor([[0.0, 0.0, 0.0, 1.0], [half, 0.0, 0.0, half], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, -1.0]])
    here = torch.tensor([[0.0, 0.0, 0.0, 1.0]]).repeat(4, 1)
    variables = [*VARIABLES[:2], VARIABLES[2], VARIABLES[2].__class__("g", "tensor", (4,), "1", "world", "")]
    source = "def mapping_function(q, g):\n    return rot_dist(q, g), False, 'turn'\n"
    (angle,), _, _ = compile_mapping(source, variables, portable)({"q": turns, "g": here})
    # none, a quarter turn about x, half a turn about y, and the same rotation written with the other sign
    assert angle.tolist() == pytest.approx([0.0, math.pi / 2, math.pi, 0.0], abs=1e-6)


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("2 ** 3 ** 2", 512),
        ("-2 ** 2", -4),
        ("(-2) ** 2", 4),
        ("7 // 2 * 2", 6),
        ("2 - 3 - 4", -5),
        ("8 / 4 / 2", 1),
        ("1 if num_envs > 3 else 2", 1),
        ("1.0 if 0 < num_envs < 3 else 2.0", 2),
        ("1.0 / num_envs", 0.25),
        ("num_envs * 2 - 3", 5),
        ("[1.0, 2.0, 3.0][-1]", 3),
        ("{'k': 4.0}['k']", 4),
        ("float(len([a, b]))", 2),
        ("math.pi", math.pi),
        ("np.pi", math.pi),
        ("torch.pi", math.pi),
        ("1e-3 * 1E3", 1),
        ("float(0x10)", 16),
        ("scale", 0.5),
        ("float(True)", 1),
        ("float(3 & 5 | 8)", 9),
        ("float(1 << 4)", 16),
    ],
)
def test_expressions_mean_what_they_mean_in_python(expression, expected):
    total = run(reward("x = a[:, 0] * 0 + (" + expression + ")", arguments="a, b, num_envs, scale"))
    assert total.tolist() == pytest.approx([expected] * 4)


def test_tensor_comparisons_in_brackets_are_elementwise():
    states = {"a": torch.tensor([[0.5, 0, 0], [1.5, 0, 0]])}
    assert run(reward("x = ((a[:, 0] > 0) & (a[:, 0] < 1)).float()"), rows=2, **states).tolist() == [1.0, 0.0]


def test_cross_takes_the_last_dimension_even_for_three_environments():
    states = {"a": torch.eye(3), "b": torch.eye(3).roll(1, 0)}
    total = run(reward("x = torch.cross(a, b).sum(dim=-1)"), rows=3, **states)
    assert torch.equal(total, torch.linalg.cross(states["a"], states["b"], dim=-1).sum(-1))


def test_integer_defaults_become_what_they_are_annotated_as():
    source = reward("x = a[:, 0] * 0 + t / 2 + u", arguments="a, b, t: float = 1, u=2")
    assert run(source).tolist() == [2.5] * 4


def test_components_become_float_vectors():
    source = reward("x = a[:, 0]", result='x.double(), {"mean": x.mean(), "on": x > 0}')
    total, components = compile_reward(source, VARIABLES, False)(values(4))
    assert {value.dtype for value in (total, *components.values())} == {torch.float32}
    assert {value.shape for value in (total, *components.values())} == {(4,)}


@BOTH
@pytest.mark.parametrize("rows", [1, 7, 1024])
def test_calls_give_the_same_bits_however_often_they_are_made(portable, rows):
    source = reward(
        "d = torch.norm(a - b, dim=-1)",
        "m = torch.eye(3)",
        "y = torch.mm(a, m) + torch.mm(b, m) + torch.mm(a, m.t()) + torch.mm(b, m.t())",
        "x = torch.exp(-d / 0.1) * 0.3 + d * 0.7 - (d * d + 1.0) / (d + 2.0)",
        "for i in range(3):\n    x = x + torch.tanh(d) * 0.1 + torch.sqrt(d) + y.sum(-1)",
    )
    function = compile_reward(source, VARIABLES, portable)
    states = values(rows)
    with torch.inference_mode():
        results = [function(states)[0] for _ in range(50)]
    fresh = compile_reward(source, VARIABLES, portable)(states)[0]
    assert all(torch.equal(result, results[0]) for result in results)
    assert torch.equal(fresh, results[0])


def test_compilation_and_calls_give_no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(reward("x = F.huber_loss(a, b, reduction='none').sum(-1) + F.normalize(a, dim=-1)[:, 0]"))


@pytest.mark.parametrize(
    ("body", "check", "line", "says"),
    [
        ("x = a[:, 0]\n\ny = x + 'z'", "type", 4, "str"),
        ("x = torch.clamp(a[:, 0], 0, 1, 2)", "type", 2, "clamp"),
        ("x = a[:, 0] + z\nz = 1.0", "run", 2, "z"),
        ("x = a[:, 0]\nfor i in range(2):\n    x.append(i)", "type", 4, "append"),
    ],
)
def test_what_python_refuses_has_the_line_of_the_source(body, check, line, says):
    with pytest.raises(CodeError, match=says) as error:
        compile_reward(reward(body), VARIABLES, False)
    assert (error.value.check, error.value.line) == (check, line)
    assert "porse_" not in str(error.value)
    assert "File" not in str(error.value)


def test_what_fails_in_a_run_has_the_line_of_the_source():
    with pytest.raises(CodeError, match="must match the size") as error:
        compile_reward(reward("x = a[:, 0]", "", "x = x + torch.zeros(9)"), VARIABLES, False)
    assert (error.value.check, error.value.line) == ("run", 4)


def test_what_fails_in_a_helper_has_the_line_of_the_helper():
    source = "def h(y):\n    return y[:, 7]\n" + reward("x = h(a)")
    with pytest.raises(CodeError, match="out of bounds") as error:
        compile_reward(source, VARIABLES, False)(values(4))
    assert error.value.line == 2


@pytest.mark.parametrize(
    "body",
    [
        "a += 1\nx = a[:, 0]",
        "x = a[:, 0]\nx *= 2",
        "y = a\ny[0, 0] = 1.0\nx = y[:, 0]",
        "y = a.reshape(-1)\ny.zero_()\nx = a[:, 0]",
        "y, z, w = a.unbind(-1)\nz.add_(1.0)\nx = y",
        "d = {'a': a}\nd['a'][0] = 1.0\nx = a[:, 0]",
        "ys = [a, b * 1]\nfor y in ys:\n    y[0] = 0.0\nx = a[:, 0]",
        "y = a.to(torch.float32)\ny[0] = 0.0\nx = y[:, 0]",
        "if scale > 0:\n    y = a\nelse:\n    y = a * 1\ny[0] = 0.0\nx = y[:, 0]",
        "y = a.contiguous()\ny.clamp_(0.0, 1.0)\nx = y[:, 0]",
        "a[:] = 0.0\nx = a[:, 0]",
        "ys = [b * 1]\nys += [a]\nys[1][0] = 0.0\nx = b[:, 0]",
        "ys = [b * 1] + [a]\nys[1][0] = 0.0\nx = b[:, 0]",
        "ys = [a] * 2\nys[1][0] = 0.0\nx = b[:, 0]",
        "d = {**{'a': a}}\nd['a'][0] = 1.0\nx = b[:, 0]",
        "y = 0.0\nfor i in range(3):\n    y = y + a[:, i]\na += 1\nx = y",
    ],
)
def test_changing_an_input_is_found_through_every_chain(body):
    with pytest.raises(CodeError, match=r"input a in place; work on a\.clone\(\)") as error:
        compile_reward(reward(body, arguments="a, b, scale, num_envs"), VARIABLES, False)
    assert error.value.check == "inplace"


@pytest.mark.parametrize(
    "body",
    [
        "x = torch.zeros_like(a[:, 0])\nx += a[:, 0]\nx[x > 0.5] = 1.0",
        "y = a.clone()\ny[:, 0] = 0.0\nx = y[:, 0]",
        "x = a.sum(-1)\nx[b[:, 0] > 0] = 0.0\nx *= 2\nx.clamp_(0, 1)",
        "ys = [a * 1, b * 1]\nfor y in ys:\n    y[0] = 0.0\nx = ys[0][:, 0]",
        "x = torch.where(a[:, 0] > 1, a[:, 0], b[:, 0])\nx[0] = 1.0",
        "x = a\nx = x[:, 0] + 1\nx -= b[:, 0]",
        "x, i = torch.max(a, dim=-1)\nx += 1",
        "ys = [a * 1] + [b]\nys[0][0] = 0.0\nx = ys[0][:, 0]",
    ],
)
def test_changing_tensors_of_its_own_is_accepted(body):
    states = values(4)
    before = {name: states[name].clone() for name in ("a", "b")}
    compile_reward(reward(body), VARIABLES, False)(states)
    assert all(torch.equal(before[name], states[name]) for name in before)


def test_a_colon_too_many_is_an_error():
    with pytest.raises(CodeError, match=r"[Dd]imension"):
        compile_reward(reward("x = a[:, :, :][:, 0, 0]"), VARIABLES, False)(values(2))


def test_a_size_that_is_no_multiple_of_the_environments_is_refused():
    with pytest.raises(CodeError, match=r"expected the component x of shape \(num_envs,\), found \(16,\)"):
        compile_reward(reward("x = torch.ones(16)\ny = a[:, 0]"), VARIABLES, False)


@pytest.mark.parametrize(
    "body",
    [
        "x = a[:, 0] if a.shape[0] > 3000 else b[:, 0]",
        "x = a[:, 0]\nfor row in a[: a.shape[0] // 100]:\n    x = x + row[0]",
        "x = a[:, 0] * (num_envs % 3)",
        "x = a[:, 0] * torch.tensor([i for i in range(num_envs)])",
        "x = a[:, 0] * math.sqrt(num_envs)",
    ],
)
def test_what_hangs_on_the_number_of_environments_otherwise_is_refused(body):
    with pytest.raises(CodeError, match="depends on the number of environments") as error:
        compile_reward(reward(body, arguments="a, b, num_envs"), VARIABLES, False)
    assert error.value.check == "static"


@BOTH
def test_every_call_returns_the_plain_form_and_not_the_first_alone(portable):
    source = reward("d = a[:, 0]", result='(d > 0), {"mean distance (m)": d.mean(), "near": d < 0.5, "d": d}')
    function = compile_reward(source, VARIABLES, portable)
    states = values()
    for _ in range(3):
        total, components = function(states)
        assert list(components) == ["mean_distance_m", "near", "d"]
        assert {(value.dtype, value.shape) for value in (total, *components.values())} == {(torch.float32, (16,))}
        assert torch.equal(components["mean_distance_m"], states["a"][:, 0].mean().expand(16))
    mapping = compile_mapping(
        "def mapping_function(a):\n    return a[:, 0] > 0, True, 'in front'\n", VARIABLES, portable
    )
    for _ in range(3):
        progress, rises, names = mapping(states)
        assert (rises, names) == ([True], ["in_front"])
        assert torch.equal(progress[0], (states["a"][:, 0] > 0).float())


def test_names_that_are_read_again_or_would_be_one_stay_until_the_end():
    read = reward("x = a[:, 0]\nc = {'far away': x}\nx = x + c['far away']", result="x, c")
    assert list(compile_reward(read, VARIABLES, False)(values())[1]) == ["far_away"]
    with pytest.raises(CodeError, match="distinct names, found a b, a_b"):
        compile_reward(reward("x = a[:, 0]", result='x, {"a b": x, "a_b": x}'), VARIABLES, False)


@BOTH
def test_what_is_written_twice_is_computed_once(portable):
    body = "x = torch.exp(-torch.norm(a - b, dim=-1)) + 2.0 * torch.exp(-torch.norm(a - b, dim=-1))"
    function = compile_reward(reward(body), VARIABLES, portable)
    kinds = [step.operator for step in function.program.steps]
    assert kinds.count("exp.default") == kinds.count("linalg_vector_norm.default") == 1
    states = values()
    near = torch.exp(-torch.norm(states["a"] - states["b"], dim=-1))
    torch.testing.assert_close(function(states)[0], 3.0 * near)


@BOTH
def test_two_tensors_that_are_alike_stay_two_where_one_is_changed(portable):
    body = "x = torch.zeros_like(a[:, 0])\ny = torch.zeros_like(a[:, 0])\nx += 1.0\nx = x * 10.0 + y"
    function = compile_reward(reward(body), VARIABLES, portable)
    for _ in range(2):
        assert function(values())[0].tolist() == [10.0] * 16


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("near", "near"),
        ("near target (m)", "near_target_m"),
        ("  a--b ", "a_b"),
        ("é", "unnamed"),
        ("x" * 99, "x" * 64),
        ("x" * 63 + " y", "x" * 63),
    ],
)
def test_names_become_plain(name, plain):
    assert plain_name(name) == plain
