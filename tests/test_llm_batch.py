"""Answers from outside: accepted whole or not at all."""

import json
from pathlib import Path
from typing import Any

import pytest

from porse.errors import AnswersError, CacheError
from porse.llm.batch import Answerer, answer_lines, export_lines, import_answers
from porse.llm.pending import add_pending, load_pending, open_request
from porse.llm.request import Message
from porse.llm.store import Store
from tests.llm_cases import new_store, params, questions, record, request
from tests.llm_server import completion

KEYS = [request(sample=k).key for k in range(3)]
MODEL = Answerer("a language model, offline", "fresh", False)
SAID = "a language model, offline, through batch mode, one fresh context per reply; not an API model"


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = new_store(tmp_path)
    add_pending(store, [open_request(question, params()) for question in questions(3)])
    return store


def simple(key: str, text: Any = "an answer", **more: Any) -> dict[str, Any]:
    return {"custom_id": key, "text": text, **more}


def response(key: str, status: int = 200, **changes: Any) -> dict[str, Any]:
    body = completion({"model": "test-model", "messages": [{"content": key[:4]}]}, **changes)
    return {"id": "1", "custom_id": key, "response": {"status_code": status, "body": body}, "error": None}


def failed(key: str, status: int, body: Any) -> dict[str, Any]:
    return {"id": "1", "custom_id": key, "response": {"status_code": status, "body": body}, "error": None}


def bring(store: Store, *answers: Any, answered_by: Answerer = MODEL) -> list[tuple[str, bool]]:
    path = store.state_dir / "answers.jsonl"
    path.write_text("".join(f"{json.dumps(answer)}\n" for answer in answers), encoding="utf-8")
    accepted = import_answers(answer_lines(path), "answers.jsonl", answered_by, load_pending(store), store)
    return [(item.record.key, item.fresh) for item in accepted]


def refused(store: Store, *answers: Any) -> str:
    """Returns the message of a refusal, after checking that nothing was recorded."""
    before = list(store.all_keys())
    with pytest.raises(AnswersError) as caught:
        bring(store, *answers)
    assert list(store.all_keys()) == before
    return str(caught.value)


def test_export_is_the_batch_format_of_the_provider(store: Store) -> None:
    lines = [json.loads(line) for line in export_lines(load_pending(store)).splitlines()]
    assert [line["custom_id"] for line in lines] == KEYS
    assert lines[0] == {
        "custom_id": KEYS[0],
        "method": "POST",
        "url": "/v1/chat/completions",
        "body": {
            "model": "test-model",
            "messages": [
                {"role": "system", "content": "You write rewards.\nTorch only."},
                {"role": "user", "content": "Fly to the target."},
            ],
            "temperature": 0.5,
            "top_p": 0.9,
            "max_tokens": 100,
        },
    }


def test_export_keeps_one_request_on_one_line(store: Store) -> None:
    odd = questions(1, messages=(Message("user", "a\nb\u2028c\x85d"),))
    assert export_lines([open_request(odd[0], params())]).count("\n") == 1


def test_simple_answers_are_recorded(store: Store) -> None:
    assert bring(store, simple(KEYS[1], "one"), simple(KEYS[0], ["line 1", "line 2"])) == [
        (KEYS[1], True),
        (KEYS[0], True),
    ]
    found = store.read(KEYS[0])
    assert found is not None
    assert found.answer.text == "line 1\nline 2"
    assert found.provenance.answered_by == SAID
    assert found.provenance.mode == "batch"
    assert found.provenance.origin.subject == "reward 1"
    assert found.answer.prompt_tokens is None
    assert [request.key for request in load_pending(store)] == [KEYS[2]]


@pytest.mark.parametrize(
    ("answered_by", "said"),
    [
        (MODEL, SAID),
        (
            Answerer(" a language model, offline ", "shared", False),
            "a language model, offline, through batch mode, several replies in one context; not an API model",
        ),
        (Answerer("Ada", "unknown", False), "Ada, through batch mode, contexts unknown; not an API model"),
    ],
)
def test_who_answered_is_said(store: Store, answered_by: Answerer, said: str) -> None:
    bring(store, simple(KEYS[0]), answered_by=answered_by)
    found = store.read(KEYS[0])
    assert found is not None
    assert found.provenance.answered_by == said


