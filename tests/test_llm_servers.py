"""Replies recorded from two real servers: llama.cpp's with a small model, and LiteLLM's gateway in front of it.

`make servers` installs them, `pytest -m servers` runs these tests: a minute or two.
"""

import dataclasses
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

import servers
from llm_cases import params
from porse.config import LlmParams
from porse.errors import ProviderError
from porse.llm.ask import ask
from porse.llm.record import Record
from porse.llm.request import Message, Origin, Question, Reply, Request
from porse.llm.store import Store
from servers import KEY, MODEL, Server, engine, gateway

pytestmark = [pytest.mark.servers, pytest.mark.timeout(600)]

KEY_VARIABLE = "PORSE_TEST_SERVERS_KEY"
SHORT_CONTEXT = 512
BEHIND = {"smollm2": MODEL, "vendor/smollm2": MODEL, MODEL: MODEL}
"""The names that the gateway knows, with the engine's."""


@pytest.fixture(scope="module", autouse=True)
def _installed():
    if servers.missing():
        pytest.fail(servers.missing(), pytrace=False)


@pytest.fixture(scope="module")
def small(tmp_path_factory) -> Iterator[Server]:
    """The engine, with a short context."""
    with engine(tmp_path_factory.mktemp("engine"), context=SHORT_CONTEXT, key=KEY) as server:
        yield server


@pytest.fixture(scope="module")
def front(tmp_path_factory, small) -> Iterator[Server]:
    """The gateway before the engine."""
    with gateway(tmp_path_factory.mktemp("gateway"), BEHIND, small) as server:
        yield server


@pytest.fixture(params=["engine", "gateway"])
def server(request) -> Server:
    """Each of the two."""
    return request.getfixturevalue({"engine": "small", "gateway": "front"}[request.param])


@pytest.fixture(autouse=True)
def _record(monkeypatch):
    monkeypatch.setenv("PORSE_LLM_MODE", "record")
    monkeypatch.setenv("PORSE_LLM_CONCURRENCY", "1")
    monkeypatch.setenv("PORSE_LLM_ATTEMPTS", "3")
    monkeypatch.setenv(KEY_VARIABLE, KEY)


def profile(server: Server, model: str = MODEL) -> LlmParams:
    return params(server.url, model=model, key_variable=KEY_VARIABLE)


def questions(text: str, count: int, max_tokens: int, model: str = MODEL) -> list[Question]:
    messages = (Message("system", "You answer in one sentence."), Message("user", text))
    return [Question(Request(model, messages, 1.0, 1.0, max_tokens, k), Origin("generate", 1, f"reward {k}")) for k in range(count)]  # fmt: skip


def records(cache: Path, replies: Sequence[Reply]) -> list[Record]:
    found = [Store(cache).read(reply.key) for reply in replies]
    assert all(found)
    return found


def files(cache: Path) -> list[Path]:
    return sorted(cache.rglob("*.json"))


def test_replies_are_recorded_with_what_the_server_says_of_them_and_replayed(server, tmp_path, monkeypatch):
    cache = tmp_path / "llm_cache"
    asked = questions("What is a reward?", 2, 200)
    replies = ask(asked, profile(server), cache)
    for reply, record in zip(replies, records(cache, replies), strict=True):
        assert reply.text.strip() == reply.text != ""
        assert reply.finish_reason in ("stop", "length")
        # By the model's own tokens: the question has some 35, no token is longer than the reply.
        assert 20 < record.answer.prompt_tokens < 60
        assert 0 < record.answer.completion_tokens <= 200
        assert record.provenance.answered_by == MODEL
        assert record.provenance.request_id.startswith("chatcmpl-")
    assert replies[0].text != replies[1].text, "samples of one question are drawn anew"
    assert KEY.encode() not in b"".join(file.read_bytes() for file in files(cache))
    monkeypatch.setenv("PORSE_LLM_MODE", "frozen")
    assert ask(asked, profile(server), cache) == replies


def test_a_reply_that_was_cut_off_is_asked_for_with_twice_the_limit(server, tmp_path):
    cache = tmp_path / "llm_cache"
    [reply] = ask(questions("Count from one to ninety in words.", 1, 4), profile(server), cache)
    first, second = sorted([*records(cache, [reply]), _other(cache, reply)], key=lambda r: r.request.max_tokens)
    assert (first.request.max_tokens, first.answer.finish_reason, first.answer.completion_tokens) == (4, "length", 4)
    assert (second.request.max_tokens, second.answer.finish_reason, second.answer.completion_tokens) == (8, "length", 8)
    assert (reply.finish_reason, reply.completion_tokens) == ("length", 12)


