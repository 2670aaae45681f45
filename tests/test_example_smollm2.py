"""The recorded run of a small real model, replayed offline: its failures, its repairs, and how it ends.

Where a prompt, a check or a verdict was changed on purpose, its questions are others: `make record-example`.
"""

import shutil
from collections import Counter

import pytest
import yaml

from porse.errors import CacheMiss
from porse.llm.store import Store
from porse.llm.verify import verify
from smollm2 import CACHE, EXAMPLE, Outcome, committed, params_document, run_functions
from tiny import dvc, make_project
from warm_stages import warm_stages

AGAIN = "run `make record-example` if a prompt or a verdict was changed on purpose"


@pytest.fixture(scope="module")
def replayed() -> Outcome:
    """The functions of the run, from the recorded replies."""
    try:
        return run_functions(CACHE)
    except CacheMiss as error:
        pytest.fail(f"{AGAIN}. {error}", pytrace=False)


def test_every_reply_gets_its_verdict_again(replayed):
    assert replayed.rows == committed().rows, AGAIN


def test_the_run_ends_as_it_did_when_it_was_recorded(replayed):
    assert replayed.error == committed().error, AGAIN


def test_every_attempt_that_the_parameters_allow_was_made(replayed):
    """5 first replies and 2 repairs of each, for one reward and one mapping."""
    attempts = Counter(row["kind"] for row in replayed.rows)
    assert set(attempts) == {"reward", "mapping"}
    assert max(attempts.values()) == 5 * 3
    assert "none in 15 replies" in replayed.error


def test_failures_are_of_many_kinds_and_each_says_what_was_expected_or_found(replayed):
    failed = [row for row in replayed.rows if row["check"] != "ok"]
    assert len({row["check"] for row in failed}) >= 3
    assert all(row["message"].strip() and "\n" not in row["message"] for row in failed)


def test_the_small_model_answered_all_and_nothing_else_did():
    records = [Store(CACHE).read(file.stem) for file in CACHE.rglob("*.json")]
    assert {record.provenance.answered_by for record in records} == {"SmolLM2-135M-Instruct.Q4_1"}
    assert {record.provenance.mode for record in records} == {"record"}
    assert all(record.answer.prompt_tokens and record.answer.completion_tokens for record in records)
    cut = [record for record in records if record.answer.finish_reason == "length"]
    for record in cut:
        counted = record.answer.completion_tokens
        assert counted == record.request.max_tokens


def test_the_recording_is_whole_and_small():
    assert verify(CACHE, {row["key"] for row in committed().rows}) == []
    files = [file for file in EXAMPLE.rglob("*") if file.is_file() and ".porse" not in file.parts]
    assert sum(file.stat().st_size for file in files) < 2 * 2**20


def test_dvc_repro_stops_with_the_same_paragraph(tmp_path_factory):
    with warm_stages(tmp_path_factory.mktemp("warm")) as venv:
        project = make_project(tmp_path_factory.mktemp("example") / "project", params_document(), venv)
        shutil.copytree(CACHE, project / "llm_cache", dirs_exist_ok=True)
        done = dvc(project, "repro", check=False)
    said = done.stdout + done.stderr
    assert done.returncode != 0
    assert "Running stage 'iterations/1/dvc.yaml:validate-code'" in said
    assert f"Error: {committed().error}" in said
    assert "Traceback" not in said
    locks = [project / "dvc.lock", project / "iterations" / "1" / "dvc.lock"]
    finished = [set(yaml.safe_load(path.read_text())["stages"]) for path in locks]
    assert finished == [{"resolve", "begin"}, {"generate"}]
