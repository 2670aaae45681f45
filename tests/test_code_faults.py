"""Faults that were found in functions that had been accepted, or refused without a reason, each with its kind."""

import json
import time

import pytest
import torch

from code_cases import VARIABLES, RewardFunction, compile_mapping, compile_reward, lines_of, reward, traced, values
from porse.functions.read.confine import Limits
from porse.functions.read.extract import extract
from porse.functions.read.sandbox import Sandbox
from porse.functions.read.states import packed
from porse.functions.verdict import CodeError


@pytest.fixture(scope="module")
def sandbox():
    with Sandbox(Limits()) as running:
        running.prepare(packed(values()))
        yield running


def verdict(sandbox, *body, kind="reward", **more):
    return sandbox.judge(reward(*body, **more), kind)[0]


@pytest.mark.parametrize(
    "line", ["i // j", "i % j", "torch.fmod(i, j)", "torch.div(i, j, rounding_mode='trunc')", "i // -1", "i // 0"]
)
def test_a_division_of_whole_numbers_that_may_trap_is_refused(sandbox, line):
    found = verdict(sandbox, f"i = steps - 2**20\nj = steps + 1\nx = a[:, 0] + ({line})", arguments="a, steps")
    assert found.check == "static"
    assert "divides whole numbers by what may be 0 or -1" in found.message


def test_other_divisions_are_not(sandbox):
    body = "x = a[:, 0] + steps // 2 + steps % 3 + steps / (steps + 1) + (steps * 1.0) // (steps + 0.5)"
    assert verdict(sandbox, body, arguments="a, steps").passed


@pytest.mark.parametrize("line", ["a[steps > 3]", "torch.where(steps > 3)[0]", "a[a > 0]", "torch.zeros(int(a.sum()))"])
def test_sizes_from_data_are_refused(sandbox, line):
    found = verdict(sandbox, f"y = {line}\nx = a[:, 0] + (y * 1.0).sum()", arguments="a, steps")
    assert found.check == "static"
    assert "not allowed" in found.message


def test_a_mask_that_is_written_through_keeps_its_size_and_means_what_it_does_in_python(sandbox):
    body = "x = a[:, 0].clone()\nx[b[:, 0] > 0] += 2.0\ny = a.clone()\ny[b[:, 0] > 0] *= torch.tensor([1.0, 2.0, 3.0])\nx = x + y[:, 2]"
    assert verdict(sandbox, body).passed
    states = values(5, seed=4)
    mask = states["b"][:, 0] > 0
    expected = states["a"][:, 0] + 2.0 * mask + torch.where(mask, 3.0, 1.0) * states["a"][:, 2]
    torch.testing.assert_close(compile_reward(reward(body), VARIABLES, False)(states)[0], expected)


def test_and_or_mean_what_they_mean_in_python():
    total, _ = compile_reward(reward("x = a[:, 0] * 0 + (0 or 2) + 10 * (3 and 2)"), VARIABLES, False)(values())
    assert total.tolist() == [22.0] * 16


@pytest.mark.parametrize(
    ("head", "body"),
    [
        ("CALLS = []\n", "CALLS.append(1)\nx = a[:, 0] * len(CALLS)"),
        ("W = {'n': 1.0}\n", "W['n'] = W['n'] * 2\nx = a[:, 0] * W['n']"),
        ("W = torch.ones(3)\n", "W.mul_(2.0)\nx = (a * W).sum(-1)"),
        ("W = torch.ones(3)\n", "W[0] = 2.0\nx = (a * W).sum(-1)"),
        ("def h(y, n=[0]):\n    n[0] += 1\n    return y * n[0]\n", "x = h(a[:, 0])"),
    ],
)
def test_what_is_kept_from_call_to_call_is_refused(sandbox, head, body):
    found, _ = sandbox.judge(head + reward(body), "reward")
    assert not found.passed
    assert (
        "keeps something from one call to the next" in found.message
        or "a constant beside the function" in found.message
    )


def test_break_and_continue_are_pythons():
    body = "x = a[:, 0] * 0\nfor i in range(5):\n    if i == 1:\n        continue\n    if i == 4:\n        break\n    x = x + i"
    assert compile_reward(reward(body), VARIABLES, False)(values())[0].tolist() == [5.0] * 16


@pytest.mark.parametrize(
    "line",
    [
        "torch.arange(num_envs) * 1.0", "torch.arange(num_envs) + 0 * a[:, 0]", "torch.ones_like(a[:, 0])", "a[:, 0] - a[:, 0]",
        "torch.full((num_envs,), 2.0)", "(a > 99).float().new_zeros(num_envs)",
    ],
)  # fmt: skip
@pytest.mark.parametrize("kind", ["reward", "mapping"])
def test_what_no_variable_changes_is_constant(sandbox, line, kind):
    source = reward(f"x = {line}", arguments="a, num_envs")
    if kind == "mapping":
        source = f"def mapping_function(a, num_envs):\n    return [{line}], [True], ['x']\n"
    found, _ = sandbox.judge(source, kind)
    assert found.check == "constant"
    assert "the same number in all states" in found.message or "reads no state" in found.message


