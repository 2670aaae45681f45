"""The contract is data: all that it lists can be used, and the prompt says what the checker enforces."""

import pytest
import torch

from code_cases import VARIABLES, compile_reward, reward, values
from porse.functions.contract import (
    ATTRIBUTES,
    FUNCTION_NAMES,
    HELPERS,
    MATH_NAMES,
    METHODS,
    TORCH_CONSTANTS,
    TORCH_FUNCTIONS,
    TORCH_MODULES,
)
from porse.functions.read.confine import Limits
from porse.functions.read.sandbox import Sandbox
from porse.functions.read.states import packed
from porse.functions.verdict import MAX_NAMES, CodeError
from porse.generation.conversations import contract_text
from porse.helpers import HELPERS_IN_SCOPE

CALLS = """
    F(a) | F(a, b) | F(a, dim=-1) | F(a, 1) | F([a, b]) | F([a, b], dim=-1) | F(a, b, dim=-1) | F(a > 0)
    F(a > 0, b > 0) | F(a, 0.5) | F(a, b, 0.5) | F(a, b, b) | F(a > 0, a, b) | F(a, [-1]) | F(a, [num_envs, 3]) | F(a, 1, -1) | F(a, [1, 0]) | F(a, 0, 1) | F(3)
    F([num_envs, 3], 0.5) | F(0.0, 1.0, 5) | F(a.t(), a) | F(a[0], a[1]) | F(a, a[0]) | F('ij,ij->i', a, b)
    F(a.unsqueeze(1), a.unsqueeze(2)) | F(torch.zeros(num_envs, 1, 1), a.unsqueeze(1), a.unsqueeze(2)) | F([1.0, 2.0])
    F(a, 1, torch.zeros_like(a).long()) | F(a, a > 0, 0.0) | F(a, 0, 0, 1) | F(a, 1, torch.tensor([0, 1]))
    F((a > 0).int(), (b > 0).int()) | F((a > 0).int()) | F(a, torch.zeros_like(a).long(), 1) | F(a, 1, [3, 1])
    F(a, 0.1, 0.2) | F([a.t(), a])
"""
METHOD_CALLS = """
    a.F() | a.F(b) | a.F(dim=-1) | a.F(1) | (a > 0).F() | a.F(0.5) | (a > 0).F(b > 0) | a.F(1, 0) | a.F(a > 0, 0.0)
    a.F([num_envs, 3]) | a.F(b, b) | a.t().F(a) | a[0].F(a[1]) | a.F(a[0]) | a.unsqueeze(1).F(a.unsqueeze(2)) | a.F(0, 1)
    a.F(1, torch.tensor([0, 1])) | a.F(1, torch.zeros_like(a).long()) | a.mean().F() | a.F(0, 0, 1) | a.F(b.dtype)
    a.F(b, 0.5) | a.F([num_envs, 3], 0.5) | a.clone().F(b) | a.clone().F() | a.clone().F(0.5) | a.clone().F(0, 1)
    a.clone().F(a > 0, 0.0) | [a].F(a) | {'z': a}.F() | {'z': a}.F('z') | [a].F([a]) | 'z'.F(1) | {'z': a}.F({'z': b})
    a.F(torch.zeros_like(a).long(), 1) | [a].F(0, a) | [a].F() | a.F(torch.zeros(num_envs, 3, 3))
    a.F(a.unsqueeze(1), a.unsqueeze(2)) | a[:, None].F(a.unsqueeze(2), a.unsqueeze(1)) | a.F(a > 0, b) | a.F(1, [3, 1]) | a.F([1, 0]) | 'z'.F() | 'z'.F('z') | 'z'.F('z', 'y')
"""


def patterns(text, prefix=""):
    """Returns the calls of a table, with `F` for the name."""
    return [
        call.strip().replace("F(", prefix + "F(", 1) for line in text.strip().split("\n") for call in line.split("|")
    ]


def usable(name, calls):
    """The first source with one of the calls that is accepted, runs and gives something that later lines can use, or ""."""
    for call in calls:
        source = reward(f"y = {call.replace('F', name, 1)}\nx = a[:, 0]\nprint(y)", arguments="a, b, num_envs")
        try:
            compile_reward(source, VARIABLES, portable=True)(values())
        except CodeError:
            continue
        return source
    return ""


