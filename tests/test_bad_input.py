"""What a user can get wrong ends in one paragraph that says what was expected, what was found and what to do."""

import importlib
import shutil

import pytest
from click.testing import CliRunner

from porse.tables import CANDIDATES, FEEDBACK, MEMBER_FEEDBACK, MEMBERS, write

GENERATE = [
    "--inputs",
    "inputs/generate.json",
    "--iteration",
    "1",
    "--start",
    "start",
    "--prompts",
    "prompts",
    "--cache",
    "llm_cache",
    "--out",
    "out",
]


@pytest.fixture
def project(root, tmp_path, monkeypatch):
    """A folder with the committed files that stages read, and an iteration's start."""
    for name in ("presets", "prompts", "llm_cache", "porse", "stages", "iterations"):
        shutil.copytree(root / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("params.yaml", "dvc.yaml", "requirements.lock"):
        shutil.copy(root / name, tmp_path)
    write(tmp_path / "start" / "winner.parquet", CANDIDATES, [])
    write(tmp_path / "start" / "feedback.parquet", FEEDBACK, [])
    write(tmp_path / "start" / "members.parquet", MEMBERS, [])
    write(tmp_path / "start" / "member_feedback.parquet", MEMBER_FEEDBACK, [])
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PORSE_LLM_MODE", raising=False)
    return tmp_path


def stage(name, *words):
    return CliRunner().invoke(importlib.import_module(f"stages.{name}").main, list(words))


def generate():
    """Runs stage resolve, and where it can, stage generate."""
    resolved = stage("resolve", "--params", "params.yaml", "--out", "inputs")
    return stage("generate", *GENERATE) if resolved.exit_code == 0 else resolved


def change(project, before, after):
    path = project / "params.yaml"
    text = path.read_text()
    assert before in text
    path.write_text(text.replace(before, after))


def test_the_committed_project_generates_from_its_recorded_replies(project):
    done = generate()
    assert done.exit_code == 0, done.output
    assert (project / "out" / "replies.parquet").exists()


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("task: Quadcopter", "task: Quadcoper", ["'Quadcoper'", "Quadcopter", "porse tasks"]),
        ("method: porse", "method: eurika", ["method", "porse", "eureka"]),
        ("seed: 1\n", "", ["parameter seed", "found none"]),
        ("temperature: 1.0", "temperature: 5", ["llm.temperature", "[0, 2]", "5"]),
        ("temperature: 1.0", "temperature: 0.5", ["llm_cache", "iteration 1", "temperature", "porse llm export"]),
        ("gamma: null", "gamma: [", ["YAML", "params.yaml"]),
    ],
)
def test_a_wrong_parameter_stops_the_stage_in_one_paragraph(project, before, after, words):
    change(project, before, after)
    done = generate()
    assert done.exit_code == 1
    assert [word for word in words if word not in done.output] == []
    assert [line for line in done.output.splitlines() if line.startswith("Error: ")] == done.output.splitlines()[:1]
    # A list of missing replies has its keys and commands on lines of their own.
    assert (len(done.output.splitlines()) > 1) is ("llm_cache" in words)
    assert not (project / "out").exists()


def test_an_edited_reply_is_not_believed(project):
    for record in (project / "llm_cache").rglob("*.json"):
        record.write_text(record.read_text().replace("distance", "Distance"))
    done = generate()
    assert done.exit_code == 1
    assert "cannot be trusted" in done.output
    assert not (project / "out").exists()


def test_a_stage_without_its_input_says_which_stage_makes_it(project):
    assert generate().exit_code == 0
    words = ["--inputs", "inputs/eliminate.json", "--iteration", "1", "--rung", "1", "--keep", "5"]
    done = stage("eliminate", *words, "--trained", "nowhere", "--out", "out")
    assert done.exit_code == 1
    assert "run `porse repro` to make it" in done.output


def test_a_stage_without_its_inputs_says_which_stage_makes_them(project):
    done = stage("generate", *GENERATE)
    assert done.exit_code == 1
    assert "run `porse repro resolve`" in done.output