@pytest.mark.parametrize(
    "line", ["(torch.norm(a - b, dim=-1) < 1e-6).float()", "(a[:, 0] > 1e7) * 1.0", "torch.clamp(a[:, 2], min=1e7)"]
)
def test_an_indicator_that_no_probe_state_meets_is_not(sandbox, line):
    assert verdict(sandbox, f"x = {line}").passed


def test_an_accident_of_shapes_that_mixes_environments_is_refused(sandbox):
    found = verdict(sandbox, "d = a[:, 0:1] - b[:, 0]\nx = torch.exp(-d).mean(dim=-1)")
    assert found.check == "shape"
    assert "every pair of environments" in found.message


def test_a_statistic_over_the_environments_is_a_warning(sandbox):
    found = verdict(sandbox, "x = a[:, 0]\nx = (x - x.mean()) / (x.std() + 1e-6)")
    assert found.passed
    assert "depends on the other environments" in found.warning
    assert verdict(sandbox, "x = a[:, 0] - b[:, 0]").warning == ""


def test_the_directions_of_a_mapping_are_constants(sandbox):
    source = "def mapping_function(self):\n    return [self.a[:, 0]], [bool(self.a.mean() > 0)], ['x']\n"
    found, _ = sandbox.judge(source, "mapping")
    assert (found.check, found.line) == ("static", 2)
    assert "branch on the values" in found.message


@pytest.mark.parametrize("line", ["1e37 * a[:, 0]", "1e9 * a[:, 0]"])
def test_values_that_no_policy_can_learn_from_are_refused(sandbox, line):
    found = verdict(sandbox, f"x = {line}")
    assert found.check == "large"
    assert "at most 1e+08" in found.message
    assert verdict(sandbox, "x = 1e6 * a[:, 0]").passed


@pytest.mark.parametrize(
    "text", ["(" * 195_000, "def compute_reward(a):\n    x = " + "[" * 190_000, "[{(" * 65_000, "def f(\n" * 27_000]
)
def test_brackets_without_end_are_refused_in_time(sandbox, text):
    started = time.perf_counter()
    found, _ = sandbox.judge(text, "reward")
    assert found.check in ("extract", "syntax", "time")
    assert time.perf_counter() - started < 12.0


GOOD = "def compute_reward(a):\n    return a[:, 0], {'x': a[:, 0]}\n"
DRAFT = "def compute_reward(a):\n    return a[:, 1], {'draft': a[:, 1]}\n"


@pytest.mark.parametrize(
    "reply",
    [
        f"<think>\n```python\n{DRAFT}```\nor so\n</think>\n```python\n{GOOD}```\n",
        f"<think>\n```python\n{DRAFT.splitlines()[0]}\n    y = (\n</think>\n```python\n{GOOD}```\n",
        f"```python\n{DRAFT}```\n</think>\n```python\n{GOOD}```\n",
        f"```python\n{GOOD}```\n<think>\nwas that right?\n```python\n{DRAFT}```\n",
        f"<thinking>\n{DRAFT}\n</thinking>\n{GOOD}",
        f"<think>\na\n</think>\n<think>\n```\n{DRAFT}```\n</think>\n```\n{GOOD}```",
    ],
)
def test_thinking_is_dropped_closed_or_not(reply):
    found = extract(reply, "reward")
    assert found.text == GOOD
    lines = reply.split("\n")
    assert [lines[number - 1] for number in lines_of(found)] == GOOD.splitlines()


def test_thinking_alone_holds_no_function():
    with pytest.raises(CodeError, match="no function at all"):
        extract(f"<think>\n```python\n{DRAFT}```\n", "reward")


@pytest.mark.parametrize(
    "reply",
    [
        f"<pre><code>{GOOD}</code></pre>",
        f'<p>Here:</p>\n<pre><code class="language-python">\n{GOOD}</code></pre>\n<p>Done.</p>',
        json.dumps({"thoughts": "a reward", "code": GOOD}),
        "```json\n" + json.dumps({"reward": GOOD}, indent=1) + "\n```",
        GOOD,
    ],
)
def test_code_in_html_and_in_json_is_read(reply):
    assert extract(reply, "reward").text == GOOD