def unusable(names, calls):
    return sorted(name for name in names if not usable(name, calls))


def test_every_torch_function_can_be_used():
    assert unusable(TORCH_FUNCTIONS, patterns(CALLS, "torch.")) == []


@pytest.mark.parametrize("module", ["linalg", "special", "nn.functional"])
def test_every_function_of_a_module_can_be_used(module):
    assert unusable(TORCH_MODULES[module], patterns(CALLS, f"torch.{module}.")) == []


def test_every_function_is_compiled_in_a_confined_process_too():
    """There no file can be read, and some of torch's functions are compiled from their sources."""
    calls = {f"torch.{name}": patterns(CALLS) for name in TORCH_FUNCTIONS}
    calls |= {
        f"torch.{m}.{n}": patterns(CALLS) for m in ("linalg", "special", "nn.functional") for n in TORCH_MODULES[m]
    }
    with Sandbox(Limits()) as sandbox:
        sandbox.prepare(packed(values()))
        found = {name: sandbox.judge(usable(name, forms), "reward")[0] for name, forms in sorted(calls.items())}
    assert [(name, verdict) for name, verdict in found.items() if verdict.check in ("static", "type")] == []


def test_every_method_and_attribute_can_be_used():
    assert unusable(METHODS - {"item"}, patterns(METHOD_CALLS)) == []  # it is refused with its reason
    assert unusable(ATTRIBUTES, ["a.F", "a.max(dim=-1).F"]) == []


def test_every_constant_and_scalar_function_can_be_used():
    assert unusable(MATH_NAMES, ["math.F(0.5)", "math.F", "math.F(0.5, 0.5)"]) == []
    assert unusable(TORCH_CONSTANTS, ["torch.F", "torch.zeros(3, dtype=torch.F)", "torch.F([1.0])"]) == []


def test_nothing_on_the_list_draws_random_numbers_or_reaches_outside():
    random = {"rand", "randn", "bernoulli", "normal", "dropout", "multinomial", "empty", "empty_like"}
    outside = {"save", "load", "from_file", "ops", "classes", "hub", "compile", "set_num_threads", "manual_seed"}
    assert not (TORCH_FUNCTIONS | METHODS | ATTRIBUTES) & (random | outside)
    assert all(hasattr(torch, name) for name in TORCH_FUNCTIONS)


@pytest.mark.parametrize("kind", ["reward", "mapping"])
def test_the_prompt_says_what_is_enforced(root, kind):
    text = contract_text(root / "prompts", kind)
    assert f"def {FUNCTION_NAMES[kind][0]}(" in text
    assert text.startswith("```python\n")
    assert "TorchScript" in text
    if kind == "mapping":
        assert all(line in text for line in HELPERS.values())
        assert f"1 to {MAX_NAMES}" in text


def test_every_helper_that_the_prompt_names_exists():
    assert HELPERS.keys() <= HELPERS_IN_SCOPE.keys()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["functions", "methods"])
def test_what_a_call_returns_cannot_be_used_to_change_its_arguments(kind):
    """A minute. Some operators return a view of an argument, or itself, and their schemas do not all say so."""
    names, calls = (
        (TORCH_FUNCTIONS, patterns(CALLS, "torch.")) if kind == "functions" else (METHODS, patterns(METHOD_CALLS))
    )
    tried, changed = 0, []
    for name in sorted(names):
        for call in calls:
            for write in ("y.zero_()", "y[0].zero_()", "y[0][0].zero_()"):
                source = reward(f"y = {call.replace('F', name, 1)}\n{write}\nx = a[:, 0]", arguments="a, b, num_envs")
                states = values()
                before = {key: states[key].clone() for key in "ab"}
                try:
                    compile_reward(source, VARIABLES, portable=True)(states)
                except CodeError:
                    continue
                tried += 1
                if not all(torch.equal(states[key], before[key]) for key in "ab"):
                    changed.append(call.replace("F", name, 1))
    assert tried > 300
    assert changed == []
