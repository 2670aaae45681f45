"""Record mode against a real server on loopback that misbehaves on purpose."""

import email.utils
import logging
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import Any

import pytest

from porse.errors import CacheError, ParamsError, ProviderError
from porse.llm import provider
from porse.llm.ask import ask
from porse.llm.ledger import Spending, total_spending
from porse.llm.provider import back_off_s, retry_after_s
from porse.llm.request import Message, Reply
from porse.llm.store import Store
from tests.llm_cases import new_store, params, questions, request
from tests.llm_server import (
    Behaviour,
    ChatServer,
    completion,
    failing,
    good,
    half_a_body,
    raw,
    replying,
    reset,
    send,
    slow_headers,
)

TEXT = "reply to Fly to the target."


@pytest.fixture
def server() -> Iterator[ChatServer]:
    with ChatServer() as server:
        yield server


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return new_store(tmp_path)


@pytest.fixture(autouse=True)
def recording(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PORSE_LLM_MODE", "record")
    monkeypatch.setenv("PORSE_LLM_TIMEOUT_S", "5")
    monkeypatch.setenv("PORSE_LLM_ATTEMPTS", "3")
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.delenv("PORSE_LLM_BASE_URL", raising=False)
    monkeypatch.setattr(provider, "FIRST_DELAY_S", 0.01)


def record(server: ChatServer, store: Store, *script: Behaviour, count: int = 1) -> list[Reply]:
    server.script = list(script)
    return ask(questions(count), params(server.url), store.cache_dir)


def refused(server: ChatServer, store: Store, *script: Behaviour, count: int = 1) -> str:
    """Returns the message of a failure, after checking that nothing was recorded."""
    with pytest.raises(ProviderError) as caught:
        record(server, store, *script, count=count)
    assert list(store.all_keys()) == []
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_reply_is_recorded_and_replayed(server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    recorded = record(server, store, count=3)
    assert len(server.requests) == 3
    assert record(server, store, count=3) == recorded
    monkeypatch.setenv("PORSE_LLM_MODE", "frozen")
    assert record(server, store, count=3) == recorded
    assert len(server.requests) == 3


def test_what_is_sent(server: ChatServer, store: Store) -> None:
    record(server, store)
    (sent,) = server.requests
    assert sent["path"] == "/v1/chat/completions"
    assert sent["body"] == {
        "model": "test-model",
        "messages": [
            {"role": "system", "content": "You write rewards.\nTorch only."},
            {"role": "user", "content": "Fly to the target."},
        ],
        "temperature": 0.5,
        "top_p": 0.9,
        "max_tokens": 100,
        "stream": False,
    }


def test_provenance_of_a_recorded_reply(server: ChatServer, store: Store) -> None:
    record(server, store, replying("hello", model="test-model-2026-01-01"))
    found = store.read(request().key)
    assert found is not None
    provenance = found.provenance
    assert (provenance.answered_by, provenance.mode) == ("test-model-2026-01-01", "record")
    assert (provenance.profile, provenance.endpoint, provenance.request_id) == ("local", "profile", "chatcmpl-1")
    assert (found.answer.prompt_tokens, found.answer.completion_tokens) == (100, 10)


def test_endpoint_of_the_environment_wins(server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PORSE_LLM_BASE_URL", server.url)
    ask(questions(1), params("http://127.0.0.1:1/v1"), store.cache_dir)
    found = store.read(request().key)
    assert found is not None
    assert found.provenance.endpoint == "override"


@pytest.mark.parametrize(
    "misbehaviour",
    [
        failing(408),
        failing(409),
        failing(429),
        failing(429, headers={"Retry-After": "0"}),
        failing(500),
        failing(503),
        half_a_body,
        reset,
    ],
    ids=["408", "409", "429", "429 with Retry-After", "500", "503", "half a body", "reset"],
)
def test_tried_again(server: ChatServer, store: Store, misbehaviour: Behaviour) -> None:
    (reply,) = record(server, store, misbehaviour, misbehaviour)
    assert reply.text == TEXT
    assert len(server.requests) == 3


@pytest.mark.parametrize("misbehaviour", [failing(429), failing(500), half_a_body, reset])
def test_given_up_after_the_last_attempt(server: ChatServer, store: Store, misbehaviour: Behaviour) -> None:
    assert "3 attempts failed" in refused(server, store, *[misbehaviour] * 9)
    assert len(server.requests) == 3


@pytest.mark.parametrize(
    ("misbehaviour", "reason"),
    [
        (failing(400, message="bad thing"), "status 400: .*bad thing"),
        (failing(404), "status 404"),
        (failing(422), "status 422"),
        (failing(401), "the API key was refused"),
        (failing(403), "the API key was refused"),
        (failing(402), "the quota is exhausted"),
        (failing(429, "insufficient_quota", headers={"Retry-After": "0"}), "the quota is exhausted"),
        (raw(b"{oops"), "5 bytes that do not parse"),
        (raw(b"[" * 100_000), "do not parse"),
        (raw(b"[]"), "expected a chat completion, found list"),
        (raw(b'{"error": {"message": "overloaded"}}'), "overloaded"),
        (raw(b'{"model": "test-model", "choices": []}'), "one choice"),
        (raw(b'{"model": "test-model"}'), "one choice"),
        (replying("text", model="other-model"), "model 'test-model', found one of 'other-model'"),
        (replying("text", model="test-modeller"), "found one of 'test-modeller'"),
        (replying(""), "expected a reply with a text"),
        (replying(None), "expected a reply with a text"),
        (replying(" \n"), "expected a reply with a text"),
        (replying("", "length"), "expected a reply with a text"),
        (replying("part", "content_filter"), "content_filter"),
        (replying(None, "tool_calls"), "tool_calls"),
        (replying("a\ud800"), "UTF-8"),
        (replying("x" * 8 * 2**20), "at most 4194304 bytes"),
    ],
)
def test_refused_at_once(
    server: ChatServer, store: Store, misbehaviour: Behaviour, reason: str, caplog: pytest.LogCaptureFixture
) -> None:
    import re

    assert re.search(reason, refused(server, store, misbehaviour))
    assert len(server.requests) == 1


def test_retry_after_is_honoured(server: ChatServer, store: Store) -> None:
    record(server, store, failing(429, headers={"Retry-After": "0.7"}))
    assert 0.7 <= server.times[1] - server.times[0] < 2


def test_a_date_to_retry_after_is_honoured() -> None:
    date = email.utils.formatdate(time.time() + 30, usegmt=True)
    seconds = retry_after_s({"retry-after": date})
    assert seconds is not None
    assert 28 < seconds <= 30
    assert retry_after_s({"retry-after": "Thu, 01 Jan 1970 00:00:00 GMT"}) == 0


@pytest.mark.parametrize("text", ["", "soon", "nan", "inf", "-inf"])
def test_an_unreadable_retry_after_counts_as_none(text: str) -> None:
    assert retry_after_s({"retry-after": text}) in (None, 0)


def test_a_wait_beyond_the_stage_is_not_begun(
    server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PORSE_LLM_STAGE_TIMEOUT_S", "5")
    started = time.monotonic()
    assert "asks to wait 86400 s" in refused(server, store, failing(429, headers={"Retry-After": "86400"}))
    assert time.monotonic() - started < 2


def test_back_off_doubles_up_to_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provider, "FIRST_DELAY_S", 0.5)
    assert [back_off_s(attempt) for attempt in (1, 2, 3, 4, 9)] == [0.5, 1.0, 2.0, 4.0, 60.0]


def test_slow_headers_end_at_the_time_out(server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PORSE_LLM_TIMEOUT_S", "0.4")
    started = time.monotonic()
    (reply,) = record(server, store, slow_headers)
    assert reply.text == TEXT
    assert 0.4 <= server.times[1] - started < 2


def test_the_time_of_the_stage_is_limited(server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PORSE_LLM_STAGE_TIMEOUT_S", "1.5")
    monkeypatch.setenv("PORSE_LLM_CONCURRENCY", "1")
    server.delay_s = 1.0
    with pytest.raises(ProviderError, match=r"found 4 failures: .*the 1\.5 s of the stage are over"):
        record(server, store, count=5)
    assert len(list(store.all_keys())) == 1
    server.delay_s = 0
    monkeypatch.setenv("PORSE_LLM_STAGE_TIMEOUT_S", "10")
    assert len(record(server, store, count=5)) == 5


def test_nothing_listens(store: Store) -> None:
    with pytest.raises(ProviderError, match=r"3 attempts failed, the last one: the connection broke \(Connect"):
        ask(questions(1), params("http://127.0.0.1:9/v1"), store.cache_dir)


def test_one_failure_does_not_lose_the_others(server: ChatServer, store: Store) -> None:
    with pytest.raises(ProviderError, match=r"each of 5 requests .* found 1 failures: generate, iteration 1, reward"):
        record(server, store, failing(400), count=5)
    assert len(list(store.all_keys())) == 4
    assert len(record(server, store, count=5)) == 5
    assert len(server.requests) == 6


@pytest.mark.parametrize("misbehaviour", [failing(401), failing(429, "insufficient_quota")])
def test_a_hopeless_failure_ends_the_others(
    server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch, misbehaviour: Behaviour
) -> None:
    monkeypatch.setenv("PORSE_LLM_CONCURRENCY", "1")
    refused(server, store, *[misbehaviour] * 9, count=9)
    assert len(server.requests) == 1


def test_requests_under_way_are_limited(server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PORSE_LLM_CONCURRENCY", "3")
    server.delay_s = 0.05
    record(server, store, count=12)
    assert server.most_busy == 3


def test_a_truncated_reply_is_asked_for_once_more(server: ChatServer, store: Store) -> None:
    (reply,) = record(server, store, replying("cut", "length"))
    assert [sent["body"]["max_tokens"] for sent in server.requests] == [100, 200]
    assert (reply.text, reply.key) == (TEXT, request(max_tokens=200).key)
    assert (reply.prompt_tokens, reply.completion_tokens) == (200, 20)
    assert len(list(store.all_keys())) == 2


def test_a_repair_that_is_cut_off_too_is_flagged(server: ChatServer, store: Store) -> None:
    (reply,) = record(server, store, *[replying("cut", "length")] * 5)
    assert reply.finish_reason == "length"
    assert len(server.requests) == 2


def test_a_failed_repair_keeps_what_is_paid_for(server: ChatServer, store: Store) -> None:
    with pytest.raises(ProviderError, match="status 400"):
        record(server, store, replying("cut", "length"), failing(400))
    assert list(store.all_keys()) == [request().key]
    record(server, store)
    assert [sent["body"]["max_tokens"] for sent in server.requests] == [100, 200, 200]


def cut_off_at_100(handler: BaseHTTPRequestHandler, body: dict[str, Any]) -> None:
    """Cuts a reply of at most 100 tokens off, whichever of several requests arrives first."""
    (replying("cut", "length") if body["max_tokens"] <= 100 else good)(handler, body)


def test_one_request_may_be_the_repair_of_another(server: ChatServer, store: Store) -> None:
    server.script = [cut_off_at_100] * 3
    both = [*questions(1), *questions(1, max_tokens=200)]
    one, two = ask(both, params(server.url), store.cache_dir)
    assert one.key == two.key
    assert len(server.requests) == 2


def test_the_key_comes_from_the_environment(server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MY_KEY", " secret-0123456789 ")
    ask(questions(1), params(server.url, key_variable="MY_KEY"), store.cache_dir)
    assert server.authorizations == ["Bearer secret-0123456789"]
    assert all(b"secret" not in path.read_bytes() for path in store.cache_dir.rglob("*.json"))


def test_no_other_key_is_ever_sent(server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "not-for-you")
    record(server, store)
    assert server.authorizations == ["Bearer no-key"]


def test_a_missing_key_is_named(server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MY_KEY", raising=False)
    with pytest.raises(ParamsError, match=r"in the environment variable MY_KEY, found none"):
        ask(questions(1), params(server.url, key_variable="MY_KEY"), store.cache_dir)
    assert server.requests == []


def test_no_key_is_needed_when_nothing_is_missing(
    server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    record(server, store)
    monkeypatch.delenv("MY_KEY", raising=False)
    assert len(ask(questions(1), params(server.url, key_variable="MY_KEY"), store.cache_dir)) == 1


def test_a_server_that_repeats_the_key_does_not_get_it_printed(
    server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    monkeypatch.setenv("MY_KEY", "secret-0123456789")
    for status in (401, 500):
        server.script = [failing(status, message="wrong key secret-0123456789")] * 3
        with pytest.raises(ProviderError) as caught:
            ask(questions(1), params(server.url, key_variable="MY_KEY"), store.cache_dir)
        assert "secret" not in str(caught.value)
    assert "secret" not in caplog.text


def test_a_reply_that_repeats_the_key_is_not_recorded(
    server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MY_KEY", "secret-0123456789")
    server.script = [replying("your key is secret-0123456789")]
    with pytest.raises(CacheError, match="the API key itself"):
        ask(questions(1), params(server.url, key_variable="MY_KEY"), store.cache_dir)
    assert list(store.all_keys()) == []


@pytest.mark.parametrize("name", ["TIMEOUT_S", "STAGE_TIMEOUT_S", "CONCURRENCY", "ATTEMPTS"])
@pytest.mark.parametrize("value", ["0", "-1", "many", "inf", "nan"])
def test_a_limit_out_of_range_is_named(
    server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch, name: str, value: str
) -> None:
    monkeypatch.setenv(f"PORSE_LLM_{name}", value)
    with pytest.raises(ParamsError, match=f"Expected PORSE_LLM_{name} to be .* found '{value}'"):
        record(server, store)


def test_the_ledger_counts_what_was_spent(server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    record(server, store, replying("cut", "length"), count=1)
    # Two replies of 100 + 10 tokens at 2 and 10 USD per million.
    assert total_spending(store) == Spending(2, 200, 20, pytest.approx(2 * 300e-6))
    monkeypatch.setenv("PORSE_LLM_MODE", "frozen")
    record(server, store, count=1)
    assert total_spending(store).replies == 2


def test_unicode_survives(server: ChatServer, store: Store) -> None:
    text = "Größe ≤ 2 µm\r\n\u2028\x85\t\x00 😀\n"
    (reply,) = record(server, store, replying(text))
    assert reply.text == text
    assert record(server, store) == [reply]


def test_large_reply_below_the_limit(server: ChatServer, store: Store) -> None:
    (reply,) = record(server, store, replying("x" * 3 * 2**20))
    assert len(reply.text) == 3 * 2**20


def test_a_sample_is_not_sent_and_has_its_own_call(server: ChatServer, store: Store) -> None:
    record(server, store, count=4)
    assert len(server.requests) == 4
    assert all("sample" not in sent["body"] and "schema" not in sent["body"] for sent in server.requests)


def test_a_server_without_model_and_usage(server: ChatServer, store: Store) -> None:
    def plain(handler: object, body: dict[str, object]) -> None:
        import json

        document = completion({"model": "", "messages": [{"content": "x"}]})
        del document["model"], document["usage"], document["id"]
        send(handler, 200, json.dumps(document).encode())  # type: ignore[arg-type]

    (reply,) = record(server, store, plain)
    assert (reply.answered_by, reply.prompt_tokens, reply.cost_usd) == ("test-model", 0, 0.0)


def test_messages_of_other_languages_are_sent_as_they_are(server: ChatServer, store: Store) -> None:
    asked = questions(1, messages=(Message("user", "Größe 😀"),))
    ask(asked, params(server.url), store.cache_dir)
    assert server.requests[0]["body"]["messages"] == [{"role": "user", "content": "Größe 😀"}]
