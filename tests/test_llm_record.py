"""A record that was changed in any way is refused; one that was not is read back exactly."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from porse.errors import CacheError
from porse.identity import content_id
from porse.llm.record import parse_record
from porse.llm.store import Store
from tests.llm_cases import RECORD, record

KEY = RECORD.key
DATA = RECORD.render()
TEXT = st.text(st.characters(exclude_categories=["Cs"]), min_size=1)


def edited(change: Callable[[dict[str, Any]], object], rehash: bool = False) -> bytes:
    """Returns the record's file after a change, with a fitting payload hash if asked."""
    document = json.loads(DATA)
    change(document)
    if rehash:
        del document["payload_hash"]
        document["payload_hash"] = content_id("record", document)
    return json.dumps(document).encode()


def price(document: dict[str, Any]) -> dict[str, Any]:
    return document["provenance"]["price"]


def test_a_reply_that_was_cut_off_before_its_first_letter_has_a_format_of_its_own() -> None:
    written = record("", "length")
    assert json.loads(written.render())["format"] == 2
    assert json.loads(written.render())["reply"]["text"] == []
    assert parse_record(written.render(), written.key, "x.json") == written
    assert json.loads(DATA)["format"] == 1
    with pytest.raises(CacheError, match="cut off before its first letter"):
        parse_record(record("", "stop").render(), KEY, "x.json")


def test_read_gives_what_was_written() -> None:
    assert parse_record(DATA, KEY, "x.json") == RECORD


@given(TEXT)
def test_any_text_survives(text: str) -> None:
    written = record(text)
    assert parse_record(written.render(), written.key, "x.json").answer.text == text


def test_texts_are_stored_line_by_line() -> None:
    assert json.loads(DATA)["reply"]["text"] == ["def reward():", "    return 1", ""]
    assert json.loads(DATA)["request"]["messages"][0]["content"] == ["You write rewards.", "Torch only."]


def written(change: Callable[[dict[str, Any]], object]) -> bytes:
    """Returns the record's file after a change, with a fitting hash, laid out as the program does."""
    document = json.loads(edited(change, rehash=True))
    return (json.dumps(document, indent=2, sort_keys=True, ensure_ascii=False) + "\n").encode()


@pytest.mark.parametrize(
    "data",
    [
        edited(lambda document: None),
        DATA.replace(b'"format": 1,', b'"format": 2, "format": 1,'),
        DATA.replace(b'"reply": {', b'"reply": 1, "reply": {'),
        DATA.replace(b"\n", b"\r\n"),
        DATA + b"\n",
        DATA.replace(b"Torch", b"\\u0054orch"),
        written(lambda document: document.update(format=True)),
        written(lambda document: document.update(format=1.0)),
        written(lambda document: document["reply"].update(text=["def reward():\n    return 1", ""])),
        written(lambda document: document["request"]["messages"][0].update(content=["You write rewards.\nTorch only."])),
        written(lambda document: document["request"].update(extra={})),
        written(lambda document: document["request"].update(limit="max_tokens")),
    ],
    ids=["layout", "a field twice", "an object twice", "line ends", "a line too many", "escaped", "true", "1.0", "a break in a line",
         "a break in a message", "an empty extra", "a limit that goes without saying"],
)  # fmt: skip
def test_other_bytes_that_say_the_same_are_refused(data: bytes) -> None:
    with pytest.raises(CacheError, match=r"x\.json cannot be trusted"):
        parse_record(data, KEY, "x.json")
    assert parse_record(written(lambda document: None), KEY, "x.json") == RECORD


@pytest.mark.parametrize("cache", ["llm_cache", "published/quadcopter-porse/llm_cache"])
def test_every_committed_record_is_read(cache: str) -> None:
    store = Store(Path(__file__).parents[1] / cache)
    keys = list(store.all_keys())
    assert len(keys) > 10
    assert [record.key for key in keys if (record := store.read(key))] == keys


def test_cost_by_the_recorded_prices() -> None:
    # 1000 prompt tokens at 2 USD and 200 completion tokens at 10 USD per million.
    assert RECORD.cost_usd == pytest.approx(0.002 + 0.002)


