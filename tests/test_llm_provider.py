"""Record mode against a real server on loopback that misbehaves on purpose."""

import datetime
import email.utils
import json
import logging
import re
import ssl
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID

from porse.errors import CacheError, ParamsError, ProviderError
from porse.llm import provider
from porse.llm.ask import ask
from porse.llm.ledger import Spending, Totals, ledger_path, totals
from porse.llm.provider import back_off_s, retry_after_s
from porse.llm.request import Message, Question, Reply, request_of
from porse.llm.store import Store
from porse.llm.verify import verify
from tests.llm_cases import ORIGIN, REQUEST, new_store, params, questions, request
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


def moved(handler: BaseHTTPRequestHandler, body: dict[str, Any]) -> None:
    send(handler, 308, b"", {"Location": "http://127.0.0.1:9/v1"})


def surrounded(before: bytes, after: bytes) -> Behaviour:
    """Returns a behaviour: a good completion with bytes before and after it."""

    def behave(handler: BaseHTTPRequestHandler, body: dict[str, Any]) -> None:
        send(handler, 200, before + json.dumps(completion(body), indent=1).encode() + after)

    return behave


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


def record(server: ChatServer, store: Store, *script: Behaviour, count: int = 1, **profile: Any) -> list[Reply]:
    server.script = list(script)
    return ask(questions(count), params(server.url, **profile), store.cache_dir)


def refused(server: ChatServer, store: Store, *script: Behaviour, count: int = 1, **profile: Any) -> str:
    """Returns the message of a failure, after checking that nothing was recorded."""
    with pytest.raises(ProviderError) as caught:
        record(server, store, *script, count=count, **profile)
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
        failing(429, "quota_exceeded", "5 requests a minute", headers={"Retry-After": "0"}),
        failing(429, "quota_exceeded"),
        raw(b'{"error": {"code": 429, "message": "slow down"}}'),
        raw(b'{"error": {"code": "502", "message": "bad gateway"}}'),
        raw(b'{"error": {"type": "overloaded_error", "message": "busy"}}'),
        raw(b'{"choices": [{"finish_reason": "error", "message": {"content": "half"}}]}'),
        raw(b'{"choices": [{"error": {"code": 503, "message": "upstream"}, "message": {"content": "half"}}]}'),
        half_a_body,
        reset,
    ],
    ids=[
        "408",
        "409",
        "429",
        "429 with Retry-After",
        "500",
        "503",
        "quota of a minute with Retry-After",
        "quota of a minute",
        "429 in a 200",
        "502 in a 200, as a text",
        "overloaded in a 200, by name",
        "finish reason error",
        "error in a choice",
        "half a body",
        "reset",
    ],
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
        (failing(429, "billing_hard_limit_reached"), "the quota is exhausted"),
        (
            raw(b'{"error": {"code": 402, "message": "no credits left"}}'),
            "quota is exhausted, status 402: no credits left",
        ),
        (
            raw(b'{"error": {"code": 401, "message": "who are you"}}'),
            "the API key was refused, status 401: who are you",
        ),
        (raw(b'{"error": {"code": 400, "message": "too long a prompt"}}'), "status 400: too long a prompt"),
        (raw(b'{"error": {"code": "insufficient_quota", "message": "pay"}}'), "the quota is exhausted, an error: pay"),
        (raw(b'{"error": "just words"}'), "an error: just words"),
        (raw(b'{"choices": [{"error": {"code": 400, "message": "bad words"}}]}'), "status 400: bad words"),
        (moved, "status 308: moved to http://127.0.0.1:9/v1"),
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
        (replying("", None), "expected a reply with a text"),
        (replying([{"type": "thinking", "text": "hm"}]), "expected a reply with a text"),
        (replying([{"type": "image_url", "image_url": {}}]), "a part of type 'image_url'"),
        (replying("part", "safety"), "safety"),
        (raw(b'{"choices": []} {"choices": []}'), "30 bytes|31 bytes"),
        (replying("part", "content_filter"), "content_filter"),
        (replying(None, "tool_calls"), "tool_calls"),
        (replying("a\ud800"), "UTF-8"),
        (replying("x" * 8 * 2**20), "at most 4194304 bytes"),
    ],
)
def test_refused_at_once(
    server: ChatServer, store: Store, misbehaviour: Behaviour, reason: str, caplog: pytest.LogCaptureFixture
) -> None:
    assert re.search(reason, refused(server, store, misbehaviour))
    assert len(server.requests) == 1


