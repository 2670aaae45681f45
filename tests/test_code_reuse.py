"""Memory used again: never what somebody else reads, and never another bit."""

import pytest
import torch

from code_cases import VARIABLES, reward, values
from porse.code import compile as compiling
from porse.code.compile import compile_mapping, compile_reward
from porse.code.extract import extract
from porse.code.graph import nodes
from porse.code.reuse import ALONE, WITH_NUMBERS, reuse_memory
from porse.code.script import script
from porse.generation.grammar import mapping_text, reward_text
from porse.tasks import TASKS
from test_code_tasks import functions


def written(body, **more):
    """Returns the operators that write in place in the graph of a reward, once memory is used again."""
    graph = script(reward(body, **more), {variable.name: variable for variable in VARIABLES}).graph.copy()
    reuse_memory(graph)
    return [node.kind().removeprefix("aten::") for node in nodes(graph) if node.kind().endswith("_")]


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("x = torch.exp(-torch.norm(a - b, dim=-1) / 0.1)", ["neg_", "div_", "exp_"]),
        ("d = torch.norm(a, dim=-1)\nx = 1.0 + torch.clamp(d.cos(), max=0.5) * 3", ["cos_", "clamp_", "mul_", "add_"]),
        # An argument is not ours, nor is a view of it.
        ("x = torch.exp(a)[:, 0]", []),
        ("x = torch.exp(-a[:, 0])", []),
        # Who is read twice, whoever reads it, stays.
        ("d = torch.norm(a, dim=-1)\nx = torch.exp(d) + d", []),
        ("d = torch.exp(a)\nx = torch.cos(d)[:, 0] + d[:, 1]", []),
        ("d = torch.exp(a)\nv = d[:, 0]\nx = torch.exp(v) * v", []),
        # The shape may grow beside another tensor, and the type beside another number.
        ("x = torch.norm(a, dim=-1) * torch.norm(b, dim=-1)", []),
        ("x = torch.norm(a, dim=-1) * scale", []),
        ("x = torch.exp(steps * 2)", []),
        ("x = torch.exp(torch.exp(a[:, 0]).double())", []),
        # A branch or a loop may run it never, or twice.
        ("x = torch.exp(a[:, 0])\nfor i in range(2):\n    x = torch.cos(x)", []),
        ("x = torch.exp(a[:, 0])\nif bool(b.sum() > 0):\n    x = torch.cos(x)", []),
        # What somebody else has written in place may have another name.
        ("d = torch.exp(a[:, 0])\ne = d.mul_(2.0)\nx = torch.cos(e) + d", ["mul_"]),
    ],
)
def test_what_is_written_in_place(body, expected):
    assert written(body, arguments="a, b, steps, scale") == expected


@pytest.mark.parametrize("name", sorted(ALONE | WITH_NUMBERS))
def test_every_operator_that_may_write_in_place_does(name, monkeypatch):
    body = f"x = torch.{name}(torch.exp(a[:, 0]){'' if name in ALONE else ', 0.5'})"
    assert written(body) == [f"{name}_"]
    again, plain = with_and_without(compile_reward, reward(body), VARIABLES, monkeypatch)
    assert torch.equal(again(values())[0], plain(values())[0])


def tensors(result):
    """Returns the total and the components of a reward, or the progress variables of a mapping."""
    return [result[0], *result[1].values()] if isinstance(result[1], dict) else result[0]


def with_and_without(compile_function, source, variables, monkeypatch):
    again = compile_function(source, variables, True)
    with monkeypatch.context() as patch:
        patch.setattr(compiling, "reuse_memory", lambda graph: None)
        return again, compile_function(source, variables, True)


@pytest.mark.parametrize("task", ["Quadcopter", "SwingCup"])
def test_results_keep_their_bits_and_inputs_theirs(task, monkeypatch):
    variables, count = TASKS[task].VARIABLES, 0
    replies = [*functions(task, 20), *((reward_text(variables, seed), "reward") for seed in range(20))]
    for reply, kind in [*replies, *((mapping_text(variables, seed), "mapping") for seed in range(20))]:
        compile_function = compile_reward if kind == "reward" else compile_mapping
        source = extract(reply, kind).source
        again, plain = with_and_without(compile_function, source, variables, monkeypatch)
        count += str(again._script.graph).count("_(") != str(plain._script.graph).count("_(")
        for rows in (1, 1025):
            states = values(rows, variables, seed=rows)
            kept = {name: value.clone() for name, value in states.items() if isinstance(value, torch.Tensor)}
            for _ in range(2):
                torch.testing.assert_close(
                    tensors(again(states)), tensors(plain(states)), rtol=0, atol=0, equal_nan=True
                )
            assert all(torch.equal(states[name], value) for name, value in kept.items())
    assert count >= 20
