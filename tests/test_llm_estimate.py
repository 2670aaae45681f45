"""`porse llm estimate`: what a run still has to ask."""

import dataclasses
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from porse import tables
from porse.cli import main
from porse.config import Params
from porse.llm.cli import with_profile
from porse.llm.record import Answer, Record
from porse.llm.request import Message, Origin, request_of
from porse.llm.store import Store
from porse.llm_estimate import Line, Planned, estimated, planned_questions
from porse.tasks import find_task
from tests.llm_cases import PROVENANCE

ABOUT = "to hover"


def records_of(cache: Path) -> list[Record]:
    store = Store(cache)
    return [record for key in store.all_keys() if (record := store.read(key)) is not None]


def to_ask(lines: list[Line]) -> dict[tuple[int, str, str], int]:
    return {(line.iteration, line.stage, line.kind): line.to_ask for line in lines if line.to_ask}


def planned(stage: str, iteration: int, subject: str, opening: tuple[str, ...] = ("Write.",)) -> Planned:
    return Planned(Origin(stage, iteration, subject), subject.split()[0], opening, ABOUT)


def reply(
    params: Params, stage: str, iteration: int, subject: str, prompt: int | None = None, completion: int | None = None
) -> Record:
    """Returns a record whose prompt has 17 bytes and whose reply has 20."""
    messages = (Message("system", "Write."), Message("user", f"{ABOUT}, {iteration}"))
    provenance = dataclasses.replace(PROVENANCE, origin=Origin(stage, iteration, subject))
    sample = len(subject) + 7 * iteration
    return Record(request_of(params.llm, messages, sample), Answer("x" * 20, "stop", prompt, completion), provenance)


def test_the_committed_run_has_nothing_left_to_ask(params: Params, root: Path) -> None:
    lines = estimated(planned_questions(params, root / "prompts"), records_of(root / "llm_cache"), params)
    # K = 6 rewards and mappings; later one elite is carried over; one question at each half time.
    assert [line.planned for line in lines] == [6, 6, 1] + 4 * [5, 5, 1]
    assert to_ask(lines) == {}


def test_the_schedule_asks_as_the_stages_do(params: Params, root: Path) -> None:
    replies = tables.read(root / "published" / "quadcopter-porse" / "results" / "replies.parquet", tables.REPLIES)
    keys = {row["key"] for row in replies}
    asked = [record.provenance.origin for record in records_of(root / "llm_cache") if record.request.key in keys]
    found = [question.origin for question in planned_questions(params, root / "prompts")]
    assert sorted(map(str, found)) == sorted(map(str, asked))


def test_what_follows_an_open_question_is_open(params: Params, root: Path) -> None:
    records = [
        record
        for record in records_of(root / "llm_cache")
        if record.provenance.origin not in (Origin("generate", 3, "reward 2"), Origin("mutate", 4, "alpha, attempt 0"))
    ]
    lines = estimated(planned_questions(params, root / "prompts"), records, params)
    assert to_ask(lines) == {
        (3, "generate", "reward"): 1,
        (3, "mutate", "beta"): 1,
        (4, "generate", "reward"): 5,
        (4, "generate", "mapping"): 5,
        (4, "mutate", "alpha"): 1,
        (5, "generate", "reward"): 5,
        (5, "generate", "mapping"): 5,
        (5, "mutate", "beta"): 1,
    }


def test_replies_of_another_model_task_or_setting_answer_nothing(params: Params, root: Path) -> None:
    records = records_of(root / "llm_cache")
    for changed in (
        dataclasses.replace(params, llm=with_profile(params.llm, "gpt-4o-mini")),
        dataclasses.replace(params, llm=dataclasses.replace(params.llm, temperature=0.5)),
        dataclasses.replace(params, task="Anymal"),
    ):
        lines = estimated(planned_questions(changed, root / "prompts"), records, changed)
        assert sum(to_ask(lines).values()) == 57


@pytest.mark.parametrize(
    ("changes", "count"),
    [
        ({"generator": "grammar"}, 0),
        # Spliced mappings are drawn: 6 + 4 x 5 rewards and 5 questions at half time are left.
        ({"generate": {"mappings": "spliced"}}, 31),
        ({"candidate": {"goal": "sparse"}}, 31),
        ({"generate": {"iterations": "first"}}, 13),
        ({"mutate": {"mutants": 0}}, 52),
    ],
)
def test_only_what_a_model_answers_is_planned(params: Params, root: Path, changes: dict, count: int) -> None:
    for section, values in changes.items():
        own = dataclasses.replace(getattr(params, section), **values) if isinstance(values, dict) else values
        params = dataclasses.replace(params, **{section: own})
    assert len(planned_questions(params, root / "prompts")) == count