@pytest.mark.parametrize(
    "body",
    [
        b'[{"error": {"code": 400, "message": "bad thing", "status": "INVALID_ARGUMENT"}}]',
        b'{"object": "error", "message": "bad thing", "code": 400}',
        b'{"detail": "bad thing"}',
        b'{"error": "bad thing"}',
        b"bad thing",
        b'{"error": {"metadata": {"raw": "bad thing"}}}',
    ],
)
def test_the_text_of_an_error_is_shown_in_whichever_form_it_comes(
    server: ChatServer, store: Store, body: bytes
) -> None:
    assert re.search(r"status 400: .*bad thing", refused(server, store, lambda handler, _: send(handler, 400, body)))


@pytest.mark.parametrize(
    ("asked", "changes", "sent"),
    [
        ({"limit": "max_completion_tokens"}, {"limit": "max_completion_tokens"}, {"temperature", "top_p"}),
        ({"temperature": None}, {"leave_out": ("temperature",)}, {"top_p", "max_tokens"}),
        (
            {
                "temperature": None,
                "top_p": None,
                "limit": "max_completion_tokens",
                "extra": {"reasoning_effort": "low"},
            },
            {
                "leave_out": ("temperature", "top_p"),
                "limit": "max_completion_tokens",
                "extra": {"reasoning_effort": "low"},
            },
            {"max_completion_tokens", "reasoning_effort"},
        ),
    ],
)
def test_a_dialect_is_spoken_recorded_and_replayed(
    server: ChatServer,
    store: Store,
    monkeypatch: pytest.MonkeyPatch,
    asked: dict[str, Any],
    changes: dict[str, Any],
    sent: set[str],
) -> None:
    llm = params(server.url, **changes)
    question = [Question(request_of(llm, REQUEST.messages, 0), ORIGIN)]
    recorded = ask(question, llm, store.cache_dir)
    found = server.requests[0]["body"]
    names = {"temperature", "top_p", "max_tokens", "max_completion_tokens", "reasoning_effort"}
    assert sent <= set(found)
    assert (names & set(found)) - sent <= {asked.get("limit", "max_tokens")}
    assert [reply.key for reply in recorded] == [request(**asked).key]
    monkeypatch.setenv("PORSE_LLM_MODE", "frozen")
    assert ask(question, llm, store.cache_dir) == recorded
    assert verify(store.cache_dir) == []


def thinking_model(handler: BaseHTTPRequestHandler, body: dict[str, Any]) -> None:
    """Refuses what models that think refuse."""
    for name, advice in (("max_tokens", "Use 'max_completion_tokens' instead."), ("temperature", "Only the default.")):
        if name in body:
            failing(400, "unsupported_parameter", f"Unsupported parameter: '{name}'. {advice}")(handler, body)
            return
    good(handler, body)


def test_a_refused_parameter_names_the_setting_that_helps(server: ChatServer, store: Store) -> None:
    message = refused(server, store, thinking_model)
    assert "Use 'max_completion_tokens' instead." in message
    assert "`limit` and `leave_out` of its profile" in message
    server.script = [thinking_model]
    llm = params(server.url, limit="max_completion_tokens", leave_out=("temperature",))
    (reply,) = ask([Question(request_of(llm, REQUEST.messages, 0), ORIGIN)], llm, store.cache_dir)
    assert reply.text == TEXT


