"""Records are written whole and once, and found by their name."""

import hashlib
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from porse.errors import CacheError
from porse.llm.store import ABANDONED_S, REFRESHED, Store
from tests.llm_cases import RECORD, new_store, record


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return new_store(tmp_path)


def files(store: Store) -> dict[str, bytes]:
    paths = [path for path in store.cache_dir.rglob("*") if path.is_file()]
    return {str(path.relative_to(store.cache_dir)): path.read_bytes() for path in paths}


def refreshed(store: Store) -> list[str]:
    """The hashes in the list of replaced records, in its order; the list is removed."""
    path = store.cache_dir / REFRESHED
    lines = [line.split() for line in path.read_text().splitlines()]
    path.unlink()
    assert {key for key, _ in lines} == {RECORD.key}
    return [digest for _, digest in lines]


def digest(text: str) -> str:
    return hashlib.sha256(record(text).render()).hexdigest()


def leftovers(store: Store) -> list[str]:
    return sorted(path.name for path in (store.state_dir / "llm-tmp").iterdir())


def test_the_key_is_the_path(store: Store) -> None:
    assert store.write(RECORD)
    assert list(files(store)) == [f"{RECORD.key[:2]}/{RECORD.key}.json"]
    assert store.read(RECORD.key) == RECORD
    assert leftovers(store) == []


def test_no_record_is_none(store: Store) -> None:
    assert store.read(RECORD.key) is None


def test_same_reply_again_changes_nothing(store: Store) -> None:
    store.write(RECORD)
    before = files(store)
    assert not store.write(RECORD)
    assert files(store) == before


def test_a_different_reply_is_refused(store: Store) -> None:
    store.write(record("one"))
    before = files(store)
    with pytest.raises(CacheError, match=r"written\s+once: .* `porse llm refresh"):
        store.write(record("another"))
    assert files(store) == before
    assert leftovers(store) == []


