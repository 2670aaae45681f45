"""What a request's key depends on, and what it does not."""

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest

from porse.errors import ParamsError
from porse.identity import content_id
from porse.llm.request import Message, Question, request_from_body, request_of
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
    assert content_id("request", {**REQUEST.body(), "schema": 2}) != REQUEST.key


def test_limit_participates() -> None:
    assert request(limit="max_completion_tokens").key != REQUEST.key


def test_a_parameter_left_out_participates() -> None:
    keys = {request(temperature=None).key, request(top_p=None).key, request(temperature=None, top_p=None).key}
    assert len(keys | {REQUEST.key}) == 4


def test_an_extra_field_participates() -> None:
    keys = {request(extra={"reasoning_effort": effort}).key for effort in ("low", "high")}
    assert len(keys | {REQUEST.key}) == 3


def test_the_order_of_extra_fields_does_not() -> None:
    one, two = {"a": 1, "b": {"c": [1], "d": None}}, {"b": {"d": None, "c": [1]}, "a": 1}
    assert request(extra=one).key == request(extra=two).key


def test_a_request_without_dialect_keeps_the_first_schema() -> None:
    assert REQUEST.body()["schema"] == 1
    assert set(REQUEST.body()) == {"schema", "model", "messages", "temperature", "top_p", "max_tokens", "sample"}


def test_what_a_dialect_sends() -> None:
    asked = request(temperature=None, limit="max_completion_tokens", extra={"thinking": {"type": "disabled"}})
    assert asked.wire_body() == {
        "model": "test-model",
        "messages": [
            {"role": "system", "content": "You write rewards.\nTorch only."},
            {"role": "user", "content": "Fly to the target."},
        ],
        "top_p": 0.9,
        "max_completion_tokens": 100,
        "thinking": {"type": "disabled"},
    }
    assert asked.longer().wire_body()["max_completion_tokens"] == 200


def test_the_dialect_of_a_profile_reaches_the_request() -> None:
    llm = params(limit="max_completion_tokens", leave_out=("temperature",), extra={"reasoning_effort": "low"})
    asked = request_of(llm, REQUEST.messages, 0)
    assert asked == request(temperature=None, limit="max_completion_tokens", extra={"reasoning_effort": "low"})
    assert request_of(params(), REQUEST.messages, 0) == REQUEST
    assert request_of(params(aliases=("other",)), REQUEST.messages, 0).key == REQUEST.key


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


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"temperature": None},
        {"top_p": None},
        {"limit": "max_completion_tokens"},
        {"extra": {"a": [1, {"b": None}]}},
    ],
)
def test_body_and_back(changes: dict[str, Any]) -> None:
    assert request_from_body(request(**changes).body()) == request(**changes)


@pytest.mark.parametrize(("body", "key"), golden_vectors())
def test_golden_vectors_of_the_documentation(body: str, key: str) -> None:
    assert request_from_body(json.loads(body)).key == key


def test_documentation_holds_golden_vectors() -> None:
    assert [json.loads(body)["schema"] for body, _ in golden_vectors()] == [1, 1, 1, 2, 2]


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
        ("limit", ""),
        ("limit", "stream"),
        ("extra", {"temperature": 0.1}),
        ("extra", {"n": 4}),
        ("extra", []),
    ],
)
def test_value_out_of_range_is_named(field: str, value: object) -> None:
    with pytest.raises(ParamsError, match=r"Expected .* of a request to be"):
        request(**{field: value})


@pytest.mark.parametrize(
    "changes", [{"schema": 3}, {"schema": True}, {"schema": 2, "limit": "max_tokens", "extra": {}}]
)
def test_other_schema_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(ParamsError, match="schema"):
        request_from_body({**REQUEST.body(), **changes})


def test_a_limit_has_one_name_only() -> None:
    with pytest.raises(ParamsError, match="found 'max_completion_tokens'"):
        request(limit="max_completion_tokens", extra={"max_completion_tokens": 9})


def test_half_a_surrogate_pair_is_refused() -> None:
    with pytest.raises(ParamsError, match="UTF-8"):
        _ = request(messages=(Message("user", "a\ud800"),)).key


def test_longer_request_differs_in_its_limit_only() -> None:
    assert REQUEST.longer() == request(max_tokens=200)
