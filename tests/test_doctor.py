"""`porse doctor` finds what is wrong with a machine and a project, and says what to do about it."""

import json
import os
import shutil
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

from porse import doctor, numerics
from porse.cli import main
from porse.doctor import Finding, findings_text
from tiny import committed_params


@pytest.fixture
def project(root, tmp_path, monkeypatch):
    """The committed files that doctor looks at, as an unpacked source archive has them: no .git."""
    for name in ("presets", "llm_cache", ".dvc", "iterations"):
        shutil.copytree(root / name, tmp_path / name, ignore=shutil.ignore_patterns("cache", "tmp", "config.local"))
    for name in ("params.yaml", "dvc.yaml", "requirements.lock"):
        shutil.copy(root / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def examined(monkeypatch):
    """Returns the findings by check, without the pictures, and the exit code."""
    monkeypatch.setattr(doctor, "renderer", lambda: Finding("renderer", "ok", "not tried"))
    done = CliRunner().invoke(main, ["doctor", "--json"], catch_exceptions=False)
    return {row["check"]: row for row in json.loads(done.stdout)}, done.exit_code


def test_a_clone_is_well_and_an_archive_without_git_is_told_what_to_do(project, monkeypatch):
    found, code = examined(monkeypatch)
    assert code == 1
    assert found["repository"]["state"] == "problem"
    assert "git init && git add ." in found["repository"]["advice"]
    (project / ".git").mkdir()
    found, code = examined(monkeypatch)
    assert [row for row in found.values() if row["state"] == "problem"] == []
    assert code == 0
    assert str(project / ".dvc" / "cache") in found["DVC cache"]["found"]


def test_where_there_is_no_project_that_is_said_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found, code = examined(monkeypatch)
    assert code == 1
    assert [name for name, row in found.items() if row["state"] == "problem"] == ["project"]
    assert "reply cache" not in found


def test_a_project_that_dvc_shall_use_without_git_is_one(project):
    assert doctor.source_control(project).state == "problem"
    (project / ".dvc" / "config.local").write_text("[core]\n    no_scm = true\n")
    assert doctor.source_control(project).state == "ok"


def test_a_wrong_parameter_is_a_problem_in_its_own_words(project):
    text = (project / "params.yaml").read_text()
    (project / "params.yaml").write_text(text.replace("seed: 1\n", "seed: -1\n"))
    found = doctor.parameters(project)
    assert found.state == "problem"
    assert "seed" in found.found


def test_packages_that_differ_from_the_lock_are_named_with_both_versions(tmp_path):
    lock = tmp_path / "requirements.lock"
    lock.write_text("# comment\nclick==0.0.1\nno-such-package-here==3.2.1\nnumpy==2.4.6\n")
    # A project of `porse init` may have other versions, a checkout may not.
    assert doctor.packages(lock).state == "warning"
    (tmp_path / "porse").mkdir()
    found = doctor.packages(lock)
    assert found.state == "problem"
    assert "expected the 3 versions" in found.found
    assert "no-such-package-here none instead of 3.2.1" in found.found
    assert "click 8" in found.found
    assert "numpy" not in found.found
    lock.write_text("numpy==2.4.6+some.build\n")
    assert doctor.packages(lock) == Finding("packages", "ok", "all 1 as in requirements.lock")


def test_a_cpu_without_avx2_is_a_problem_for_portable_and_a_warning_for_fast(tmp_path, monkeypatch):
    info = tmp_path / "cpuinfo"
    monkeypatch.setattr(numerics, "_CPU_INFO", info)
    monkeypatch.setattr(doctor.platform, "machine", lambda: "x86_64")
    info.write_text("model name\t: Old One\nflags\t\t: sse2 fma\n")
    portable, fast = doctor.cpu("portable"), doctor.cpu("fast")
    assert (portable.state, fast.state) == ("problem", "warning")
    assert "Old One, x86_64: without avx2" in portable.found
    assert "numerics: fast" in portable.advice
    info.write_text("model name\t: New One\nflags\t\t: sse2 fma avx2\n")
    assert doctor.cpu("portable").state == "ok"
    assert doctor.cpu("fast").state == "warning"
    monkeypatch.setattr(doctor.platform, "machine", lambda: "aarch64")
    assert "bits differ" in doctor.cpu("portable").found


def test_memory_for_fewer_trainings_than_workers_is_a_warning(monkeypatch):
    monkeypatch.setattr(doctor.os, "sched_getaffinity", lambda _: set(range(8)))
    monkeypatch.delenv("PORSE_WORKERS", raising=False)
    # 8 trainings of 600 MiB would take 4800; 3000 hold 5.
    monkeypatch.setattr(doctor, "memory_mib", lambda: 3000)
    found = doctor.cores_and_memory()
    assert (found.state, found.advice) == ("warning", "set PORSE_WORKERS=5: it changes no result")
    monkeypatch.setenv("PORSE_WORKERS", "5")
    assert doctor.cores_and_memory().state == "ok"
    monkeypatch.setattr(doctor, "memory_mib", lambda: 599)
    assert doctor.cores_and_memory().state == "problem"
    # More trainings than cores are started all the same: 12 of 600 MiB take 7200.
    monkeypatch.setattr(doctor, "memory_mib", lambda: 7199)
    monkeypatch.setenv("PORSE_WORKERS", "12")
    assert "12 trainings at once" in doctor.cores_and_memory().found
    assert doctor.cores_and_memory().state == "warning"
    monkeypatch.setenv("PORSE_WORKERS", "many")
    assert "expected PORSE_WORKERS to be a whole number" in doctor.cores_and_memory().found


def test_without_git_on_the_path_that_is_a_problem(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert doctor.git().state == "problem"


def test_an_edited_reply_is_a_problem_and_an_empty_cache_a_warning(project):
    assert doctor.replies(project / "llm_cache", True).state == "ok"
    # The last one: all committed replies are read.
    record = max((project / "llm_cache").glob("??/*.json"))
    record.write_text(record.read_text().replace('"', "'", 1))
    assert doctor.replies(project / "llm_cache", True).state == "problem"
    assert doctor.replies(project / "none", True).state == "warning"


@pytest.mark.parametrize(
    ("changed", "state"),
    [
        ({}, "warning"),
        ({"generator": "grammar"}, "ok"),
        ({"method": "human"}, "ok"),
        ({"llm": {**committed_params()["llm"], "on_miss": "grammar"}}, "ok"),
    ],
    ids=["model", "grammar", "human", "on-miss"],
)
def test_an_empty_cache_is_a_warning_only_where_a_run_needs_replies(project, changed, state):
    shutil.rmtree(project / "llm_cache")
    (project / "params.yaml").write_text(yaml.safe_dump({**committed_params(), **changed}))
    (found,) = [finding for finding in doctor._project(project) if finding.check == "reply cache"]
    assert found.state == state


def test_a_large_cache_is_read_in_part(project, monkeypatch):
    monkeypatch.setattr(doctor, "RECORDS_READ", 10)
    keys = len(list((project / "llm_cache").glob("??/*.json")))
    # Every ceil(keys / 10)-th of them, the first included.
    step = -(-keys // 10)
    assert (
        f"{keys} recorded replies, {-(-keys // step)} of them read" in doctor.replies(project / "llm_cache", True).found
    )


def test_what_stands_in_the_way_of_a_folder_is_a_problem(project):
    assert doctor.permissions(project).state == "ok"
    (project / "results").touch()
    assert f"cannot write into {project / 'results'}" in doctor.permissions(project).found


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_cache_replays_and_says_that_it_cannot_record(project):
    (project / "llm_cache").chmod(0o500)
    assert doctor.replies(project / "llm_cache", True).state == "warning"
    (project / "run").mkdir(mode=0o500)
    assert doctor.permissions(project).state == "problem"


@pytest.mark.parametrize(("free_mib", "state"), [(199, "problem"), (201, "warning"), (2047, "warning"), (2049, "ok")])
def test_a_disk_with_little_room_is_said(project, monkeypatch, free_mib, state):
    usage = shutil.disk_usage(project)
    monkeypatch.setattr(doctor.shutil, "disk_usage", lambda _: usage._replace(free=free_mib * 2**20))
    assert doctor.disk(project).state == state


def test_dvc_without_its_folder_is_a_problem(project):
    shutil.rmtree(project / ".dvc")
    assert doctor.dvc_cache(project).state == "problem"


def test_a_back_end_that_does_not_draw_is_a_warning(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "nonsense")
    found = doctor.renderer()
    assert found.state == "warning"
    assert "expected nonsense to draw a picture" in found.found
    assert "libegl1" in found.advice


def test_findings_wrap_at_the_width_with_the_advice_below_them():
    findings = [
        Finding("disk", "ok", "much"),
        Finding("cpu", "problem", "one two three four five six seven", "take another"),
    ]
    assert findings_text(findings, 20).splitlines() == [
        "ok      disk  much",
        "problem cpu   one two three four five six",
        "              seven",
        "              -> take another",
        "",
        "1 problem, 0 warnings",
    ]


def test_the_state_of_a_run_is_not_changed_by_looking(project, monkeypatch):
    before = sorted(str(path) for path in Path().rglob("*") if ".dvc" not in path.parts)
    examined(monkeypatch)
    assert sorted(str(path) for path in Path().rglob("*") if ".dvc" not in path.parts) == before
