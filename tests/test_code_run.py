"""Operator lists: their text, what a hostile one cannot do, and that they run as they stand, on any number of environments."""

import json
import os

import pytest
import torch

from code_cases import (
    VARIABLES,
    MappingFunction,
    RewardFunction,
    compile_mapping,
    compile_reward,
    reward,
    traced,
    values,
)
from porse.functions.run.operators import operator
from porse.functions.run.program import Register, Rows, Share, read_program
from porse.functions.verdict import CodeError
from porse.identity import canonical_json

BOTH = pytest.mark.parametrize("portable", [False, True])
SOURCE = reward(
    "up = torch.tensor([0.0, 1.0, -0.5])",
    "x = (a * up).sum(dim=-1) / num_envs + torch.zeros(num_envs)",
    arguments="a, num_envs",
    result='2.0 * x, {"near target (m)": x}',
)


def test_a_list_is_written_as_what_it_is():
    program = traced(SOURCE, "reward", VARIABLES)
    assert (program.kind, program.variables, program.names, program.rises) == ("reward", ("a",), ("near_target_m",), ())
    assert [constant.tolist() for constant in program.constants] == [[0.0, 1.0, -0.5]]
    assert [step.operator for step in program.steps] == [
        "mul.Tensor", "sum.dim_IntList", "div.Tensor", "zeros.default", "add.Tensor", "mul.Tensor",
    ]  # fmt: skip
    assert program.steps[0].arguments == (Register(0), Register(1))
    assert program.steps[2].arguments == (Register(3), Rows(1, 0))
    assert program.steps[3].arguments == ((Rows(1, 0),),)
    assert program.results == (7, 6)


def test_its_text_is_the_same_for_the_same_function_and_tells_another():
    text = traced(SOURCE, "reward", VARIABLES).text
    assert text == traced(SOURCE.replace("up", "weights"), "reward", VARIABLES).text == read_program(text).text
    other = traced(SOURCE.replace("-0.5", "-0.25"), "reward", VARIABLES)
    assert other.text != text


@BOTH
def test_a_list_holds_for_any_number_of_environments(portable):
    function = RewardFunction(traced(SOURCE, "reward", VARIABLES).text, portable)
    for rows in (1, 2, 3, 7, 16, 500, 16):
        states = values(rows, seed=rows)
        total, components = function(states)
        expected = (states["a"][:, 1] - 0.5 * states["a"][:, 2]) / rows
        torch.testing.assert_close(total, 2 * expected)
        torch.testing.assert_close(components["near_target_m"], expected)


def test_numbers_that_grow_and_shrink_with_the_environments():
    assert (Rows(3, -2).at(10), Share(5.0).at(10)) == (28, 0.5)
    text = traced(reward("x = a[:, 0] * (1.0 / a.shape[0])", arguments="a"), "reward", VARIABLES).text
    assert '{"share":1.0}' in text


@BOTH
def test_a_mapping_says_names_and_directions_without_a_call(portable):
    source = "def mapping_function(self):\n    return [self.a[:, 0], self.b[:, 1]], [True, False], ['x', 'y z']\n"
    function = compile_mapping(source, VARIABLES, portable)
    assert (function.names, function.rises) == (("x", "y_z"), (True, False))
    progress, rises, names = function(states := values(5))
    assert (rises, names) == ([True, False], ["x", "y_z"])
    assert torch.equal(progress[0], states["a"][:, 0])
    assert torch.equal(progress[1], states["b"][:, 1])


def test_special_numbers_types_and_keywords_come_back():
    body = "x = torch.full_like(a[:, 0], float('inf')).clamp(max=1e6) + a.double().sum(-1, dtype=torch.float64)"
    source = reward(body + "\nx = torch.nan_to_num(x, nan=-0.0, posinf=math.inf)")
    text = traced(source, "reward", VARIABLES).text
    assert '{"f":"inf"}' in text
    assert '{"t":"float64"}' in text
    assert RewardFunction(text, True)(values())[0].dtype is torch.float32


