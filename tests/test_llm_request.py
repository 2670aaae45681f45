"""What a request's key depends on, and what it does not."""

import json
import math
import re
from pathlib import Path

import pytest

from porse.errors import ParamsError
from porse.identity import content_id
from porse.llm.request import REQUEST_SCHEMA, Message, Question, request_from_body
from tests.llm_cases import ORIGIN, REQUEST, params, request

DOCUMENT = Path(__file__).parents[1] / "docs" / "llm-cache.md"


def golden_vectors() -> list[tuple[str, str]]:
    return re.findall(r"```json request\n(.*?)```\s*key: `([0-9a-f]{64})`", DOCUMENT.read_text("utf-8"), re.DOTALL)


def test_model_participates() -> None:
    assert request(model="other").key != REQUEST.key


def test_temperature_participates() -> None:
    assert request(temperature=0.6).key != REQUEST.key


def test_top_p_participates() -> None:
    assert request(top_p=0.8).key != REQUEST.key


def test_max_tokens_participates() -> None:
    assert request(max_tokens=101).key != REQUEST.key


def test_sample_participates() -> None:
    assert request(sample=1).key != REQUEST.key


def test_schema_participates() -> None:
    assert content_id("request", {**REQUEST.body(), "schema": REQUEST_SCHEMA + 1}) != REQUEST.key


def test_message_content_participates() -> None:
    assert request(messages=(Message("user", "a"),)).key != request(messages=(Message("user", "b"),)).key


def test_message_role_participates() -> None:
    assert request(messages=(Message("user", "a"),)).key != request(messages=(Message("system", "a"),)).key


def test_message_order_participates() -> None:
    assert request(messages=REQUEST.messages[::-1]).key != REQUEST.key


def test_message_count_participates() -> None:
    assert request(messages=REQUEST.messages[:1]).key != REQUEST.key


def test_message_border_participates() -> None:
    one, two = (Message("user", "ab"), Message("user", "c")), (Message("user", "a"), Message("user", "bc"))
    assert request(messages=one).key != request(messages=two).key


def test_trailing_space_participates() -> None:
    assert request(messages=(Message("user", "a "),)).key != request(messages=(Message("user", "a"),)).key


def test_base_url_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PORSE_LLM_BASE_URL", "http://elsewhere/v1")
    assert request().key == REQUEST.key


@pytest.mark.parametrize("name", ["TIMEOUT_S", "STAGE_TIMEOUT_S", "CONCURRENCY", "ATTEMPTS", "MODE"])
def test_transport_does_not(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(f"PORSE_LLM_{name}", "7")
    assert request().key == REQUEST.key


def test_api_key_does_not() -> None:
    assert "key" not in json.dumps(REQUEST.body())


def test_origin_does_not() -> None:
    assert Question(REQUEST, ORIGIN).request.key == REQUEST.key


def test_profile_and_prices_do_not() -> None:
    assert params("http://a").model == params("http://b").model == REQUEST.model


def test_equal_numbers_give_one_key() -> None:
    assert request(temperature=1).key == request(temperature=1.0).key
    assert request(temperature=-0.0).key == request(temperature=0.0).key


def test_key_is_64_hexadecimal_digits() -> None:
    assert re.fullmatch(r"[0-9a-f]{64}", REQUEST.key)


def test_body_and_back() -> None:
    assert request_from_body(REQUEST.body()) == REQUEST


@pytest.mark.parametrize(("body", "key"), golden_vectors())
def test_golden_vectors_of_the_documentation(body: str, key: str) -> None:
    assert request_from_body(json.loads(body)).key == key


def test_documentation_holds_golden_vectors() -> None:
    assert len(golden_vectors()) >= 3


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("model", ""),
        ("messages", ()),
        ("messages", (Message("robot", "a"),)),  # type: ignore[arg-type]
        ("messages", (Message("user", None),)),  # type: ignore[arg-type]
        ("temperature", -0.1),
        ("temperature", 2.1),
        ("temperature", math.nan),
        ("temperature", True),
        ("top_p", 0.0),
        ("top_p", 1.1),
        ("max_tokens", 0),
        ("max_tokens", 10.0),
        ("sample", -1),
    ],
)
def test_value_out_of_range_is_named(field: str, value: object) -> None:
    with pytest.raises(ParamsError, match=r"Expected .* of a request to be"):
        request(**{field: value})


def test_other_schema_is_refused() -> None:
    with pytest.raises(ParamsError, match="schema"):
        request_from_body({**REQUEST.body(), "schema": REQUEST_SCHEMA + 1})


def test_half_a_surrogate_pair_is_refused() -> None:
    with pytest.raises(ParamsError, match="UTF-8"):
        _ = request(messages=(Message("user", "a\ud800"),)).key


def test_longer_request_differs_in_its_limit_only() -> None:
    assert REQUEST.longer() == request(max_tokens=200)