def test_thoughts_that_use_up_the_limit_are_a_truncation(
    server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    for empty in ("", None, " \n", [{"type": "thinking", "text": "hm"}]):
        checkout = new_store(store.cache_dir.parent / str(len(server.requests)))
        before = len(server.requests)
        (reply,) = record(server, checkout, replying(empty, "length"))
        assert [sent["body"]["max_tokens"] for sent in server.requests[before:]] == [100, 200]
        assert (reply.text, reply.prompt_tokens, reply.completion_tokens) == (TEXT, 200, 20)
        assert record(server, checkout) == [reply]
        assert len(server.requests) == before + 2, "what is paid for is not asked again"
        assert verify(checkout.cache_dir) == []
        kept = json.loads(checkout.path(request().key).read_bytes())
        assert (kept["format"], kept["reply"]["text"], kept["reply"]["finish_reason"]) == (2, [], "length")


def test_thoughts_that_use_up_the_larger_limit_too_are_an_empty_reply(server: ChatServer, store: Store) -> None:
    (reply,) = record(server, store, *[replying("", "length")] * 2)
    assert (reply.text, reply.finish_reason) == ("", "length")
    assert record(server, store) == [reply]
    assert len(server.requests) == 2


@pytest.mark.parametrize(
    "model",
    ["test-model", "test-model-2026-01-31", "test-model-20260131", "test-model-0613", "test-model@20260131"],
)
def test_a_dated_snapshot_is_the_model(server: ChatServer, store: Store, model: str) -> None:
    (reply,) = record(server, store, replying("text", model=model))
    assert reply.answered_by == model


OTHERS = [
    "test-model-mini",
    "test-model-mini-2026-01-31",
    "test-model-turbo-20260131",
    "test-model-1106-preview",
    "test-model-2026-13-31",
    "test-model-32k",
    "test-model-4096",
    "test-model:latest",
    "Test-Model",
    "vendor/test-model",
    "my-deployment",
]


@pytest.mark.parametrize("model", OTHERS)
def test_another_name_is_another_model_unless_the_profile_lists_it(
    server: ChatServer, store: Store, model: str
) -> None:
    assert "`aliases` of the profile" in refused(server, store, replying("text", model=model))
    assert "found one of" in refused(server, store, replying("text", model=model), aliases=("another",))
    (reply,) = record(server, store, replying("text", model=model), aliases=("another", model))
    assert (reply.answered_by, reply.key) == (model, request().key)


@pytest.mark.parametrize(
    ("reason", "recorded"),
    [
        ("eos", "stop"),
        ("end_turn", "stop"),
        ("STOP", "stop"),
        (None, "stop"),
        ("max_output_tokens", "length"),
        ("MAX_TOKENS", "length"),
    ],
)
def test_finish_reasons_of_other_servers_are_read(
    server: ChatServer, store: Store, reason: str | None, recorded: str
) -> None:
    record(server, store, replying("text", reason))
    found = store.read(request().key)
    assert found is not None
    assert found.answer.finish_reason == recorded


@pytest.mark.parametrize(
    "parts",
    [
        [{"type": "text", "text": "one "}, {"type": "text", "text": "two"}],
        ["one ", {"type": "output_text", "text": "two"}],
        [{"type": "thinking", "thinking": "hm"}, {"text": "one two"}],
    ],
)
def test_a_text_in_parts_is_read(server: ChatServer, store: Store, parts: list[Any]) -> None:
    (reply,) = record(server, store, replying(parts))
    assert reply.text == "one two"


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (b"", b"\n\ndata: [DONE]\n\n"),
        (b": PROCESSING\n\n: PROCESSING\n\n", b"\n"),
        (b": PROCESSING\r\n\r\n", b"\r\n: over\r\n"),
        (b"event: message\ndata: ", b"\n\ndata: [DONE]\n"),
        (b"\xef\xbb\xbf", b""),
        (b"\n \n", b" "),
    ],
)
def test_what_servers_put_around_a_completion_is_read_over(
    server: ChatServer, store: Store, before: bytes, after: bytes
) -> None:
    (reply,) = record(server, store, surrounded(before, after))
    assert reply.text == TEXT