def held(**changes):
    """Returns a sound list as JSON, some of it changed."""
    program = {
        "kind": "reward", "variables": ["a"], "constants": [["float32", [1.0, 2.0, 3.0]]],
        "steps": [["mul.Tensor", [{"r": 0}, {"r": 1}], {}, 1], ["sum.dim_IntList", [{"r": 2}, [-1]], {}, 1]],
        "results": [3, 3], "names": ["x"], "rises": [],
    }  # fmt: skip
    return program | changes


def step(*steps):
    """Returns a list with other steps, whose last one is its result."""
    made = 2 + sum(found[3] for found in steps) - 1
    return held(steps=[list(found) for found in steps], results=[made, made])


SUM = ("sum.dim_IntList", [{"r": 2}, [-1]], {}, 1)
HOSTILE = {
    "no JSON": "{",
    "nothing": "{}",
    "deep": "[" * 100_000,
    "another spelling": json.dumps(held()),
    "too long": canonical_json(held(names=["x" * 1_000_001])),
    "a key too many": canonical_json(held(more=1)),
    "a file": canonical_json(step(("from_file.default", ["CANARY", True, 100], {}, 1))),
    "a file to write": canonical_json(step(("_save.default", [{"r": 0}, "CANARY"], {}, 1))),
    "another library": canonical_json(step(("porse::acos_f32_", [{"r": 0}], {}, 1))),
    "a dunder": canonical_json(step(("__class__.default", [{"r": 0}], {}, 1))),
    "an attribute of the packet": canonical_json(step(("mul.__init__", [{"r": 0}, {"r": 0}], {}, 1))),
    "chance": canonical_json(step(("rand.default", [[{"n": [1, 0]}]], {}, 1))),
    "memory of others": canonical_json(step(("as_strided.default", [{"r": 0}, [1000], [1]], {}, 1))),
    "memory unset": canonical_json(step(("empty.memory_format", [[{"n": [1, 0]}]], {}, 1))),
    "a result given": canonical_json(step(("mul.out", [{"r": 0}, {"r": 0}, {"r": 0}], {}, 1))),
    "an input changed": canonical_json(step(("mul_.Tensor", [{"r": 0}, 2.0], {}, 1), SUM)),
    "an input changed through a view": canonical_json(
        step(("select.int", [{"r": 0}, 1, 0], {}, 1), ("add_.Tensor", [{"r": 2}, 1.0], {}, 1))
    ),
    "an input changed through a view that is none always": canonical_json(
        step(("reshape.default", [{"r": 0}, [-1, 3]], {}, 1), ("add_.Tensor", [{"r": 2}, 1.0], {}, 1), SUM)
    ),
    "a constant changed": canonical_json(
        step(("add_.Tensor", [{"r": 1}, 1.0], {}, 1), ("mul.Tensor", [{"r": 0}, {"r": 2}], {}, 1))
    ),
    "a size of data": canonical_json(
        step(("gt.Scalar", [{"r": 0}, 0.0], {}, 1), ("index.Tensor", [{"r": 0}, [{"r": 2}]], {}, 1))
    ),
    "a number of data": canonical_json(step(("item.default", [{"r": 0}], {}, 1))),
    "rows that are not zero": canonical_json(step(("nonzero.default", [{"r": 0}], {}, 1))),
    "a huge tensor": canonical_json(step(("ones.default", [[10_000_000, 10_000_000]], {}, 1))),
    "huge by two": canonical_json(
        step(("ones.default", [[5_000_000]], {}, 1), ("outer.default", [{"r": 2}, {"r": 2}], {}, 1))
    ),
    "huge by a view": canonical_json(
        step(("expand.default", [{"r": 1}, [10_000_000, 3]], {}, 1), ("mul.Tensor", [{"r": 2}, 2.0], {}, 1))
    ),
    "huge at many": canonical_json(step(("zeros.default", [[{"n": [1, 0]}, 90_000]], {}, 1), SUM)),
    "a whole number too large": canonical_json(step(("add.Tensor", [{"r": 0}, 10**30], {}, 1))),
    "whole numbers that trap": canonical_json(
        step(
            ("to.dtype", [{"r": 0}, {"t": "int64"}], {}, 1),
            ("div.Tensor_mode", [{"r": 2}, {"r": 2}], {"rounding_mode": "floor"}, 1),
        )
    ),
    "whole numbers that trap with 128 environments": canonical_json(
        step(
            ("to.dtype", [{"r": 0}, {"t": "int64"}], {}, 1),
            ("div.Scalar_mode", [{"r": 2}, {"n": [1, -129]}], {"rounding_mode": "trunc"}, 1),
            ("to.dtype", [{"r": 3}, {"t": "float32"}], {}, 1),
        )
    ),
    "huge by pairs in a row": canonical_json(
        step(
            ("select.int", [{"r": 0}, 1, 0], {}, 1),
            ("outer.default", [{"r": 2}, {"r": 2}], {}, 1),
            ("flatten.using_ints", [{"r": 3}, 0, -1], {}, 1),
            ("sum.default", [{"r": 4}], {}, 1),
            ("add.Tensor", [{"r": 2}, {"r": 5}], {}, 1),
        )
    ),
    "parts of data": canonical_json(
        step(
            ("select.int", [{"r": 0}, 1, 0], {}, 1),
            ("gt.Scalar", [{"r": 2}, 5.0], {}, 1),
            ("sum.default", [{"r": 3}], {}, 1),
            ("add.Tensor", [{"r": 4}, 1], {}, 1),
            ("tensor_split.tensor_indices_or_sections", [{"r": 2}, {"r": 5}], {}, 1),
        )
    ),
    "a share without bounds": canonical_json(step(("mul.Tensor", [{"r": 0}, {"share": 10**400}], {}, 1))),
    "a register to come": canonical_json(step(("mul.Tensor", [{"r": 0}, {"r": 9}], {}, 1))),
    "a register below": canonical_json(step(("mul.Tensor", [{"r": 0}, {"r": -1}], {}, 1))),
    "results of another number": canonical_json(step(("unbind.int", [{"r": 0}, 1], {}, 2))),
    "no vector": canonical_json(held(results=[2, 3])),
    "a name of its own": canonical_json(held(names=["x; rm"])),
    "one name twice": canonical_json(held(names=["x", "x"], results=[3, 3, 3])),
    "no names": canonical_json(held(names=[], results=[3])),
    "a direction too many": canonical_json(held(rises=[True])),
    "another kind": canonical_json(held(kind="alpha")),
    "a device": canonical_json(step(("to.device", [{"r": 0}, "cuda", {"t": "float32"}], {}, 1), SUM)),
    "a keyword of torch": canonical_json(step(("ones.default", [[3]], {"pin_memory": True}, 1), SUM)),
    "a type unknown": canonical_json(held(constants=[["complex64", [1.0, 2.0, 3.0]]])),
    "steps without end": canonical_json(held(steps=[["mul.Tensor", [{"r": 0}, 2.0], {}, 1]] * 4001)),
    "constants without end": canonical_json(held(constants=[["float32", [0.5] * 20_001]])),
}