def test_an_escaped_ampersand_alone_is_read():
    reply = "def compute_reward(a):\n    x = ((a[:, 0] == 1) &amp; (a[:, 1] == 2)).float()\n    return x, {'x': x}\n"
    assert "== 1) & (a" in extract(reply, "reward").text


def test_half_conj_and_numbers_in_names():
    body = "x = torch.conj(a[:, 0].half()).float() + a[:, 1].to(torch.float16).conj()\nc = {f'r_{0.1}': x, f'w_{2:.2f}': x}"
    function = compile_reward(reward(body, result="x, c"), VARIABLES, True)
    assert list(function(values())[1]) == ["r_0_1", "w_2_00"]


def test_a_number_taken_out_of_a_tensor_is_refused_at_its_line():
    with pytest.raises(CodeError, match=r"\.item\(\), float, int") as error:
        compile_reward(reward("y = a.mean()", "x = a[:, 0] * y.item()"), VARIABLES, False)
    assert (error.value.check, error.value.line) == ("static", 3)


def test_a_mapping_reads_rows_of_lists():
    source = "def mapping_function(self):\n    rows = [(self.a[:, i], i == 0, f'a_{i}') for i in range(3)]\n    return tuple(zip(*rows))\n"
    function = compile_mapping(source, VARIABLES, False)
    assert (function.names, function.rises) == (("a_0", "a_1", "a_2"), (True, False, False))


def test_the_order_of_a_set_is_that_of_its_source(sandbox):
    """0.3 (0.3 (0.3 a + 7) + 5) + 2: another order is another number; what a set holds twice, it holds once."""
    body = reward("y = a[:, 0]", "for v in {W, V, U, W}:\n    y = y * 0.3 + v", result='y, {"y": y}')
    reply = f"W = torch.tensor([7.0])\nV = torch.tensor([5.0])\nU = torch.tensor([2.0])\n\n{body}"
    verdict, _ = sandbox.judge(reply, "reward")
    assert verdict.passed, verdict
    total, _ = RewardFunction(verdict.program, True)(values())
    torch.testing.assert_close(total, 0.3 * (0.3 * (0.3 * values()["a"][:, 0] + 7.0) + 5.0) + 2.0)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("y = {'near': 1.0}[torch.exp]", "KeyError of builtin_function_or_method"),
        ("y = {'near': 1.0}[x]", "KeyError of one tensor"),
        ("y = {'near': 1.0}['far']", "'far'"),
        ("y = [1.0][3]", "list index out of range"),
    ],
)
def test_an_error_says_the_same_in_every_process(sandbox, line, said):
    found = sandbox.judge(reward("x = a[:, 0]", line), "reward")[0]
    assert (found.check, found.line, found.message) == ("run", 3, f"Python says: {said}")


def test_an_error_may_be_raised_with_a_text(sandbox):
    guard = "if a.shape[1] != {0}:\n    raise ValueError('expected {0} columns')"
    assert sandbox.judge(reward("x = a[:, 0]", guard.format(3)), "reward")[0].passed
    found = sandbox.judge(reward("x = a[:, 0]", guard.format(2)), "reward")[0]
    assert (found.check, found.message) == ("run", "Python says: expected 2 columns")


def test_texts_are_filled_with_values():
    source = reward(
        "x = a[:, 0]",
        "k = '{}_{:.1f}'.format('near', 0.25)",
        "m = 'at_%d' % 3",
        "s = str(2) + f'{1.5:g}'",
        result="x, {k: x, m: x, s: x}",
    )
    assert traced(source, "reward", VARIABLES).names == ("near_0_2", "at_3", "21_5")


def test_getattr_leads_to_what_may_be_written_after_a_dot(sandbox):
    lines = ("x = getattr(self, 'a')[:, 0]", "x = getattr(x.abs(), 'square')()")
    assert sandbox.judge(reward(*lines, arguments="self"), "reward")[0].passed


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("'gi_' + 'frame'", "expected a variable of self or a method that is offered, found .gi_frame of a generator"),
        ("'nu' + 'mpy'", "expected a variable of self or a method that is offered, found .numpy of a generator"),
        ("torch.exp", "a builtin_function_or_method has no text of its own; write its name out"),
    ],
)
def test_getattr_leads_to_nothing_else(sandbox, name, found):
    verdict = sandbox.judge(reward("g = (k for k in range(2))", f"y = getattr(g, {name})", "x = a[:, 0]"), "reward")[0]
    assert (verdict.check, verdict.line, verdict.message) == ("static", 3, found)


def test_self_has_no_methods_of_what_stands_for_it(sandbox):
    verdict = sandbox.judge(reward("y = getattr(self, 'cop' + 'y')", "x = self.a[:, 0]", arguments="self"), "reward")[0]
    assert (verdict.check, verdict.message.rpartition("found ")[2]) == ("static", ".copy of self")
