"""The workflows for a fork say the same as `.ci/run` and the Makefile, and ask for no more than they need."""

import re

import pytest
import yaml

FILES = (".github/workflows/porse.yml", ".gitlab-ci.yml")


def commands(root, name):
    """What each job runs, by the job's name."""
    document = yaml.safe_load((root / name).read_text())
    if "jobs" in document:
        return {job: [step["run"] for step in each["steps"] if "run" in step] for job, each in document["jobs"].items()}
    before = document["default"]["before_script"]
    return {job: [*before, *document[job]["script"]] for job in ("quick", "complete")}


@pytest.mark.parametrize("name", FILES)
def test_a_quick_job_lints_tests_and_replays_a_drawn_stage_and_a_nightly_one_does_all(root, name):
    found = commands(root, name)
    assert {*found} == {"quick", "complete"}
    assert [line for line in found["quick"] if line.startswith("make")] == [
        "make setup", "make check", "make test", "make replay-sample",
    ]  # fmt: skip
    assert found["complete"][-3:] == ["make setup", ".ci/run", "make test-slow"]


@pytest.mark.parametrize("name", [*FILES, ".ci/run"])
def test_every_target_is_one_of_the_makefile(root, name):
    targets = {*re.findall(r"^([a-z][a-z-]*):", (root / "Makefile").read_text(), re.MULTILINE)}
    asked = {*re.findall(r"^ *(?:- )?(?:run: )?make ([a-z-]+)$", (root / name).read_text(), re.MULTILINE)}
    assert asked
    assert asked <= targets


def test_ci_replays_the_smallest_published_run_and_a_drawn_stage_of_another(root):
    assert "make replay\n" in (root / ".ci" / "run").read_text()
    makefile = (root / "Makefile").read_text()
    assert "replay: setup replay-sample\n\t$(BIN)/porse replay\n" in makefile
    assert "replay-sample: setup\n\t$(BIN)/porse replay --sample 1\n" in makefile


def test_the_workflows_have_no_secret_and_no_right_to_write(root):
    github, gitlab = (yaml.safe_load((root / name).read_text()) for name in FILES)
    assert github["permissions"] == {"contents": "read"}
    assert not any("secrets" in (root / name).read_text() for name in FILES)
    # YAML 1.1 reads `on` as true.
    events = github[True]
    assert events["schedule"] == [{"cron": "17 2 * * *"}]
    assert all(job["timeout-minutes"] <= 360 for job in github["jobs"].values())
    assert gitlab["default"]["cache"]["paths"] == [".venv/"]
    assert sum("actions/cache" in step.get("uses", "") for job in github["jobs"].values() for step in job["steps"]) == 2
