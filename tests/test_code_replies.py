"""The corpus: every reply in tests/replies gets the verdict that its entry in index.json names."""

import ast
import json
import math
import typing
from collections import Counter
from pathlib import Path
from types import MethodType, SimpleNamespace

import numpy as np
import pytest
import torch

from code_cases import compile_mapping, compile_reward
from porse.functions.contract import FUNCTION_NAMES
from porse.functions.read.confine import Limits
from porse.functions.read.extract import extract
from porse.functions.read.sandbox import Sandbox
from porse.sim import rotations
from porse.tasks import make_task

REPLIES = Path(__file__).parent / "replies"
INDEX = json.loads((REPLIES / "index.json").read_text())
TASKS = sorted({entry["task"] for entry in INDEX})


@pytest.fixture(scope="module")
def sandbox():
    with Sandbox(Limits(), "porse.task_probe") as running:
        yield running


def test_every_file_has_one_entry():
    assert Counter(entry["file"] for entry in INDEX) == Counter(path.name for path in REPLIES.glob("*.md"))


def test_the_corpus_is_large_enough_and_has_both_kinds_of_both():
    assert len(INDEX) >= 60
    kinds = Counter((entry["kind"], entry["check"] == "ok") for entry in INDEX)
    assert min(kinds[kind, good] for kind in FUNCTION_NAMES for good in (True, False)) >= 5


@pytest.mark.parametrize("task", TASKS)
def test_replies_get_their_verdicts(sandbox, task):
    sandbox.prepare({"task": task, "root": "."})
    wrong = []
    for entry in (entry for entry in INDEX if entry["task"] == task):
        reply = (REPLIES / entry["file"]).read_bytes().decode()
        verdict, source = sandbox.judge(reply, entry["kind"])
        if entry["check"] == "ok":
            right = verdict.passed and source
            right = right and (list(verdict.names), list(verdict.rises)) == (entry["names"], entry["rises"])
        else:
            right = not verdict.passed and not source
            right = right and (verdict.check, verdict.line) == (entry["check"], entry["line"])
            right = right and all(text in verdict.message for text in entry["says"])
        if not right:
            wrong.append((entry, verdict))
    assert not wrong


def test_the_stored_source_gets_the_same_verdict_as_the_reply(sandbox):
    """What a candidate keeps is what was judged: judging it again changes nothing, not even the source."""
    sandbox.prepare({"task": "Quadcopter", "root": "."})
    entries = [entry for entry in INDEX if entry["task"] == "Quadcopter" and entry["check"] == "ok"]
    for entry in entries[::5]:
        reply = (REPLIES / entry["file"]).read_bytes().decode()
        first, source = sandbox.judge(reply, entry["kind"])
        again, stored = sandbox.judge(source, entry["kind"])
        assert (again, stored) == (first, source), entry["file"]


HELPERS = {
    "dist": lambda a, b: torch.norm(a - b, dim=-1),
    "rot_dist": rotations.rotation_distance,
    "quat_conjugate": rotations.conjugate,
    "quat_mul": rotations.multiply,
    "quat_rotate_inverse": rotations.rotate_inverse,
}


def in_python(source, states):
    """Returns what a stored source of the corpus, which is our own, returns when Python runs it on copies of states."""
    given = {name: value.clone() if isinstance(value, torch.Tensor) else value for name, value in states.items()}
    space = {**vars(typing), **HELPERS, **given, "torch": torch, "math": math, "np": np, "F": torch.nn.functional}
    exec(f"from __future__ import annotations\nfrom torch import Tensor\n{source}", space)
    functions = [node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef)]
    holder = SimpleNamespace(**space)
    for node in functions:
        if node.args.args and node.args.args[0].arg == "self":
            setattr(holder, node.name, MethodType(space[node.name], holder))
    main = functions[-1]
    arguments = {a.arg: given[a.arg] for a in [*main.args.args, *main.args.kwonlyargs] if a.arg in given}
    return getattr(holder, main.name)(**arguments)


@pytest.mark.parametrize("task", TASKS)
def test_good_replies_mean_what_they_mean_in_python(task):
    made = make_task(task, 8, seed=0)
    states = made.variables()
    # A dictionary in a set; a class, of which the source keeps the constants and functions alone.
    not_python = {"reward_fstring_debris.md", "reward_class_with_defaults.md"}
    for entry in INDEX:
        if entry["task"] != task or entry["check"] != "ok" or entry["file"] in not_python:
            continue
        source = extract((REPLIES / entry["file"]).read_bytes().decode(), entry["kind"]).text
        first, second, *_ = in_python(source, states)
        if entry["kind"] == "reward":
            total, components = compile_reward(source, made.VARIABLES, False, states)(states)
            expected, found = [first, *second.values()], [total, *components.values()]
        else:
            found, rises, _ = compile_mapping(source, made.VARIABLES, False, states)(states)
            expected = list(first) if isinstance(first, list | tuple) else [first]
            assert rises == (list(second) if isinstance(second, list | tuple) else [second])
        assert len(found) == len(expected)
        for ours, theirs in zip(found, expected, strict=True):
            torch.testing.assert_close(ours, theirs.float().expand(8), rtol=1e-5, atol=1e-5, msg=entry["file"])