def test_the_model_of_a_batch_service_is_named(store: Store) -> None:
    service = Answerer("batch 17", "fresh", True)
    bring(store, response(KEYS[0], model="test-model-2026-01-31"), answered_by=service)
    found = store.read(KEYS[0])
    assert found is not None
    expected = "test-model-2026-01-31 by batch 17, through batch mode, one fresh context per reply; an API model"
    assert found.provenance.answered_by == expected


def test_an_alias_of_the_profile_is_the_model(store: Store) -> None:
    assert "`aliases` of the profile" in refused(store, response(KEYS[0], model="vendor/test-model"))
    add_pending(store, [open_request(question, params(aliases=("vendor/test-model",))) for question in questions(1)])
    assert bring(store, response(KEYS[0], model="vendor/test-model")) == [(KEYS[0], True)]


def test_thoughts_that_use_up_the_limit_are_a_truncation(store: Store) -> None:
    choice = {"index": 0, "message": {"role": "assistant", "content": ""}, "finish_reason": "length"}
    bring(store, response(KEYS[0], choices=[choice]))
    found = store.read(KEYS[0])
    assert found is not None
    assert (found.answer.text, found.truncated) == ("", True)


def test_a_dialect_goes_out_with_the_export(store: Store) -> None:
    asked = questions(1, temperature=None, limit="max_completion_tokens", extra={"reasoning_effort": "low"})
    add_pending(store, [open_request(asked[0], params())])
    (line,) = export_lines([item for item in load_pending(store) if item.key == asked[0].request.key]).splitlines()
    body = json.loads(line)["body"]
    assert set(body) == {"model", "messages", "top_p", "max_completion_tokens", "reasoning_effort"}


def test_a_byte_order_mark_is_read_over(store: Store, tmp_path: Path) -> None:
    path = tmp_path / "answers.jsonl"
    path.write_bytes(b"\xef\xbb\xbf" + json.dumps(simple(KEYS[0])).encode() + b"\r\n")
    import_answers(answer_lines(path), "answers.jsonl", MODEL, load_pending(store), store)
    (tmp_path / f"{KEYS[1]}.txt").write_bytes(b"\xef\xbb\xbfa text\n")
    import_answers(answer_lines(tmp_path), "texts", MODEL, load_pending(store), store)
    found = [store.read(key) for key in KEYS]
    assert [item and item.answer.text for item in found] == ["an answer", "a text", None]


def test_provider_answers_are_recorded(store: Store) -> None:
    assert bring(store, *[response(key) for key in KEYS]) == [(key, True) for key in KEYS]
    found = store.read(KEYS[2])
    assert found is not None
    assert found.answer.text == f"reply to {KEYS[2][:4]}"
    assert (found.answer.prompt_tokens, found.answer.completion_tokens) == (100, 10)
    assert found.provenance.request_id == "chatcmpl-1"
    assert found.cost_usd == pytest.approx((100 * 2.0 + 10 * 10.0) / 1e6)


def test_a_truncated_answer_is_flagged(store: Store) -> None:
    bring(store, simple(KEYS[0], "cut", finish_reason="length"))
    found = store.read(KEYS[0])
    assert found is not None
    assert found.truncated


def test_answers_as_a_directory_of_texts(store: Store, tmp_path: Path) -> None:
    directory = tmp_path / "answers"
    directory.mkdir()
    (directory / f"{KEYS[0]}.md").write_text("Größe\nb\n", encoding="utf-8")
    (directory / f"{KEYS[1]}.txt").write_text("c", encoding="utf-8")
    (directory / "notes.pdf").write_text("not an answer")
    import_answers(answer_lines(directory), "answers", MODEL, load_pending(store), store)
    found = [store.read(key) for key in KEYS]
    assert [item and item.answer.text for item in found] == ["Größe\nb", "c", None]


def test_importing_again_changes_nothing(store: Store) -> None:
    answers = [simple(key) for key in KEYS]
    bring(store, *answers)
    before = store.path(KEYS[0]).read_bytes()
    assert bring(store, *answers) == [(key, False) for key in KEYS]
    assert store.path(KEYS[0]).read_bytes() == before


def test_unknown_id_is_refused(store: Store) -> None:
    assert "line 2: no open request has the id 000000000000" in refused(store, simple(KEYS[0]), simple("0" * 64))


@pytest.mark.parametrize("key", ["", "../../etc/passwd", "../" * 20 + "abcd", KEYS[0].upper()])
def test_id_of_another_form_is_refused(store: Store, key: str) -> None:
    assert "no open request" in refused(store, simple(key))


