"""The index heals itself, unpickles nothing, and its locks outlive no process."""

import contextlib
import json
import os
import pickle
import shutil
import sqlite3
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import diskcache
import pytest

from porse.errors import CacheError
from porse.llm.disk import RowRefusedError, open_disk
from porse.llm.index import Index, summaries
from porse.llm.store import Store
from tests.llm_cases import RECORD, new_store, record

RECORDS = [record(sample=k) for k in range(12)]
KEYS = sorted(item.key for item in RECORDS)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = new_store(tmp_path)
    store.write_all(RECORDS)
    return store


@contextlib.contextmanager
def opened(store: Store) -> Iterator[Index]:
    with contextlib.closing(Index(store)) as index:
        yield index


def database(store: Store) -> Path:
    return store.state_dir / "llm-index" / "cache.db"


def keys(store: Store) -> list[str]:
    return [summary.key for summary in summaries(store)]


def execute(store: Store, statement: str, *values: object) -> None:
    with contextlib.closing(sqlite3.connect(database(store))) as connection, connection:
        connection.execute(statement, values)


def test_absent_index_is_built(store: Store) -> None:
    assert keys(store) == KEYS
    assert database(store).exists()


def test_index_is_used_again(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    first = summaries(store)
    monkeypatch.setattr(Store, "read", lambda self, key: pytest.fail("a file was read"))
    assert summaries(store) == first


def test_index_follows_the_files(store: Store) -> None:
    summaries(store)
    store.path(KEYS[0]).unlink()
    store.write(record(sample=99))
    assert keys(store) == sorted([*KEYS[1:], record(sample=99).key])


def test_index_leaves_out_what_cannot_be_trusted(store: Store) -> None:
    store.path(KEYS[0]).write_bytes(b"{}")
    assert keys(store) == KEYS[1:]


@pytest.mark.parametrize("content", [b"", b"garbage" * 1000, b"SQLite format 3\x00" + b"\x00" * 5000])
def test_damaged_database_is_rebuilt(store: Store, content: bytes) -> None:
    summaries(store)
    for path in database(store).parent.iterdir():
        path.unlink()
    database(store).write_bytes(content)
    assert keys(store) == KEYS
    assert keys(store) == KEYS


@pytest.mark.parametrize("content", [b"garbage" * 1000, b"SQLite format 3\x00" + b"\x00" * 5000])
def test_damaged_database_behind_a_link_is_named_and_left_alone(store: Store, tmp_path: Path, content: bytes) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "cache.db").write_bytes(content)
    store.state_dir.mkdir(exist_ok=True)
    (store.state_dir / "llm-index").symlink_to(elsewhere)
    assert keys(store) == KEYS, "frozen mode reads the files"
    with pytest.raises(CacheError, match=r"llm-index, found: .*or the link of that name") as caught:
        Index(store)
    assert "\n" not in str(caught.value)
    assert (elsewhere / "cache.db").read_bytes() == content


def test_database_that_is_damaged_in_use_behind_a_link_is_named(store: Store, tmp_path: Path) -> None:
    summaries(store)
    database(store).parent.rename(tmp_path / "elsewhere")
    (store.state_dir / "llm-index").symlink_to(tmp_path / "elsewhere")
    with opened(store) as index:
        for path in (tmp_path / "elsewhere").iterdir():
            path.write_bytes(b"garbage" * 1000)
        with pytest.raises(CacheError, match="or the link of that name"):
            index.try_lock(KEYS[0])
    assert keys(store) == KEYS


def test_index_of_an_earlier_version_is_rebuilt(store: Store) -> None:
    summaries(store)
    for shard in store.shards():
        names = sorted(os.listdir(store.cache_dir / shard))
        row = {"names": names, "summaries": [[name[:64], ["m", 0.5, 0.9, 100, 0], [], ["s", 1, "r"]] for name in names]}
        execute(store, "UPDATE Cache SET value = ? WHERE key = ?", json.dumps(row), f"shard:{shard}")
    assert {len(summary.fields) for summary in summaries(store)} == {7}


@pytest.mark.parametrize("part", [0.25, 0.5, 0.75, 0.9])
def test_truncated_database_is_rebuilt(store: Store, part: float) -> None:
    summaries(store)
    data = database(store).read_bytes()
    database(store).write_bytes(data[: int(len(data) * part)])
    assert keys(store) == KEYS


def test_overwritten_pages_are_rebuilt_or_unused(store: Store) -> None:
    summaries(store)
    data = bytearray(database(store).read_bytes())
    for place in range(4096, len(data), 4096):
        database(store).write_bytes(data[:place] + b"\xa5" * 4096 + data[place + 4096 :])
        assert keys(store) == KEYS


def test_missing_table_is_rebuilt(store: Store) -> None:
    summaries(store)
    execute(store, "DROP TABLE Cache")
    assert keys(store) == KEYS


def test_row_that_is_not_json_is_rebuilt(store: Store) -> None:
    summaries(store)
    execute(store, "UPDATE Cache SET value = 'not json'")
    assert keys(store) == KEYS


@pytest.mark.parametrize("row", ["[]", "3", '{"names": 1}', '"text"', '{"names": NAMES, "summaries": [1]}'])
def test_row_of_another_form_is_rebuilt(store: Store, row: str) -> None:
    summaries(store)
    for shard in store.shards():
        names = json.dumps(sorted(os.listdir(store.cache_dir / shard)))
        execute(store, "UPDATE Cache SET value = ? WHERE key = ?", row.replace("NAMES", names), f"shard:{shard}")
    assert keys(store) == KEYS


