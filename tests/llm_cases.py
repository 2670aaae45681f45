"""Requests, records and parameters that the tests of the reply cache share."""

import dataclasses
from pathlib import Path
from typing import Any

from porse.config import LlmParams, Profile
from porse.llm.record import Answer, Price, Provenance, Record
from porse.llm.request import Message, Origin, Question, Request
from porse.llm.store import Store

REQUEST = Request(
    model="test-model",
    messages=(Message("system", "You write rewards.\nTorch only."), Message("user", "Fly to the target.")),
    temperature=0.5,
    top_p=0.9,
    max_tokens=100,
    sample=0,
)
ORIGIN = Origin("generate", 2, "reward 3")
ANSWER = Answer("def reward():\n    return 1\n", "stop", 1000, 200)
PROVENANCE = Provenance(
    answered_by="test-model-2026-01-01",
    mode="record",
    profile="local",
    endpoint="profile",
    request_id="chatcmpl-1",
    recorded_at="2026-01-02T03:04:05Z",
    origin=ORIGIN,
    price=Price(2.0, 10.0),
)
RECORD = Record(REQUEST, ANSWER, PROVENANCE)


def request(**changes: Any) -> Request:
    """Returns the common request with some fields changed."""
    return dataclasses.replace(REQUEST, **changes)


def record(text: str = "a reply", finish_reason: str = "stop", **changes: Any) -> Record:
    """Returns the record of a reply to the common request with some fields changed."""
    return Record(request(**changes), dataclasses.replace(ANSWER, text=text, finish_reason=finish_reason), PROVENANCE)


def questions(count: int, **changes: Any) -> list[Question]:
    """Returns questions that differ in their sample."""
    return [Question(request(sample=k, **changes), Origin("generate", 1, f"reward {k + 1}")) for k in range(count)]


def params(
    base_url: str = "", max_usd: float | None = None, max_requests: int | None = None, **changes: Any
) -> LlmParams:
    """Returns the llm section with these budgets and one profile, some of whose fields are changed."""
    profile = Profile("test-model", (), "max_tokens", (), {}, base_url, "", 2.0, 10.0)
    return LlmParams(
        "local", 0.5, 0.9, 100, max_usd, max_requests, "error", {"local": dataclasses.replace(profile, **changes)}
    )


def new_store(directory: Path) -> Store:
    """Returns an empty store as a checkout has it."""
    (directory / "llm_cache").mkdir(parents=True)
    return Store(directory / "llm_cache")