def test_duplicate_id_is_refused(store: Store) -> None:
    assert f"line 2: id {KEYS[0][:12]} stands in line 1 already" in refused(store, simple(KEYS[0]), simple(KEYS[0]))


def test_contradiction_with_a_record_is_refused(store: Store) -> None:
    store.write(record("recorded", sample=0))
    text = refused(store, simple(KEYS[1]), simple(KEYS[0], "another"))
    assert f"line 2: {KEYS[0][:12]} is recorded with a different reply" in text


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        ({"custom_id": KEYS[0]}, "expected a text"),
        (simple(KEYS[0], ""), "expected a text"),
        (simple(KEYS[0], " \n"), "expected a text"),
        (simple(KEYS[0], 3), "expected a text"),
        (simple(KEYS[0], ["a", 3]), "expected a text"),
        (simple(KEYS[0], "a\ud800"), "UTF-8"),
        (simple(KEYS[0], finish_reason="bored"), "finish_reason"),
        ({"text": "no id"}, "custom_id"),
        ([], "custom_id"),
        (response(KEYS[0], status=500), "status 500"),
        (response(KEYS[0], choices=[]), "one choice"),
        (response(KEYS[0], model="other-model"), "other-model"),
        ({**response(KEYS[0]), "error": {"message": "expired"}}, "expired"),
        ({**response(KEYS[0]), "error": {"code": "batch_expired", "message": "too late"}}, "an error: too late"),
        (failed(KEYS[0], 400, {"error": {"message": "prompt is too long"}}), "status 400: prompt is too long"),
        (failed(KEYS[0], 500, "upstream broke"), "status 500: upstream broke"),
        (failed(KEYS[0], 200, {"error": {"code": 429, "message": "slow down"}}), "status 429: slow down"),
        ({"custom_id": KEYS[0], "response": "x"}, "response object"),
        ({"custom_id": KEYS[0], "response": {"status_code": 200}}, "chat completion"),
    ],
)
def test_unusable_answer_is_refused_and_the_others_with_it(store: Store, answer: Any, reason: str) -> None:
    text = refused(store, simple(KEYS[1]), answer, simple(KEYS[2]))
    assert "found 1 wrong: line 2: " in text
    assert reason in text


def test_every_wrong_line_is_named(store: Store) -> None:
    text = refused(store, simple("0" * 64), simple(KEYS[0]), simple(KEYS[1], ""))
    assert "found 2 wrong: line 1: " in text
    assert "; line 3: " in text


@pytest.mark.parametrize("content", [b"not json\n", b"\xff\xfe\n", b"", b"\n\n", b"[" * 100_000])
def test_other_bytes_are_refused(store: Store, tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "answers.jsonl"
    path.write_bytes(content)
    with pytest.raises(AnswersError):
        import_answers(answer_lines(path), "answers.jsonl", MODEL, load_pending(store), store)
    assert list(store.all_keys()) == []


def test_who_answered_must_be_said(store: Store) -> None:
    with pytest.raises(AnswersError, match="--answered-by"):
        bring(store, simple(KEYS[0]), answered_by=Answerer("  ", "fresh", False))


def test_a_failed_write_records_nothing(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    publish = Store._publish
    calls: list[Path] = []

    def failing(self: Store, item: Any, temporary: Path, path: Path) -> bool:
        calls.append(path)
        if len(calls) == 2:
            raise OSError(28, "No space left on device")
        return publish(self, item, temporary, path)

    monkeypatch.setattr(Store, "_publish", failing)
    with pytest.raises(CacheError, match=r"No space.*Nothing was recorded"):
        bring(store, *[simple(key) for key in KEYS])
    assert list(store.all_keys()) == []
    assert len(load_pending(store)) == 3


def test_damaged_pending_file_is_named(store: Store) -> None:
    path = store.state_dir / "pending" / f"{KEYS[0]}.json"
    path.write_text(path.read_text("utf-8").replace("0.5", "0.6"), encoding="utf-8")
    with pytest.raises(CacheError, match="Expected an open request in"):
        load_pending(store)


def test_pending_that_is_recorded_by_other_means_is_forgotten(store: Store) -> None:
    store.write(record(sample=1))
    assert [request.key for request in load_pending(store)] == [KEYS[0], KEYS[2]]