@pytest.mark.parametrize(
    "change",
    [
        lambda document: document["reply"]["text"].append("more"),
        lambda document: document["reply"].update(finish_reason="length"),
        lambda document: document["reply"].update(prompt_tokens=1),
        lambda document: document["request"].update(temperature=0.6),
        lambda document: document["request"]["messages"][0].update(role="user"),
        lambda document: document["provenance"].update(answered_by="somebody"),
        lambda document: document["provenance"]["price"].update(usd_per_million_prompt_tokens=0),
        lambda document: document.update(format=2),
        lambda document: document.update(extra=1),
        lambda document: document.update(key="0" * 64),
        lambda document: document.pop("payload_hash"),
        lambda document: document.pop("reply"),
    ],
)
def test_edit_is_refused(change: Callable[[dict[str, Any]], object]) -> None:
    with pytest.raises(CacheError, match=r"x\.json cannot be trusted: expected payload hash .* edited"):
        parse_record(edited(change), KEY, "x.json")


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (lambda document: document["request"].update(temperature=0.6), "key"),
        (lambda document: document["request"].update(temperature=9), "record of format 1"),
        (lambda document: document["request"].update(temperature=10**400), "record of format 1"),
        (lambda document: document["request"].update(top_p=-(10**400)), "record of format 1"),
        (lambda document: price(document).update(usd_per_million_prompt_tokens=10**400), "to be a price"),
        (lambda document: document["request"].update(colour="red"), "record of format 1"),
        (lambda document: document["request"].pop("model"), "record of format 1"),
        (lambda document: document["reply"].pop("text"), "record of format 1"),
        (lambda document: document.update(format=3), "format 3"),
        (lambda document: document.update(format=2), "format 2"),
        (lambda document: document["reply"].update(text=[]), "a text, or in format 2"),
        (lambda document: document["reply"].update(text="a text"), "list of lines"),
        (lambda document: document["reply"].update(text=["a", 1]), "list of lines"),
        (lambda document: document["request"]["messages"][0].update(content="a text"), "list of lines"),
        (lambda document: document["reply"].update(prompt_tokens="abc"), "prompt_tokens to be a count or null"),
        (lambda document: document["reply"].update(completion_tokens=[1]), "completion_tokens to be a count"),
        (lambda document: document["reply"].update(completion_tokens=2**70), "completion_tokens to be a count"),
        (lambda document: document["reply"].update(prompt_tokens=-1), "prompt_tokens to be a count"),
        (lambda document: document["reply"].update(prompt_tokens=True), "prompt_tokens to be a count"),
        (lambda document: document["reply"].update(prompt_tokens=1.5), "prompt_tokens to be a count"),
        (lambda document: document["reply"].update(finish_reason=["stop"]), "finish_reason to be stop or length"),
        (lambda document: price(document).update(usd_per_million_prompt_tokens="dear"), "prompt_tokens to be a price"),
        (lambda document: price(document).update(usd_per_million_prompt_tokens=1e300), "prompt_tokens to be a price"),
        (lambda document: price(document).update(usd_per_million_completion_tokens=None), "to be a price"),
        (lambda document: document["provenance"].update(answered_by=7), "answered_by to be a text"),
        (lambda document: document["provenance"].update(mode="guess"), "mode to be record, batch or refresh"),
        (lambda document: document["provenance"].update(endpoint={}), "endpoint to be profile, override or none"),
        (lambda document: document["provenance"]["origin"].update(iteration="one"), "iteration to be a count"),
        (lambda document: document["provenance"]["origin"].update(iteration=2**70), "iteration to be a count"),
        (lambda document: document["provenance"]["origin"].update(stage=None), "stage to be a text"),
        (lambda document: document.update(extra=1), "extra"),
        (lambda document: document.update(request=[]), "record of format 1"),
        (lambda document: document.update(key="0" * 64), "key"),
    ],
)
def test_edit_with_a_fitting_hash_is_refused(change: Callable[[dict[str, Any]], object], found: str) -> None:
    with pytest.raises(CacheError, match=found) as caught:
        parse_record(edited(change, rehash=True), KEY, "x.json")
    assert "The recorded reply x.json cannot be trusted" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_every_truncation_is_refused() -> None:
    for length in range(len(DATA)):
        with pytest.raises(CacheError):
            parse_record(DATA[:length], KEY, "x.json")


def test_every_changed_letter_is_refused() -> None:
    for place, byte in enumerate(DATA):
        with pytest.raises(CacheError):
            parse_record(DATA[:place] + bytes([byte ^ 1]) + DATA[place + 1 :], KEY, "x.json")


def test_misnamed_record_is_refused() -> None:
    with pytest.raises(CacheError, match="misnamed"):
        parse_record(DATA, record(sample=1).key, "x.json")


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"null",
        b"[]",
        b"\xff\xfe",
        b'{"a": NaN}',
        b'{"a": 1e999}',
        b'{"a": "\\ud800"}',
        b"[" * 100_000,
        b'{"a":' * 100_000,
        b'{"a": ' + b"9" * 10_000 + b"}",
    ],
    ids=[
        "empty",
        "null",
        "list",
        "not UTF-8",
        "NaN",
        "infinity",
        "surrogate",
        "deep list",
        "deep object",
        "long number",
    ],
)
def test_other_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(CacheError, match=r"x\.json cannot be trusted"):
        parse_record(data, KEY, "x.json")


def test_error_says_how_to_go_on() -> None:
    with pytest.raises(CacheError, match=r"git checkout -- x\.json"):
        parse_record(b"", KEY, "x.json")
