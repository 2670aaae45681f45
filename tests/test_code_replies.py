"""The corpus: every reply in tests/replies gets the verdict that its entry in index.json names."""

import json
from collections import Counter
from pathlib import Path

import pytest

from porse.code.contract import FUNCTION_NAMES
from porse.code.limits import Limits
from porse.code.sandbox import Sandbox
from porse.code.validate import Submission, judge

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
    variables = sandbox.prepare({"task": task, "root": "."})
    wrong = []
    for entry in (entry for entry in INDEX if entry["task"] == task):
        reply = (REPLIES / entry["file"]).read_bytes().decode()
        verdict, source = judge(Submission(reply, entry["kind"]), variables, sandbox)
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
    variables = sandbox.prepare({"task": "Quadcopter", "root": "."})
    entries = [entry for entry in INDEX if entry["task"] == "Quadcopter" and entry["check"] == "ok"]
    for entry in entries[::5]:
        reply = (REPLIES / entry["file"]).read_bytes().decode()
        first, source = judge(Submission(reply, entry["kind"]), variables, sandbox)
        again, stored = judge(Submission(source, entry["kind"]), variables, sandbox)
        assert (again, stored) == (first, source), entry["file"]
