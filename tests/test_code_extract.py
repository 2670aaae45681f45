"""Extraction: which function of a reply is taken, what comes along, and the lines that it stood on."""

import pytest

from code_cases import lines_of
from porse.functions.read.extract import extract
from porse.functions.verdict import CodeError

PLAIN = "def compute_reward(a):\n    return a, {}\n"


def test_a_bare_function_is_its_own_source():
    found = extract(PLAIN, "reward")
    assert (found.text, found.main.name, found.main.lineno) == (PLAIN, "compute_reward", 1)


def test_lines_are_those_of_the_reply():
    found = extract(f"Here it is.\n\n```python\nimport torch\n{PLAIN}```\n", "reward")
    assert found.text == PLAIN
    assert (found.main.lineno, found.last_line) == (5, 6)


def test_decorators_imports_and_prose_stay_behind():
    reply = (
        "from typing import Dict\n\n    @torch.jit.script\n    def compute_reward(a):\n        return a, {}\n\nDone."
    )
    found = extract(reply, "reward")
    assert found.text == PLAIN
    assert (found.main.lineno, found.last_line) == (4, 5)


def test_windows_line_ends_and_tabs_are_made_plain():
    assert extract("def compute_reward(a):\r\n\treturn a, {}\r\n", "reward").text == PLAIN


def test_a_closing_bracket_at_the_margin_does_not_end_the_function():
    source = "def compute_reward(\n    a,\n):\n    x = [\n1, 2,\n]\n    return a, {}\n"
    assert extract(f"{source}\nAnd so on.", "reward").text == source


def test_text_in_triple_quotes_does_not_end_or_begin_a_function():
    source = 'def compute_reward(a):\n    """Text\ndef compute_reward(b):\n    """\n    return a, {}\n'
    assert extract(source, "reward").text == source


def test_quotes_beside_functions_hide_none():
    assert extract(f'An open """ in prose, or\n"""\n{PLAIN}"""\n', "reward").text == PLAIN


def test_comments_at_the_margin_do_not_end_the_function():
    source = "def compute_reward(a):\n    x = a\n# why\n    return x, {}\n"
    assert extract(source, "reward").text == source


def test_the_tree_has_the_lines_of_the_reply():
    reply = "class R:\n    def __init__(self, k=3.0):\n        self.x = [\n            k,\n        ]\n\nU = {\n    1: 2,\n}\n\n"
    found = extract(f"{reply}def compute_reward(self, a):\n    return a * self.x[0] * U[1], {{}}\n", "reward")
    assert [node.lineno for node in found.tree.body] == [2, 3, 7, 11]
    assert found.text.startswith("k = 3.0\nx = [k]\nU = {\n1: 2,\n}\n\ndef compute_reward")
    assert found.last_line == 12


def test_code_that_json_holds_is_on_the_line_of_its_object():
    found = extract('Here:\n\n{"code": "T = 2.0\\ndef compute_reward(a):\\n    return a * T, {}\\n"}', "reward")
    assert (lines_of(found), found.last_line) == ([3, 3, 3], 3)


def test_helpers_and_constants_come_along_when_they_are_read():
    reply = "T = 0.5\nU = 1.0\n\ndef unused(x):\n    return x\n\ndef h(x):\n    return x / T\n\ndef compute_reward(a):\n    return h(a), {}\n"
    found = extract(reply, "reward")
    assert found.text == "T = 0.5\n\ndef h(x):\n    return x / T\n\ndef compute_reward(a):\n    return h(a), {}\n"
    assert lines_of(found) == [1, 7, 8, 10, 11]


def test_constants_of_several_lines_come_along():
    reply = "(The weights\nW = {\n    'near': 1.0,  # most\n    'far': 0.5,\n}\nU = [\n    1,\n]\n\ndef compute_reward(a):\n    return W['far'] * a, {}\n"
    found = extract(reply, "reward")
    assert found.text.startswith("W = {\n'near': 1.0,  # most\n'far': 0.5,\n}\n\ndef compute_reward")
    assert lines_of(found) == [2, 10, 11]