def test_the_list_that_the_hostile_ones_are_made_of_is_sound():
    states = values()
    total, components = RewardFunction(canonical_json(held()), True)(states)
    assert torch.equal(total, components["x"])
    torch.testing.assert_close(total, states["a"] @ torch.tensor([1.0, 2.0, 3.0]))


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_list_is_refused_and_changes_nothing(name, tmp_path):
    canary, states = tmp_path / "canary", values()
    before = {key: value.clone() for key, value in states.items() if isinstance(value, torch.Tensor)}
    environment = dict(os.environ), torch.get_num_threads(), torch.initial_seed()
    with pytest.raises(CodeError):
        RewardFunction(HOSTILE[name].replace("CANARY", str(canary)), True)(states)
    assert not canary.exists()
    assert all(torch.equal(states[key], value) for key, value in before.items())
    assert environment == (dict(os.environ), torch.get_num_threads(), torch.initial_seed())


def nested(number, depth):
    return [nested(number, depth - 1)] if depth else number


@pytest.mark.parametrize(
    "of",
    [
        lambda depth: held(constants=[["float32", nested(0.5, depth)]]),
        lambda depth: step(("ones.default", [nested(2, depth)], {}, 1), SUM),
        lambda depth: step(("ones.default", [[2]], {"dtype": nested(2, depth)}, 1), SUM),
    ],
    ids=["constant", "argument", "keyword"],
)
def test_lists_lie_six_deep_and_no_deeper(of):
    read_program(canonical_json(of(6)))
    with pytest.raises(CodeError, match="of little depth"):
        read_program(canonical_json(of(7)))