def test_retry_after_inside_a_200_is_honoured(server: ChatServer, store: Store) -> None:
    body = b'{"error": {"code": 429, "message": "slow down"}}'
    record(server, store, lambda handler, _: send(handler, 200, body, {"Retry-After": "0.7"}))
    assert 0.7 <= server.times[1] - server.times[0] < 2


INHERITED = {
    "OPENAI_API_KEY": "not-for-you",
    "OPENAI_ADMIN_KEY": "not-for-you",
    "OPENAI_ORG_ID": "not-for-you",
    "OPENAI_ORGANIZATION": "not-for-you",
    "OPENAI_PROJECT_ID": "not-for-you",
    "OPENAI_CUSTOM_HEADERS": "X-Custom: not-for-you",
    "OPENAI_BASE_URL": "http://127.0.0.1:9/not-for-you",
    "AZURE_OPENAI_API_KEY": "not-for-you",
    "AZURE_OPENAI_AD_TOKEN": "not-for-you",
}


@pytest.mark.parametrize("key_variable", ["", "MY_KEY"])
def test_no_request_has_a_header_that_the_environment_asks_for(
    server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, key_variable: str
) -> None:
    netrc = tmp_path / "netrc"
    netrc.write_text("machine 127.0.0.1 login not-for-you password not-for-you\n")
    netrc.chmod(0o600)
    for name, value in {**INHERITED, "NETRC": str(netrc), "MY_KEY": "secret-0123456789"}.items():
        monkeypatch.setenv(name, value)
    server.script = [failing(500), replying("cut", "length")]
    ask(questions(6), params(server.url, key_variable=key_variable), store.cache_dir)
    assert len(server.headers) == 8
    connection = {"host", "connection", "accept-encoding", "content-length", "content-type"}
    wanted = connection | {"accept", "user-agent"} | ({"authorization"} if key_variable else set())
    assert {name for headers in server.headers for name in headers} == wanted
    assert "not-for-you" not in json.dumps([server.headers, server.requests])
    assert set(server.authorizations) == {"Bearer secret-0123456789" if key_variable else ""}


@pytest.mark.parametrize(
    ("variable", "value", "named"),
    [
        ("ALL_PROXY", "socks5://127.0.0.1:9", "socksio"),
        ("ALL_PROXY", "socks4://127.0.0.1:9", "socks4"),
        ("HTTPS_PROXY", "ftp://127.0.0.1:9", "ftp"),
        ("SSL_CERT_FILE", "/nowhere/certificates.pem", "SSL_CERT_FILE"),
        ("SSL_CERT_FILE", __file__, "SSL_CERT_FILE"),
        ("MY_KEY", "secret\u20110123456789", r"MY_KEY .*U\+2011 at place 7 of 17"),
        ("MY_KEY", "secret-01234\n56789", r"MY_KEY .*U\+000A at place 13 of 18"),
        ("MY_KEY", "secret 0123456789", r"U\+0020"),
        ("PORSE_LLM_BASE_URL", "127.0.0.1:8000/v1", "base_url"),
        ("PORSE_LLM_BASE_URL", "ftp://127.0.0.1/v1", "base_url"),
        ("PORSE_LLM_BASE_URL", "http://", "base_url"),
        ("PORSE_LLM_BASE_URL", "http://127.0.0.1:port/v1", "base_url"),
        ("PORSE_LLM_BASE_URL", "http://127.0.0.1:99999/v1", "the port 99999"),
        ("PORSE_LLM_BASE_URL", "http://me:secret-0123456789@127.0.0.1/v1", "name the variable of a key"),
    ],
)
def test_what_cannot_work_is_one_paragraph_before_the_first_request(
    server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch, variable: str, value: str, named: str
) -> None:
    monkeypatch.setenv("MY_KEY", "secret-0123456789")
    monkeypatch.setenv(variable, value)
    with pytest.raises(ParamsError, match=named) as caught:
        record(server, store, key_variable="MY_KEY")
    assert "\n" not in str(caught.value)
    assert "0123456789" not in str(caught.value)
    assert server.requests == []
    assert not ledger_path(store).exists()