def test_an_open_bracket_in_prose_swallows_nothing():
    reply = "Reward (see below:\nT = 0.5\n\ndef compute_reward(a):\n    return a / T, {}\n"
    assert extract(reply, "reward").text.startswith("T = 0.5\n")


def test_unusual_imports_come_along():
    reply = "import torch\nimport torch.nn.functional as fn\ndef compute_reward(a):\n    return fn.relu(a), {}\n"
    assert extract(reply, "reward").text.startswith("import torch.nn.functional as fn\n\ndef")


def test_unusual_imports_of_several_lines_come_along():
    reply = "from torch.nn.functional import (\n    relu,\n)\ndef compute_reward(a):\n    return relu(a), {}\n"
    assert extract(reply, "reward").text.startswith("from torch.nn.functional import (\nrelu,\n)\n\ndef")


@pytest.mark.parametrize(
    ("names", "chosen"),
    [
        (["compute_reward", "compute_reward_two"], "compute_reward"),
        (["reward_function", "helper"], "reward_function"),
        (["compute_kettle_reward"], "compute_kettle_reward"),
        (["shaped"], "shaped"),
    ],
)
def test_right_names_come_before_names_like_it_and_a_lone_function(names, chosen):
    reply = "\n".join(f"def {name}(a):\n    return a, {{}}\n" for name in names)
    assert extract(reply, "reward").main.name == chosen


def test_the_last_complete_function_wins():
    first, second = PLAIN, PLAIN.replace("{}", '{"x": a}')
    assert extract(f"```\n{first}```\nbetter:\n```\n{second}```", "reward").text == second
    assert extract(f"```\n{first}```\nor:\n```\ndef compute_reward(a):\n    return (a,", "reward").text == first


@pytest.mark.parametrize(
    ("reply", "check", "line", "says"),
    [
        ("", "extract", 0, "no function at all"),
        ("def mapping_function(self):\n    return self.a\n", "extract", 0, "found mapping_function"),
        ("text\n```\ndef compute_reward(a):\n    x = = a\n    return x\n```", "syntax", 4, "x = = a"),
        ("def compute_reward(a):\n    x = a\n", "return", 1, "returns nothing"),
        ("x" * 200_001, "extract", 0, "at most 200000"),
    ],
)
def test_a_reply_without_a_usable_function_says_why(reply, check, line, says):
    with pytest.raises(CodeError, match=says.replace("=", "=")) as error:
        extract(reply, "reward")
    assert (error.value.check, error.value.line) == (check, line)


# Python reads this, and 3.11 raises an error when it is to write it anew.
ODD = "f\"\"\"{\"'''\" '''x\n\"'''}\"\"\""


@pytest.mark.parametrize(
    "line",
    [
        "y = helper({odd}, a)", "y = {odd}.join(a)", "y = [{odd}]\n    y.append({odd})", "y, z = zip(*{odd})",
        "y = sorted({odd})", "y = map({odd}, a)",
    ],
)  # fmt: skip
def test_a_text_that_cannot_be_written_anew_does_no_harm(line):
    reply = f"class R:\n    def __init__(self):\n        {ODD}\n        self.x = {ODD}\n\ndef helper(self, a):\n    return a\n"
    reply += f"def compute_reward(a):\n    {line.format(odd=ODD)}\n    return a, {{}}\n"
    extract(reply, "reward")


def test_defaults_are_written_once_however_often_they_are_read():
    settings = "".join(f"        self.s{i} = [x, x, x, x]\n" for i in range(1000))
    reply = f"class R:\n    def __init__(self, x=[{'1, ' * 1000}]):\n{settings}\n"
    reply += "def compute_reward(a):\n    r = R()\n    return a * r.s7, {}\n"
    found = extract(reply, "reward").text
    assert found.startswith(f"x = [{', '.join('1' * 1000)}]\ns7 = [x, x, x, x]\n\ndef compute_reward")
