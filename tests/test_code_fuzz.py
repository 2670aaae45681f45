"""Fuzzing: whatever the text, there is a verdict; no crash, no hang, no other exception."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from code_attacks import ATTACKS
from code_cases import VARIABLES, compile_reward, lines_of, reward, values
from porse.functions.contract import METHODS, TORCH_FUNCTIONS
from porse.functions.read.confine import Limits
from porse.functions.read.extract import Source, extract
from porse.functions.read.sandbox import Sandbox
from porse.functions.read.states import packed
from porse.functions.verdict import CodeError

REPLIES = [path.read_bytes().decode() for path in sorted((Path(__file__).parent / "replies").glob("*.md"))]
KINDS = st.sampled_from(["reward", "mapping"])
SETTINGS = settings(derandomize=True, deadline=None, suppress_health_check=list(HealthCheck))

_PIECES = st.sampled_from(
    [
        *(
            "def compute_reward(a):",
            "    return a, {}",
            "class C:",
            "@x",
            "import torch",
            "T = 1",
            "    ",
            "lambda",
            "> ",
        ),
        *("```", "```python", '"""', "'''", "#", "(", ")", "[", "{", "}", ":", "=", "\\", "\t", "\r", "\n", "\x00"),
        *("\u202e", "é"),
    ]
)


def _is_useful(error, text):
    assert str(error)
    assert 0 <= error.line <= text.count("\n") + text.count("\r") + 1


def _extracts(reply, kind):
    """Extraction gives code whose lines are lines of the reply, or says why not."""
    try:
        found = extract(reply, kind)
    except CodeError as error:
        _is_useful(error, reply)
        return None
    assert isinstance(found, Source)
    assert all(1 <= line <= reply.count("\n") + reply.count("\r") + 1 for line in lines_of(found))
    return found.text


@SETTINGS
@given(st.one_of(st.text(), st.lists(_PIECES).map("".join), st.lists(_PIECES).map("\n".join)), KINDS)
def test_extraction_of_any_text(reply, kind):
    _extracts(reply, kind)


@SETTINGS
@given(st.data(), KINDS)
def test_extraction_and_compilation_of_damaged_replies(data, kind):
    """Replies cut, doubled, spliced and with letters changed."""
    first, second = (data.draw(st.sampled_from(REPLIES)) for _ in range(2))
    cut, start = data.draw(st.integers(0, len(first))), data.draw(st.integers(0, len(second)))
    reply = first[:cut] + data.draw(st.one_of(st.just(""), _PIECES, st.text(max_size=5))) + second[start:]
    source = _extracts(reply, kind)
    if source is not None:
        _compiles(source)


def _compiles(source):
    try:
        compile_reward(source, VARIABLES, portable=True)
    except CodeError as error:
        _is_useful(error, source)


_LEAVES = st.sampled_from(
    [
        *("a", "b", "q", "steps", "scale", "num_envs", "device", "self.a", "a[:, 0]", "a.shape[0]", "x", "math.pi"),
        *("0", "1", "-1", "2.5", "1e-3", "True", "None", "'k'", "...", "torch.float32", "[]", "{}", "()", "f'{scale}'"),
    ]
)


def _grow(inner):
    binary = st.sampled_from(
        ["+", "-", "*", "/", "**", "//", "%", "@", "&", "|", "<<", "<", "==", "and", "or", "in", "is"]
    )
    names = st.sampled_from(sorted(TORCH_FUNCTIONS))
    methods = st.sampled_from(sorted(METHODS))
    arguments = st.lists(inner, min_size=1, max_size=3).map(", ".join)
    return st.one_of(
        st.tuples(inner, binary, inner).map(lambda t: f"({t[0]} {t[1]} {t[2]})"),
        st.tuples(st.sampled_from(["-", "not ", "~", "+"]), inner).map(lambda t: f"({t[0]}{t[1]})"),
        st.tuples(names, arguments).map(lambda t: f"torch.{t[0]}({t[1]})"),
        st.tuples(inner, methods, arguments).map(lambda t: f"{t[0]}.{t[1]}({t[2]})"),
        st.tuples(inner, inner).map(lambda t: f"{t[0]}[{t[1]}]"),
        st.tuples(inner, inner, inner).map(lambda t: f"({t[0]} if {t[1]} else {t[2]})"),
        st.tuples(inner, inner).map(lambda t: f"[{t[0]} for y in {t[1]}]"),
        st.tuples(inner, inner, inner).map(lambda t: f"[{t[0]} for y, x in {t[1]} if {t[2]}]"),
        st.tuples(inner, inner, inner).map(lambda t: f"{{{t[0]}: y for y in {t[1]} for z in {t[2]}}}"),
        st.tuples(inner, inner).map(lambda t: f"sum(y * z for y, z in zip({t[0]}, ({t[1]}, 1)))"),
        st.tuples(inner, inner).map(lambda t: f"{{**{t[0]}, 'k': {t[1]}}}"),
        st.tuples(names, inner).map(lambda t: f"torch.{t[0]}(*{t[1]})"),
        arguments.map(lambda t: f"({t},)"),
        arguments.map(lambda t: f"[{t}]"),
        st.tuples(inner, inner).map(lambda t: f"{{{t[0]}: {t[1]}}}"),
    )


_EXPRESSIONS = st.recursive(_LEAVES, _grow, max_leaves=8)
_LINES = st.one_of(
    _EXPRESSIONS.map(lambda e: f"x = {e}"),
    _EXPRESSIONS.map(lambda e: f"x += {e}"),
    _EXPRESSIONS.map(lambda e: f"x[0] = {e}"),
    _EXPRESSIONS.map(lambda e: f"if {e}:\n    x = a[:, 1]"),
    _EXPRESSIONS.map(lambda e: f"for i in {e}:\n    x = x + 1"),
    _EXPRESSIONS.map(lambda e: f"k = 0\nfor i in {e}:\n    k += i"),
    _EXPRESSIONS.map(lambda e: f"k = []\nk.append({e})\nx = k"),
    _EXPRESSIONS.map(lambda e: f"x, y = zip(*{e})"),
    _EXPRESSIONS.map(lambda e: f"k, n = [], {{}}\ndef add(v, w=1):\n    k.append(v)\n    n[w] = v\nadd({e})"),
    _EXPRESSIONS.map(lambda e: f"y = {e}\nx = y(x)"),
    _EXPRESSIONS,
)


def _program(lines):
    return reward("x = a[:, 0]", *lines, arguments="self, a, b, q")


@settings(SETTINGS, max_examples=150)
@given(st.lists(_LINES, min_size=1, max_size=4))
def test_compilation_of_any_expression(lines):
    _compiles(_program(lines))


@pytest.fixture(scope="module")
def sandbox():
    with Sandbox(Limits(wall_s=2.0, cpu_s=2)) as running:
        running.prepare(packed(values()))
        yield running


@settings(SETTINGS, max_examples=40)
@given(st.one_of(st.lists(_LINES, min_size=1, max_size=3).map(_program), st.sampled_from(sorted(ATTACKS.values()))))
def test_a_verdict_on_any_program(sandbox, reply):
    verdict, source = sandbox.judge(reply, "reward")
    assert verdict.passed == (verdict.check == "ok") == bool(source)
    assert verdict.check != "crash"
    assert bool(verdict.message) != verdict.passed