def test_a_different_reply_is_refused_when_another_process_was_first(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = os.link

    def late_link(source: Path, target: Path) -> None:
        monkeypatch.setattr(os, "link", link)
        Store(store.cache_dir).write(record("one"))
        link(source, target)

    monkeypatch.setattr(os, "link", late_link)
    with pytest.raises(CacheError, match="found a different one"):
        store.write(record("another"))
    assert store.read(RECORD.key) == record("one")
    assert leftovers(store) == []


def test_the_same_reply_of_another_process_is_fine(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    link = os.link

    def late_link(source: Path, target: Path) -> None:
        monkeypatch.setattr(os, "link", link)
        Store(store.cache_dir).write(RECORD)
        link(source, target)

    monkeypatch.setattr(os, "link", late_link)
    assert not store.write(RECORD)


def test_all_or_none(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    link, calls = os.link, []

    def failing_link(source: Path, target: Path) -> None:
        calls.append(target)
        if len(calls) == 3:
            raise OSError(28, "No space left on device")
        link(source, target)

    monkeypatch.setattr(os, "link", failing_link)
    with pytest.raises(CacheError, match=r"No space.*Nothing was recorded"):
        store.write_all([record(sample=k) for k in range(4)])
    assert files(store) == {}
    assert leftovers(store) == []


def test_an_edited_record_is_not_overwritten(store: Store) -> None:
    store.write(RECORD)
    path = store.path(RECORD.key)
    path.write_bytes(path.read_bytes().replace(b"return 1", b"return 2"))
    with pytest.raises(CacheError, match="edited"):
        store.write(RECORD)


def test_find_by_first_digits(store: Store) -> None:
    keys = [record(sample=k).key for k in range(40)]
    store.write_all([record(sample=k) for k in range(40)])
    assert sorted(keys) == list(store.all_keys())
    assert store.find(keys[0][:20]) == keys[0]
    with pytest.raises(CacheError, match="found none"):
        store.find("zz")
    with pytest.raises(CacheError, match="found 40"):
        store.find("")


def test_supersede_keeps_the_old_record_beside_the_new(store: Store) -> None:
    for text in ("one", "two", "three"):
        if text == "one":
            store.write(record(text))
        else:
            store.supersede(record(text))
    directory = f"{RECORD.key[:2]}/{RECORD.key}"
    assert refreshed(store) == [digest("two"), digest("three")]
    assert files(store) == {
        f"{directory}.1.json": record("one").render(),
        f"{directory}.2.json": record("two").render(),
        f"{directory}.json": record("three").render(),
    }
    assert list(store.all_keys()) == [RECORD.key]


def test_supersede_needs_a_record(store: Store) -> None:
    with pytest.raises(CacheError, match="Record it first"):
        store.supersede(RECORD)


def test_the_disk_has_the_record_before_its_name_appears(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []

    def noted(name: str) -> Callable[..., Any]:
        call = getattr(os, name)

        def run(*arguments: Any) -> Any:
            calls.append(name)
            return call(*arguments)

        return run

    for name in ("fsync", "link"):
        monkeypatch.setattr(os, name, noted(name))
    store.write(RECORD)
    assert calls == ["fsync", "link", "fsync"], "the file, its name, the directory that holds the name"


def killed_at(step: int, work: Callable[[], object]) -> bool:
    """Runs `work` in a child process that is killed before its n-th call to the file system; returns whether it was."""
    child = os.fork()
    if child == 0:
        remaining = [step]

        def counted(call: Callable[..., Any]) -> Callable[..., Any]:
            def run(*arguments: Any, **options: Any) -> Any:
                remaining[0] -= 1
                if remaining[0] < 0:
                    os.kill(os.getpid(), signal.SIGKILL)
                return call(*arguments, **options)

            return run

        for name in ("open", "fdopen", "fsync", "link", "unlink", "replace", "mkdir", "close"):
            setattr(os, name, counted(getattr(os, name)))
        try:
            work()
        finally:
            os._exit(0)
    _, status = os.waitpid(child, 0)
    return os.WIFSIGNALED(status)


def test_killed_at_every_step_of_a_write(tmp_path: Path) -> None:
    outcomes = set()
    for step in range(100):
        store = new_store(tmp_path / str(step))
        killed = killed_at(step, lambda: store.write(RECORD))  # noqa: B023 (runs at once)
        found = store.read(RECORD.key)
        assert found in (None, RECORD)
        assert killed or found == RECORD
        outcomes.add((killed, found is not None))
        assert store.write(RECORD) == (found is None)
        if not killed:
            break
    assert outcomes == {(True, False), (True, True), (False, True)}


def test_killed_at_every_step_of_a_refresh(tmp_path: Path) -> None:
    old, new = record("old"), record("new")
    for step in range(100):
        store = new_store(tmp_path / str(step))
        store.write(old)
        killed = killed_at(step, lambda: store.supersede(new))  # noqa: B023 (runs at once)
        assert store.read(RECORD.key) in (old, new)
        if store.read(RECORD.key) == old:
            store.supersede(new)
        directory = f"{RECORD.key[:2]}/{RECORD.key}"
        # A kill between the two notes a refresh once more, and never leaves one out.
        assert set(refreshed(store)) == {digest("new")}
        assert files(store) == {f"{directory}.1.json": old.render(), f"{directory}.json": new.render()}
        if not killed:
            break
    assert not killed


@pytest.mark.parametrize("kind", ["pipe", "link", "folder"])
def test_what_is_no_plain_file_is_refused_and_not_waited_for(store: Store, kind: str) -> None:
    path = store.path(RECORD.key)
    path.parent.mkdir()
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "link":
        path.with_suffix(".elsewhere").write_bytes(RECORD.render())
        path.symlink_to(path.with_suffix(".elsewhere"))
    else:
        path.mkdir()
    with pytest.raises(CacheError, match=rf"Expected a readable recorded reply, found {path}: \w"):
        store.read(RECORD.key)


def test_what_killed_processes_left_is_removed_when_nobody_can_be_writing_it(store: Store) -> None:
    gone = subprocess.Popen(["true"])
    gone.wait()
    directory = store.state_dir / "llm-tmp"
    directory.mkdir(parents=True)
    old = time.time() - ABANDONED_S - 60
    mine = f"{'a' * 64}.{os.getpid()}.7"
    young = f"{'c' * 64}.{gone.pid}.7"
    for name in (mine, young, f"{'b' * 64}.{gone.pid}.7", "notes"):
        (directory / name).touch()
        if name != young:
            os.utime(directory / name, (old, old))
    assert store.write(RECORD)
    assert leftovers(store) == sorted([mine, young, "notes"])
    os.utime(directory / young, (old, old))
    assert not store.write(RECORD)
    assert young in leftovers(store), "nothing is written, and nothing is looked at"
    assert store.write(record(sample=1))
    assert leftovers(store) == sorted([mine, "notes"])