def _other(cache: Path, reply: Reply) -> Record:
    [file] = [file for file in files(cache) if file.stem != reply.key]
    found = Store(cache).read(file.stem)
    assert found is not None
    return found


def test_a_question_beyond_the_context_fails_at_once_in_the_engines_words(server, tmp_path):
    cache = tmp_path / "llm_cache"
    started = time.monotonic()
    with pytest.raises(ProviderError, match=r"status 400: .*maximum context length is 512 tokens") as found:
        ask(questions("word " * 600, 1, 8), profile(server), cache)
    assert time.monotonic() - started < 5.0
    assert "\n" not in str(found.value)
    assert not files(cache)


def test_the_others_are_recorded_when_one_question_is_too_long(server, tmp_path):
    cache = tmp_path / "llm_cache"
    good = questions("What is a policy?", 1, 100)
    with pytest.raises(ProviderError, match="1 failures"):
        ask([*questions("word " * 600, 1, 8), *good], profile(server), cache)
    assert good[0].request.key in [file.stem for file in files(cache)]


def test_a_refused_key_is_said_and_not_shown(server, tmp_path, monkeypatch):
    monkeypatch.setenv(KEY_VARIABLE, "sk-another-key-that-is-wrong")
    with pytest.raises(ProviderError) as found:
        ask(questions("What is a key?", 2, 8), profile(server), tmp_path / "llm_cache")
    # The gateway keeps its keys in a database; without one it answers with a 400 that does not speak of the key.
    assert "API key was refused, status 401" in str(found.value) or "No connected db." in str(found.value)
    assert "another-key" not in str(found.value)


@pytest.mark.parametrize("name", ["smollm2", "vendor/smollm2"])
def test_the_gateways_alias_stands_in_the_record_and_the_model_behind_it_does_not(front, tmp_path, name):
    cache = tmp_path / "llm_cache"
    replies = ask(questions("What is an alias?", 1, 100, name), profile(front, name), cache)
    [record] = records(cache, replies)
    assert (record.request.model, record.provenance.answered_by) == (name, name)


def test_the_gateway_counts_as_the_engine_does(small, front, tmp_path):
    counts = []
    for number, server in enumerate((small, front)):
        cache = tmp_path / str(number)
        [record] = records(cache, ask(questions("How many tokens?", 1, 100), profile(server), cache))
        counts.append(record.answer.prompt_tokens)
    assert counts[0] == counts[1]


def test_the_gateway_refuses_a_name_that_it_does_not_know(front, tmp_path):
    cache = tmp_path / "llm_cache"
    with pytest.raises(ProviderError, match=r"status 400: .*Invalid model name passed in model=nothing"):
        ask(questions("Who are you?", 1, 8, "nothing"), profile(front, "nothing"), cache)
    assert not files(cache)


def test_the_engine_answers_to_any_name_and_claims_it(small, tmp_path):
    """Why a profile of a server of one's own must name the model itself: nobody else does."""
    cache = tmp_path / "llm_cache"
    replies = ask(questions("Who are you?", 1, 100, "gpt-4o-mini"), profile(small, "gpt-4o-mini"), cache)
    assert records(cache, replies)[0].provenance.answered_by == "gpt-4o-mini"


def test_the_same_seed_and_the_same_questions_get_the_same_replies(tmp_path):
    texts = []
    for number in range(2):
        folder = tmp_path / str(number)
        folder.mkdir()
        with engine(folder, seed=7, context=SHORT_CONTEXT, key=KEY) as server:
            replies = ask(questions("What is a seed?", 3, 60), profile(server), folder / "llm_cache")
            texts.append([reply.text for reply in replies])
    assert texts[0] == texts[1]


def test_a_gateway_whose_engine_is_gone_is_tried_again_and_then_said(tmp_path):
    gone = Server("http://127.0.0.1:9/v1", tmp_path / "none.log")
    with (
        gateway(tmp_path, {MODEL: MODEL}, gone) as front,
        pytest.raises(ProviderError, match=r"3 attempts failed, the last one: status 5\d\d"),
    ):
        ask(questions("Is anybody there?", 1, 8), dataclasses.replace(profile(front)), tmp_path / "llm_cache")
