"""Frozen and batch mode: what a stage gets, and what it is told when a reply is missing."""

import dataclasses
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from porse.errors import CacheError, CacheMiss, ParamsError, RepliesPending
from porse.llm.ask import ask
from porse.llm.nearest import differences_between
from porse.llm.record import Record
from porse.llm.request import Message
from porse.llm.store import Store
from tests.llm_cases import ANSWER, PROVENANCE, REQUEST, new_store, params, questions, record, request


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return new_store(tmp_path)


@pytest.fixture(autouse=True)
def frozen(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in list(os.environ):
        if name.startswith("PORSE_LLM_"):
            monkeypatch.delenv(name)


def pending_keys(store: Store) -> set[str]:
    return {path.stem for path in (store.state_dir / "pending").glob("*.json")}


def test_replies_come_in_the_order_of_the_questions(store: Store) -> None:
    store.write_all([record(f"text {k}", sample=k) for k in range(5)])
    asked = questions(5)[::-1]
    replies = ask(asked, params(), store.cache_dir)
    assert [reply.text for reply in replies] == ["text 4", "text 3", "text 2", "text 1", "text 0"]
    assert [reply.key for reply in replies] == [question.request.key for question in asked]


def test_a_reply_holds_what_was_recorded(store: Store) -> None:
    store.write(Record(request(), ANSWER, PROVENANCE))
    (reply,) = ask(questions(1), params(), store.cache_dir)
    assert reply.text == ANSWER.text
    assert (reply.prompt_tokens, reply.completion_tokens) == (1000, 200)
    assert reply.answered_by == "test-model-2026-01-01"
    assert reply.cost_usd == pytest.approx(0.004)


def test_a_later_change_of_prices_does_not_change_the_cost(store: Store) -> None:
    store.write(Record(request(), ANSWER, PROVENANCE))
    dear = params(usd_per_million_prompt_tokens=99.0, usd_per_million_completion_tokens=99.0)
    (reply,) = ask(questions(1), dear, store.cache_dir)
    assert reply.cost_usd == pytest.approx(0.004)


def test_uncounted_tokens_cost_nothing(store: Store) -> None:
    answer = dataclasses.replace(ANSWER, prompt_tokens=None, completion_tokens=None)
    store.write(Record(request(), answer, PROVENANCE))
    (reply,) = ask(questions(1), params(), store.cache_dir)
    assert (reply.prompt_tokens, reply.completion_tokens, reply.cost_usd) == (0, 0, 0.0)


def test_no_questions_no_replies(store: Store) -> None:
    assert ask([], params(), store.cache_dir) == []


def test_the_same_question_twice_has_the_same_reply(store: Store) -> None:
    store.write(record())
    one, two = ask([*questions(1), *questions(1)], params(), store.cache_dir)
    assert one == two


def test_a_truncated_reply_is_replaced_by_its_longer_one(store: Store) -> None:
    store.write(record("cut", "length"))
    store.write(record("whole", max_tokens=200))
    (reply,) = ask(questions(1), params(), store.cache_dir)
    assert (reply.text, reply.finish_reason, reply.key) == ("whole", "stop", request(max_tokens=200).key)
    assert (reply.prompt_tokens, reply.completion_tokens) == (2000, 400)
    assert reply.cost_usd == pytest.approx(0.008)


def test_a_reply_is_repaired_once_only(store: Store) -> None:
    store.write(record("cut", "length"))
    store.write(record("cut again", "length", max_tokens=200))
    (reply,) = ask(questions(1), params(), store.cache_dir)
    assert (reply.text, reply.finish_reason) == ("cut again", "length")


def test_miss_counts_all_and_names_the_first(store: Store) -> None:
    store.write(record(sample=1))
    with pytest.raises(CacheMiss) as caught:
        ask(questions(8), params(), store.cache_dir)
    text = str(caught.value)
    assert "found none for 7" in text
    assert f"{request(sample=0).key} (generate, iteration 1, reward 1)" in text
    assert "and 2 more" in text
    assert text.count("(generate, iteration 1, reward") == 5
    assert request(sample=1).key not in text.split("nearest")[0]
    # Keys and commands are on lines of their own, to be copied.
    assert text.splitlines()[1:7] == [
        *(f"  {request(sample=k).key} (generate, iteration 1, reward {k + 1})" for k in (0, 2, 3, 4, 5)),
        "  and 2 more",
    ]


def test_miss_shows_the_nearest_record_field_by_field(store: Store) -> None:
    store.write(record(temperature=0.7, max_tokens=50))
    store.write(record(model="other", temperature=2.0, messages=(Message("user", "Something else."),), sample=9))
    with pytest.raises(CacheMiss) as caught:
        ask(questions(1), params(), store.cache_dir)
    nearest = request(temperature=0.7, max_tokens=50).key[:12]
    assert f"nearest recorded request to the first is {nearest} (generate, iteration 2, reward 3)" in str(caught.value)
    assert "temperature: asked 0.5, recorded 0.7; max_tokens: asked 100, recorded 50." in str(caught.value)


def test_miss_shows_the_first_difference_of_a_text(store: Store) -> None:
    long = "x" * 200
    store.write(record(messages=(Message("user", f"one\n{long} two\nthree"),)))
    asked = questions(1, messages=(Message("user", f"one\n{long} 2\nthree"),))
    with pytest.raises(
        CacheMiss, match=r"messages\[0\].content: first at line 2, asked '\.\.\.x+ 2', recorded .* two'"
    ):
        ask(asked, params(), store.cache_dir)


def test_miss_shows_a_dialect_that_differs(store: Store) -> None:
    store.write(record(temperature=None, limit="max_completion_tokens", extra={"reasoning_effort": "low"}))
    for _ in range(2):  # from the files, then from the index
        with pytest.raises(CacheMiss) as caught:
            ask(questions(1), params(), store.cache_dir)
        assert (
            "differs in: temperature: asked 0.5, recorded None; limit: asked 'max_tokens', recorded "
            "'max_completion_tokens'; extra: asked {}, recorded {'reasoning_effort': 'low'}."
        ) in str(caught.value)


def test_miss_without_any_record(store: Store) -> None:
    with pytest.raises(CacheMiss, match="holds no other record"):
        ask(questions(1), params(), store.cache_dir)


def test_miss_of_the_longer_reply_names_that_request(store: Store) -> None:
    store.write(record("cut", "length"))
    with pytest.raises(CacheMiss, match=request(max_tokens=200).key):
        ask(questions(1), params(), store.cache_dir)


def test_miss_says_what_to_run_with_an_endpoint(store: Store) -> None:
    with pytest.raises(CacheMiss, match=r"(?m)^  MY_KEY=\.\.\. PORSE_LLM_MODE=record porse repro$"):
        ask(questions(1), params("http://somewhere/v1", key_variable="MY_KEY"), store.cache_dir)


def test_miss_says_what_to_run_without_an_endpoint(store: Store) -> None:
    with pytest.raises(
        CacheMiss, match=r"(?m)^  PORSE_LLM_MODE=batch porse repro\n  porse llm export requests\.jsonl$"
    ):
        ask(questions(1), params(), store.cache_dir)


def test_an_edited_record_is_an_error_and_no_miss(store: Store) -> None:
    store.write(record("as said"))
    path = store.path(REQUEST.key)
    path.write_bytes(path.read_bytes().replace(b"as said", b"as sung"))
    with pytest.raises(CacheError, match="edited") as caught:
        ask(questions(1), params(), store.cache_dir)
    assert not isinstance(caught.value, CacheMiss)


def test_unknown_mode_is_named(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PORSE_LLM_MODE", "live")
    with pytest.raises(ParamsError, match="frozen, record, batch or unset, found 'live'"):
        ask([], params(), store.cache_dir)


def test_batch_writes_all_open_requests(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PORSE_LLM_MODE", "batch")
    store.write(record(sample=1))
    with pytest.raises(
        RepliesPending, match=r"(?s)none for 2:\n.*\n  porse llm export .*\n  porse llm import .*\n  .*porse repro$"
    ):
        ask(questions(3), params(), store.cache_dir)
    assert pending_keys(store) == {request(sample=0).key, request(sample=2).key}
    assert [path.name for path in store.cache_dir.iterdir()] == [request(sample=1).key[:2]]


def test_batch_forgets_what_is_answered(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PORSE_LLM_MODE", "batch")
    with pytest.raises(RepliesPending):
        ask(questions(2), params(), store.cache_dir)
    store.write_all([record(sample=k) for k in range(2)])
    assert len(ask(questions(2), params(), store.cache_dir)) == 2
    assert pending_keys(store) == set()


def test_batch_asks_for_the_longer_reply(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PORSE_LLM_MODE", "batch")
    store.write(record("cut", "length"))
    with pytest.raises(RepliesPending):
        ask(questions(1), params(), store.cache_dir)
    assert pending_keys(store) == {request(max_tokens=200).key}


def test_record_mode_without_an_endpoint_says_what_to_do(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PORSE_LLM_MODE", "record")
    with pytest.raises(ParamsError, match=r"profile 'local' .* has no base_url.*PORSE_LLM_MODE=batch"):
        ask(questions(1), params(), store.cache_dir)


def test_differences_of_equal_requests() -> None:
    assert differences_between(REQUEST, request()) == []


def test_differences_in_messages() -> None:
    changed = request(messages=(Message("user", "You write rewards."),))
    assert differences_between(REQUEST, changed) == [
        "messages: asked 2, recorded 1",
        "messages[0].role: asked 'system', recorded 'user'",
        "messages[0].content: first at line 2, asked 'Torch only.', recorded the end (2 and 1 lines)",
    ]


GUARDED_REPLAY = """
import os, sys
from pathlib import Path

def refuse(event, arguments):
    if event.startswith("socket."):
        raise SystemExit(f"network: {event} {arguments}")
    if event == "open" and isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
        raise SystemExit(f"write: {arguments}")
    if event in ("os.mkdir", "os.rename", "os.remove", "os.link", "os.truncate", "os.chmod", "sqlite3.connect"):
        raise SystemExit(f"change: {event} {arguments}")

from tests.llm_cases import params, questions
import porse.llm.ask
sys.addaudithook(refuse)
replies = porse.llm.ask.ask(questions(3), params("http://endpoint.invalid/v1"), Path(sys.argv[1]))
assert "httpx2" not in sys.modules and "torch" not in sys.modules and "mujoco" not in sys.modules
sys.stdout.write("".join(reply.text for reply in replies))
"""

READ_ONLY_REPLAY = """
import os, sys
from pathlib import Path
from tests.llm_cases import params, questions
from porse.errors import CacheMiss
from porse.llm.ask import ask
import json.encoder, difflib
if os.geteuid() == 0:
    # Permissions do not bind the administrator.
    os.setgid(65534)
    os.setuid(65534)
cache = Path(sys.argv[1])
try:
    (cache.parent / "probe").write_text("")
except PermissionError:
    pass
else:
    raise SystemExit("the checkout can be written")
sys.stdout.write("".join(reply.text for reply in ask(questions(3), params(), cache)))
try:
    ask(questions(4), params(), cache)
except CacheMiss as error:
    assert "sample: asked 3, recorded" in str(error), error
else:
    raise SystemExit("no miss")
"""


def run_child(script: str, cache_dir: Path) -> str:
    root = Path(__file__).parents[1]
    command = [sys.executable, "-c", script, str(cache_dir)]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def open_directory() -> Iterator[Path]:
    """A directory that every user can reach, which pytest's own are not."""
    directory = Path(tempfile.mkdtemp())
    directory.chmod(0o755)
    yield directory
    for path in [directory, *directory.rglob("*")]:
        path.chmod(0o755)
    shutil.rmtree(directory)


def test_frozen_mode_opens_no_socket_and_writes_nothing(store: Store) -> None:
    store.write_all([record(f"text {k}, ", sample=k) for k in range(3)])
    assert run_child(GUARDED_REPLAY, store.cache_dir) == "text 0, text 1, text 2, "


def test_frozen_mode_replays_from_a_read_only_checkout(open_directory: Path) -> None:
    store = new_store(open_directory)
    store.write_all([record(f"text {k}, ", sample=k) for k in range(3)])
    shutil.rmtree(store.state_dir)
    for path in [*open_directory.rglob("*"), open_directory]:
        path.chmod(0o555 if path.is_dir() else 0o444)
    assert run_child(READ_ONLY_REPLAY, store.cache_dir) == "text 0, text 1, text 2, "
    assert [path.name for path in open_directory.iterdir()] == ["llm_cache"]


def test_pending_file_is_readable(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PORSE_LLM_MODE", "batch")
    with pytest.raises(RepliesPending):
        ask(questions(1), params(), store.cache_dir)
    (path,) = (store.state_dir / "pending").iterdir()
    document = json.loads(path.read_text("utf-8"))
    assert document["request"] == REQUEST.body()
    assert document["origin"] == {"stage": "generate", "iteration": 1, "subject": "reward 1"}


def test_open_requests_that_find_no_room_are_a_sentence_and_leave_no_half_file(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PORSE_LLM_MODE", "batch")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    (long,) = questions(1, messages=(Message("user", "x" * 2**20),))
    # As on a full disk: no file may grow beyond this.
    resource.setrlimit(resource.RLIMIT_FSIZE, (2**19, before[1]))
    try:
        with pytest.raises(
            CacheError, match=r"Expected to write 3 open requests to .*pending, found: \[Errno"
        ) as caught:
            ask([*questions(2), long], params(), store.cache_dir)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert "\n" not in str(caught.value)
    assert pending_keys(store) == {question.request.key for question in questions(2)}
    assert len(list((store.state_dir / "pending").iterdir())) == 2