class Planted:
    """Leaves a trace when it is unpickled."""

    trace = Path()

    def __reduce__(self) -> tuple[object, ...]:
        return Path.touch, (Planted.trace,)


def test_pickled_value_is_never_loaded(store: Store, tmp_path: Path) -> None:
    Planted.trace = tmp_path / "trace"
    summaries(store)
    data = pickle.dumps(Planted())
    execute(store, "UPDATE Cache SET value = ?, mode = 4", sqlite3.Binary(data))
    with contextlib.closing(open_disk(database(store).parent)) as disk, pytest.raises(RowRefusedError, match="mode 4"):
        disk.get(f"shard:{KEYS[0][:2]}")
    assert keys(store) == KEYS
    assert not Planted.trace.exists()
    with diskcache.Cache(str(tmp_path / "plain")) as plain:
        plain["a"] = Planted()
        assert plain.get("a") is None
    assert Planted.trace.exists(), "the trap itself must work"


def test_pickled_key_is_never_loaded(store: Store, tmp_path: Path) -> None:
    Planted.trace = tmp_path / "trace"
    summaries(store)
    execute(store, "UPDATE Cache SET key = ?, raw = 0 WHERE rowid = 1", sqlite3.Binary(pickle.dumps(Planted())))
    with contextlib.closing(open_disk(database(store).parent)) as disk, pytest.raises(RowRefusedError):
        list(disk)
    assert not Planted.trace.exists()


def test_planted_file_name_is_neither_read_nor_deleted(store: Store, tmp_path: Path) -> None:
    summaries(store)
    victim = tmp_path / "victim"
    victim.write_text("precious")
    execute(store, "UPDATE Cache SET filename = '../../victim', mode = 3, value = NULL")
    assert keys(store) == KEYS
    with opened(store) as index:
        assert index.try_lock(KEYS[0])
        execute(store, "UPDATE Cache SET filename = '../../victim' WHERE key LIKE 'lock:%'")
        index.unlock(KEYS[0])
    assert victim.read_text() == "precious"


@pytest.mark.parametrize("value", [1, 1.5, b"bytes", None, ("a",)])
def test_only_texts_are_stored(tmp_path: Path, value: object) -> None:
    with contextlib.closing(open_disk(tmp_path / "disk")) as disk:
        with pytest.raises(RowRefusedError):
            disk["key"] = value
        with pytest.raises(RowRefusedError):
            disk[value] = "value"


def test_nothing_is_evicted(tmp_path: Path) -> None:
    with contextlib.closing(open_disk(tmp_path / "disk")) as disk:
        disk.reset("size_limit", 1000)
        for number in range(50):
            disk[f"key {number}"] = "x" * 1000
        assert len(disk) == 50


def test_permissions_are_the_owners(store: Store) -> None:
    summaries(store)
    directory = database(store).parent
    assert stat.S_IMODE(directory.stat().st_mode) == 0o700
    directory.chmod(0o777)
    summaries(store)
    assert stat.S_IMODE(directory.stat().st_mode) == 0o700


def test_index_of_another_user_is_refused(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    summaries(store)
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    with pytest.raises(CacheError, match="owned by user"):
        Index(store)
    assert keys(store) == KEYS


def test_directory_that_cannot_be_made_is_done_without(store: Store) -> None:
    shutil.rmtree(store.state_dir)
    store.state_dir.write_text("a file in the way")
    assert keys(store) == KEYS
    with pytest.raises(CacheError, match="record mode needs a checkout that it can write"):
        Index(store)


def test_a_lock_is_held_once(store: Store) -> None:
    with opened(store) as one, opened(store) as other:
        assert one.try_lock(KEYS[0])
        assert not other.try_lock(KEYS[0])
        assert other.try_lock(KEYS[1])
        one.unlock(KEYS[0])
        assert other.try_lock(KEYS[0])


LOCK_AND_DIE = """
import os, sys
from pathlib import Path
from porse.llm.index import Index
from porse.llm.store import Store
assert Index(Store(Path(sys.argv[1]))).try_lock(sys.argv[2])
os.kill(os.getpid(), 9)
"""


def test_the_lock_of_a_killed_process_is_taken_over(store: Store) -> None:
    done = subprocess.run([sys.executable, "-c", LOCK_AND_DIE, str(store.cache_dir), KEYS[0]], check=False)
    assert done.returncode == -9
    with opened(store) as index:
        assert index.try_lock(KEYS[0])


def test_a_process_id_that_is_used_again_holds_nothing(store: Store) -> None:
    with opened(store) as index:
        assert index.try_lock(KEYS[0])
        host, process, _, thread = json.loads(index._disk.get(f"lock:{KEYS[0]}"))
        index._disk.set(f"lock:{KEYS[0]}", json.dumps([host, process, "an earlier start", thread]))
        assert index.try_lock(KEYS[0])


def test_a_lock_of_another_machine_is_respected(store: Store) -> None:
    with opened(store) as index:
        index._disk.set(f"lock:{KEYS[0]}", json.dumps(["another-machine", 1, "1", 1]))
        assert not index.try_lock(KEYS[0])


def test_a_planted_lock_row_is_refused(store: Store) -> None:
    with opened(store) as index:
        index._disk.set(f"lock:{RECORD.key}", "{}")
        assert index.try_lock(RECORD.key)


def test_database_that_vanishes_in_use_is_rebuilt(store: Store) -> None:
    with opened(store) as index:
        shutil.rmtree(database(store).parent)
        assert index.try_lock(KEYS[0])
        assert [summary.key for summary in index.summaries()] == KEYS
