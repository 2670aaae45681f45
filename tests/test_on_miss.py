"""`llm.on_miss`: without a recorded reply a run stops, or, where it is told so, the grammar answers in the model's place."""

import dataclasses

import pytest

from porse.errors import CacheMiss
from porse.generation.answers import answers
from porse.llm.record import Answer, Record
from porse.llm.request import Message, Origin, Question, request_of
from porse.llm.store import Store
from tests.llm_cases import PROVENANCE


@pytest.fixture(autouse=True)
def _frozen(monkeypatch):
    monkeypatch.delenv("PORSE_LLM_MODE", raising=False)


def with_miss(params, on_miss):
    return dataclasses.replace(params, llm=dataclasses.replace(params.llm, on_miss=on_miss))


def asked(params):
    """Two questions for a reward, and one for values of beta."""
    return [
        Question(
            request_of(params.llm, (Message("user", text),), sample),
            Origin("generate", 1, text),
        )
        for text, sample in (("reward", 0), ("reward", 1), ("beta", 0))
    ]


KINDS = ["reward", "reward", "beta"]


@pytest.fixture
def cache(params, tmp_path):
    """A cache that holds the reply to the second question alone."""
    store = Store(tmp_path / "llm_cache")
    store.write(Record(asked(params)[1].request, Answer("recorded", "stop", 3, 4), PROVENANCE))
    return store.cache_dir


def test_the_default_stops_and_says_how_to_go_on_without_a_model(params, cache):
    assert params.llm.on_miss == "error"
    with pytest.raises(
        CacheMiss, match=r"(?s)found none for 2:\n.*\nTo go on without a model, set llm.on_miss to grammar\."
    ):
        answers(KINDS, asked(params), params, cache)


def test_the_grammar_answers_what_is_not_recorded_and_nothing_else(params, cache):
    found = answers(KINDS, asked(params), with_miss(params, "grammar"), cache)
    # PROVENANCE is that of the recorded reply.
    assert [reply.answered_by for reply in found] == ["grammar", PROVENANCE.answered_by, "grammar"]
    assert found[1].text == "recorded"
    # A reply of the grammar is that of a run that the grammar writes alone: it follows from seed and question.
    alone = answers(KINDS, asked(params), dataclasses.replace(params, generator="grammar"), cache)
    assert [found[0], found[2]] == [alone[0], alone[2]]
    assert "def compute_reward" in found[0].text


def test_what_is_asked_does_not_depend_on_it(params):
    keys = [[question.request.key for question in asked(with_miss(params, way))] for way in ("error", "grammar")]
    assert keys[0] == keys[1]


def test_in_batch_mode_questions_wait_all_the_same(params, cache, monkeypatch):
    from porse.errors import RepliesPending

    monkeypatch.setenv("PORSE_LLM_MODE", "batch")
    with pytest.raises(RepliesPending, match="found none for 2"):
        answers(KINDS, asked(params), with_miss(params, "grammar"), cache)