def test_a_proxy_that_cannot_be_reached_is_a_connection_that_broke(
    server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("NO_PROXY")
    monkeypatch.delenv("no_proxy", raising=False)
    for proxy in ("http://127.0.0.1:9", "http://127.0.0.1:99999"):
        monkeypatch.setenv("HTTP_PROXY", proxy)
        monkeypatch.setenv("http_proxy", proxy)
        assert "3 attempts failed, the last one: the connection broke" in refused(server, store)
    assert server.requests == []


@pytest.fixture
def self_signed(server: ChatServer, tmp_path: Path) -> tuple[str, Path]:
    """The server behind TLS with a certificate that nobody has signed: its address, and the certificate's file."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "localhost")])
    day, now = datetime.timedelta(days=1), datetime.datetime.now(datetime.UTC)
    builder = x509.CertificateBuilder(name, name, key.public_key(), 1, now - day, now + day)
    builder = builder.add_extension(x509.SubjectAlternativeName([x509.DNSName("localhost")]), critical=False)
    private = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    certificate = builder.sign(key, hashes.SHA256()).public_bytes(Encoding.PEM)
    path = tmp_path / "certificate.pem"
    path.write_bytes(certificate)
    (tmp_path / "both.pem").write_bytes(private + certificate)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(tmp_path / "both.pem")
    server.server.socket = context.wrap_socket(server.server.socket, server_side=True)
    return server.url.replace("http://127.0.0.1", "https://localhost"), path


def test_a_certificate_that_is_not_trusted_ends_the_recording_at_once(
    server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch, self_signed: tuple[str, Path]
) -> None:
    url, path = self_signed
    monkeypatch.setenv("NO_PROXY", "localhost")
    started = time.monotonic()
    with pytest.raises(ProviderError, match=r"certificate is not trusted \(.*SSL_CERT_FILE") as caught:
        ask(questions(3), params(url), store.cache_dir)
    assert "attempts failed" not in str(caught.value)
    assert time.monotonic() - started < 5
    assert (server.requests, totals(store).spending.replies, totals(store).reserved) == ([], 0, {})
    monkeypatch.setenv("SSL_CERT_FILE", str(path))
    assert len(ask(questions(3), params(url), store.cache_dir)) == 3


def test_the_query_of_an_endpoint_stays_at_its_end(server: ChatServer, store: Store) -> None:
    ask(questions(1), params(f"{server.url}/?api-version=7"), store.cache_dir)
    assert server.requests[0]["path"] == "/v1/chat/completions?api-version=7"


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
    assert server.authorizations == [""]


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
    assert totals(store) == Totals(Spending(2, 200, 20, pytest.approx(2 * 300e-6)), 2, {})
    monkeypatch.setenv("PORSE_LLM_MODE", "frozen")
    record(server, store, count=1)
    assert totals(store).requests == 2


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
        document = completion({"model": "", "messages": [{"content": "x"}]})
        del document["model"], document["usage"], document["id"]
        send(handler, 200, json.dumps(document).encode())  # type: ignore[arg-type]

    (reply,) = record(server, store, plain)
    assert (reply.answered_by, reply.prompt_tokens, reply.cost_usd) == ("test-model", 0, 0.0)


def test_messages_of_other_languages_are_sent_as_they_are(server: ChatServer, store: Store) -> None:
    asked = questions(1, messages=(Message("user", "Größe 😀"),))
    ask(asked, params(server.url), store.cache_dir)
    assert server.requests[0]["body"]["messages"] == [{"role": "user", "content": "Größe 😀"}]