@pytest.mark.parametrize("number", [{"n": [1, 0]}, {"f": "inf", "n": [1, 0]}, "0.5", None])
def test_a_constant_holds_numbers_alone(number):
    with pytest.raises(CodeError):
        read_program(canonical_json(held(constants=[["float32", [1.0, number, 3.0]]])))


def test_a_mapping_is_no_reward():
    with pytest.raises(CodeError, match="the operator list of a mapping"):
        MappingFunction(canonical_json(held()), False)


def test_no_operator_writes_elsewhere_than_over_its_first_argument_or_draws_numbers():
    for name in (
        "mul.out",
        "rand.default",
        "bernoulli_.float",
        "set_.source_Tensor",
        "resize_.default",
        "dropout.default",
    ):
        with pytest.raises(CodeError, match="not on the list of allowed operators"):
            operator(name)
    assert operator("add_.Tensor").writes
    assert not operator("add.Tensor").writes


@BOTH
def test_numbers_are_held_and_memory_is_used_again_without_a_change_of_bits(portable):
    body = "y = torch.exp(a[:, 0] * 0.3)\nz = torch.tanh(y + 1.0)\nx = (y - z) * 0.7 + z / 3.0 - (2.0 - y)\nx = torch.where(x > 0.1, x, -x)"
    function = compile_reward(reward(body, arguments="a"), VARIABLES, portable)
    with torch.inference_mode():
        for rows in (16, 33):
            states = values(rows, seed=3)
            kept = states["a"].clone()
            results = [function(states)[0].clone() for _ in range(3)]
            y = torch.exp(states["a"][:, 0] * 0.3)
            z = torch.tanh(y + 1.0)
            x = (y - z) * 0.7 + z / 3.0 - (2.0 - y)
            assert all(torch.equal(result, torch.where(x > 0.1, x, -x)) for result in results)
            assert torch.equal(states["a"], kept)


def test_results_of_a_call_are_not_changed_by_the_next():
    function = compile_reward(reward("x = torch.exp(a[:, 0])\ny = x * 2.0", result='y, {"x": x}'), VARIABLES, True)
    total, components = function(values(seed=1))
    copies = total.clone(), components["x"].clone()
    function(values(seed=2))
    assert torch.equal(total, copies[0])
    assert torch.equal(components["x"], copies[1])


def test_the_step_of_a_list_that_fails_on_a_state_is_the_functions_failure():
    body = "i = steps.unsqueeze(-1)\nx = torch.gather(a.repeat(1, 9), 1, i).squeeze(-1)"
    function = compile_reward(reward(body, arguments="a, steps"), VARIABLES, False)
    with pytest.raises(CodeError, match="torch says: index 27 is out of bounds") as error:
        function(values(28))
    assert error.value.check == "run"
