"""A run that is killed goes on by itself and ends with the same bytes; nothing that it started outlives it."""

import fcntl
import json
import os
from pathlib import Path

import pytest

from kills import Victim, aimed_kills, campaign, finish, kill_in_a_write, start
from porse.repair import is_whole, repair
from tiny import BIN, dvc, run


@pytest.fixture(scope="module")
def empty(tmp_path_factory) -> Victim:
    """A project whose stages do nothing: all that is killed is DVC."""
    return Victim(tmp_path_factory.mktemp("empty"), empty=True)


@pytest.mark.timeout(600)
def test_kills_in_dvcs_own_writes_need_no_hand_and_change_no_byte(empty):
    project = empty.fresh()
    mended = []
    for number, share in [(1, 0), (2, 50), (3, 99), (5, 0)]:
        for name in ("rwlock", "dvc.lock"):
            kill = kill_in_a_write(project, name, number, share)
            assert kill.left == 0
            mended += kill.said
    mended += finish(project)
    assert empty.differences(project) == []
    assert any("rwlock" in line for line in mended)
    assert any("dvc.lock was cut off" in line for line in mended)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_kills_at_random_and_where_they_hurt_need_no_hand_and_change_no_byte(tmp_path):
    found = campaign(tmp_path, 100, len(aimed_kills()))
    assert (found["kills"], found["different"], found["left"]) == (130, 0, 0)


@pytest.fixture
def locked(empty) -> Path:
    """A project that was run and committed."""
    project = empty.fresh()
    finish(project)
    run(project, "git", "add", "-A")
    run(project, "git", "-c", "user.name=t", "-c", "user.email=t@t", "commit", "-qm", "run")
    return project


def test_a_lock_is_whole_to_its_last_line(locked):
    text = (locked / "iterations" / "2" / "dvc.lock").read_text()
    assert is_whole(text)
    lines = text.splitlines(keepends=True)
    # The last output is a folder: path, hash, md5, size, nfiles. Without one of its lines it is no whole entry.
    for dropped in (1, 2, 3, 4):
        assert not is_whole("".join(lines[:-dropped]))
    assert not is_whole(text[:-1])
    assert not is_whole("")
    assert not is_whole("schema: '2.0'\n")


def test_a_lock_that_was_cut_off_is_replaced_by_its_copy_then_by_the_committed_one_then_by_none(locked):
    lock = locked / "iterations" / "2" / "dvc.lock"
    committed = lock.read_text()
    copy = locked / ".dvc" / "tmp" / "porse" / "locks" / "iterations" / "2" / "dvc.lock"
    assert repair(locked) == []
    assert copy.read_text() == committed
    newer = committed.replace("  generate:", "  generated:")
    copy.write_text(newer)
    lock.write_text(committed[:500])
    assert repair(locked) == ["iterations/2/dvc.lock was cut off: the copy of it is in its place"]
    assert lock.read_text() == newer
    copy.write_text("")
    lock.write_text("")
    assert repair(locked) == ["iterations/2/dvc.lock was cut off: the committed one is in its place"]
    assert lock.read_text() == committed
    run(locked, "git", "rm", "-q", "--cached", "iterations/2/dvc.lock")
    run(locked, "git", "-c", "user.name=t", "-c", "user.email=t@t", "commit", "-qm", "none")
    copy.unlink()
    lock.write_text(committed[:-1])
    assert repair(locked) == ["iterations/2/dvc.lock was cut off: removed, what was done is in DVC's run cache"]
    assert not lock.exists()
    # DVC gives back from its run cache what the lock no longer says.
    assert "Running stage" not in dvc(locked, "repro").stdout
    assert lock.read_text() == committed


def test_a_lock_with_a_conflict_is_left_to_who_has_to_solve_it(locked):
    lock = locked / "dvc.lock"
    lock.write_text("<<<<<<< HEAD\n" + lock.read_text())
    before = lock.read_text()
    assert repair(locked) == []
    assert lock.read_text() == before


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "cut off"),
        ('{"write": {"a": {"pid"', "cut off"),
        ('{"write": {"/a": {"pid": 4194304, "cmd": "dvc repro"}}, "read": {}}', "has ended"),
        # The process is there, and is no DVC.
        ('{"write": {}, "read": {"/a": [{"pid": 1, "cmd": "/x/dvc repro"}]}}', "has ended"),
    ],
)
def test_an_rwlock_of_nobody_is_taken_away(tmp_path, text, says):
    path = tmp_path / ".dvc" / "tmp" / "rwlock"
    path.parent.mkdir(parents=True)
    path.write_text(text)
    assert [says in line for line in repair(tmp_path)] == [True]
    assert not path.exists()


def test_an_rwlock_of_a_process_that_lives_is_left_alone(tmp_path):
    path = tmp_path / ".dvc" / "tmp" / "rwlock"
    path.parent.mkdir(parents=True)
    command = Path("/proc/self/cmdline").read_text().split("\0")[0]
    path.write_text(json.dumps({"write": {"/a": {"pid": os.getpid(), "cmd": command}}, "read": {}}))
    assert repair(tmp_path) == []
    assert path.exists()


def test_nothing_is_mended_while_another_dvc_writes(tmp_path):
    state = tmp_path / ".dvc" / "tmp"
    state.mkdir(parents=True)
    (state / "rwlock").write_text("")
    (tmp_path / "dvc.lock").write_text("half")
    with (state / "lock").open("w") as lock:
        # As another process holds it: a lock belongs to the open file.
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert repair(tmp_path) == []
        assert (tmp_path / "dvc.lock").read_text() == "half"
    assert repair(tmp_path) != []


def test_the_guard_hands_its_arguments_on_and_ends_as_dvc_does(locked):
    process = start(locked)
    output, _ = process.communicate()
    # No stage said anything: nothing was left to do, and the status is all.
    assert (process.returncode, " stages, " in output.splitlines()[0]) == (0, True)
    # A pipeline that is not what the parameters say is written first.
    path = locked / "params.yaml"
    path.write_text(path.read_text().replace("  next: result", "  next: 3\n- n: 3\n  next: result"))
    dry = run(locked, str(BIN / "porse"), "repro", "--dry", "resolve")
    assert dry.stderr == "iterations/2/dvc.yaml: written\niterations/3/dvc.yaml: written\n"
    assert "Running stage 'resolve'" in dry.stdout
    done = run(locked, str(BIN / "porse"), "repro", "--dry", "no-such-stage", check=False)
    assert done.returncode != 0
    assert "no-such-stage" in done.stderr