def test_sizes_are_those_of_recorded_replies_of_the_same_kind(params: Params) -> None:
    questions = [planned("generate", n, f"reward {k}") for n in (1, 2) for k in range(2)]
    records = [reply(params, "generate", 1, "reward 0", 1000, 200), reply(params, "generate", 1, "reward 1", 3000, 500)]
    [first, second] = estimated(questions, records, params)
    assert (first.planned, first.recorded) == (2, 2)
    assert (second.to_ask, second.prompt_tokens, second.completion_tokens) == (2, 2000.0, 350.0)
    # With a reply of a later iteration, those of the first are no measure any more.
    [_, second] = estimated(questions, [*records, reply(params, "generate", 2, "reward 0", 9000, 70)], params)
    assert (second.to_ask, second.prompt_tokens, second.completion_tokens) == (1, 9000.0, 70.0)


def test_bytes_stand_for_tokens_that_nobody_counted(params: Params) -> None:
    questions = [planned("generate", 1, "reward 0"), planned("generate", 1, "reward 1")]
    [line] = estimated(questions, [reply(params, "generate", 1, "reward 1")], params)
    assert (line.to_ask, line.prompt_tokens, line.completion_tokens) == (1, 17 / 4, 20 / 4)


def test_a_kind_of_which_nothing_is_recorded_is_as_long_as_it_may_be(params: Params) -> None:
    [line] = estimated([planned("generate", 1, "reward 0", ("12345678", "1234"))], [], params)
    assert (line.prompt_tokens, line.completion_tokens) == (12 / 4, 4096.0)


def test_repairs_are_expected_as_often_as_they_were_recorded(params: Params) -> None:
    questions = [planned("generate", n, f"reward {k}") for n in (1, 2) for k in range(2)]
    records = [
        reply(params, "generate", 1, "reward 0", 100, 10),
        reply(params, "generate", 1, "reward 1", 100, 10),
        reply(params, "validate-code", 1, "reward 0, attempt 1", 300, 20),
    ]
    lines = estimated(questions, records, params)
    # One repair of two functions: for two more, one more.
    assert [(line.stage, line.to_ask, line.prompt_tokens) for line in lines] == [
        ("generate", 0, 100.0),
        ("generate", 2, 100.0),
        ("validate-code", 1, 300.0),
    ]


def test_the_command_prints_requests_tokens_and_cost(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("llm_cache", "presets", "prompts"):
        shutil.copytree(root / name, tmp_path / name)
    shutil.copy(root / "params.yaml", tmp_path)
    result = CliRunner().invoke(main, ["llm", "estimate", "--profile", "gpt-4o-mini"])
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    summary = next(line for line in lines if line.startswith("to ask: "))
    words = summary.replace(",", "").split()
    requests, prompt, completion, usd = int(words[2]), int(words[4]), int(words[7]), float(words[10])
    assert requests == 57
    # 0.15 and 0.60 USD a million.
    assert usd == pytest.approx((prompt * 0.15 + completion * 0.60) / 1e6, abs=1e-6)
    # 52 functions of 9 attempts, 5 questions of 3, each asked twice where it is cut off.
    assert f"{2 * (52 * 9 + 5 * 3)} requests at most" in summary
    assert lines[1].split()[:6] == ["1", "generate", "reward", "6", "0", "6"]
    assert "the ledger of this checkout, which budgets count: 0 requests" in lines[-1]
    unknown = CliRunner().invoke(main, ["llm", "estimate", "--profile", "x"])
    assert unknown.exit_code == 1
    assert "Expected --profile to be one of offline" in unknown.stderr


def test_the_description_of_the_task_is_in_every_question(root: Path) -> None:
    # The tasks of the committed replies.
    asked = dict.fromkeys(("Quadcopter", "FrankaCabinet", "DoorOpenOutward", "PushBlock"), 0)
    for record in records_of(root / "llm_cache"):
        [about] = [
            task
            for task in asked
            if any(find_task(task).DESCRIPTION in message.content for message in record.request.messages)
        ]
        asked[about] += 1
    assert asked == {"Quadcopter": 151, "FrankaCabinet": 169, "DoorOpenOutward": 147, "PushBlock": 123}
