"""The index over the record files: summaries of all records, and one lock for each key.

The files are the truth. A row of the index covers one sub-directory of the cache and is rebuilt as soon as the names in
that sub-directory differ from those it has seen, so neither git nor another process has to tell it anything. Looking up
a recorded reply needs no index at all: the key is the path.
"""

import contextlib
import json
import os
import socket
import sqlite3
import threading
from collections.abc import Callable
from dataclasses import astuple
from pathlib import Path
from typing import Any, TypeVar

import diskcache

from porse.errors import CacheError
from porse.llm.disk import BUSY_S, RowRefusedError, discard_disk, is_damage, open_disk
from porse.llm.nearest import SCALARS, Summary, summarise
from porse.llm.store import Store

T = TypeVar("T")


class Index:
    """An opened index. It heals itself: a damaged database is thrown away and rebuilt from the files."""

    def __init__(self, store: Store) -> None:
        """Opens the index of a store, or makes it.

        Raises:
            CacheError: it cannot be written, or belongs to somebody else.
        """
        self._store = store
        self._directory = store.state_dir / "llm-index"
        self._disk = self._open()

    def close(self) -> None:
        """Closes the database."""
        self._disk.close()

    def summaries(self) -> list[Summary]:
        """Returns the summaries of all records that can be read, in ascending order of the keys."""
        return [summary for shard in self._store.shards() for summary in self._run(_shard_reader(self._store, shard))]

    def try_lock(self, key: str) -> bool:
        """Returns whether this thread holds the lock of `key` now; a lock whose process has died is taken over."""

        def take(disk: Any) -> bool:
            if _is_held(disk.get(f"lock:{key}")):
                return False
            with disk.transact(retry=True):
                if _is_held(disk.get(f"lock:{key}")):
                    return False
                disk.set(f"lock:{key}", _owner())
                return True

        return self._run(take)

    def unlock(self, key: str) -> None:
        """Gives the lock of `key` back if this thread still holds it."""

        def give(disk: Any) -> None:
            with disk.transact(retry=True):
                if disk.get(f"lock:{key}") == _owner():
                    disk.delete(f"lock:{key}")

        self._run(give)

    def _open(self) -> Any:
        try:
            return open_disk(self._directory)
        except (sqlite3.DatabaseError, OSError) as error:
            if not is_damage(error):
                raise self._unusable(error) from error
        return self._rebuilt()

    def _rebuilt(self) -> Any:
        """Returns a new database in the place of a damaged one.

        A directory that is linked from elsewhere is not ours to delete, so what is damaged there stays damaged.
        """
        discard_disk(self._directory)
        try:
            return open_disk(self._directory)
        except (sqlite3.DatabaseError, OSError) as error:
            raise self._unusable(error) from error

    def _unusable(self, error: Exception) -> CacheError:
        return CacheError(
            f"Expected to write the index of recorded replies in {self._directory}, found: {error}. Delete that directory, "
            "or the link of that name: the index is rebuilt from the record files. Frozen mode needs no index; record mode "
            "needs a checkout that it can write."
        )

    def _run(self, use: Callable[[Any], T]) -> T:
        try:
            return self._used(use)
        except (sqlite3.DatabaseError, RowRefusedError) as error:
            if not is_damage(error):
                raise self._unusable(error) from error
        self._disk.close()
        self._disk = self._rebuilt()
        try:
            return self._used(use)
        except (sqlite3.DatabaseError, RowRefusedError) as error:
            raise self._unusable(error) from error

    def _used(self, use: Callable[[Any], T]) -> T:
        try:
            return use(self._disk)
        except diskcache.Timeout as error:
            raise CacheError(
                f"Expected the index in {self._directory} to answer within {BUSY_S:g} s, found it locked. End the "
                "process that holds it, or delete that directory: it is rebuilt from the record files."
            ) from error


def _shard_reader(store: Store, shard: str) -> Callable[[Any], list[Summary]]:
    """Returns a function that reads one sub-directory's row, and rebuilds the row when the files have changed."""

    def read(disk: Any) -> list[Summary]:
        keys, names = store.shard_keys(shard), sorted(os.listdir(store.cache_dir / shard))
        row = disk.get(f"shard:{shard}")
        known = _known_summaries(row, names) if row is not None else None
        if known is not None:
            return known
        found = _scan(store, keys)
        row = json.dumps({"names": names, "summaries": [astuple(summary) for summary in found]})
        disk.set(f"shard:{shard}", row)
        return found

    return read


def _known_summaries(row: str, names: list[str]) -> list[Summary] | None:
    """Returns the summaries in a row, None when the row was made of other files than these."""
    document = _decode(row)
    try:
        if document["names"] != names:
            return None
        found = [
            Summary(key, tuple(fields), tuple(messages), tuple(origin))
            for key, fields, messages, origin in document["summaries"]
        ]
        # An earlier version knew fewer fields.
        return found if all(len(summary.fields) == len(SCALARS) for summary in found) else None
    except (KeyError, TypeError, ValueError) as error:
        raise RowRefusedError("a row of another form") from error


def _decode(row: str) -> Any:
    try:
        return json.loads(row)
    except ValueError as error:
        raise RowRefusedError("a row that is not JSON") from error


def _scan(store: Store, keys: list[str]) -> list[Summary]:
    """Summarises records from their files; one that cannot be trusted is left out, `porse llm verify` names it."""
    found: list[Summary] = []
    for key in keys:
        with contextlib.suppress(CacheError):
            record = store.read(key)
            if record is not None:
                origin = record.provenance.origin
                found.append(summarise(record.request, (origin.stage, origin.iteration, origin.subject)))
    return found


def _owner() -> str:
    """Returns who this thread is: the process with its start time, since process ids are used again."""
    process = os.getpid()
    return json.dumps([socket.gethostname(), process, _started(process), threading.get_ident()])


def _is_held(row: str | None) -> bool:
    """Returns whether the owner in a lock row may still be at work; on another machine nobody can tell, so yes."""
    if row is None:
        return False
    owner = _decode(row)
    if not isinstance(owner, list) or len(owner) != 4:
        raise RowRefusedError("a lock row of another form")
    host, process, started, _ = owner
    return host != socket.gethostname() or _started(process) == started


def _started(process: int) -> str:
    """Returns what tells one process from a later one with the same id; "" when there is no such process.

    Not psutil's `create_time`: it counts from the time of day, which another process may find set anew, and a lock would seem
    to be nobody's. What Linux counts from its start never changes.
    """
    try:
        # The 22nd field of proc(5); the second one, the name, may hold spaces and ends with the last ")".
        status = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace")
        return status.rpartition(")")[2].split()[19]
    except OSError:
        pass
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return ""
    except PermissionError:
        pass
    return "running"


def summaries(store: Store) -> list[Summary]:
    """Returns the summaries of all records, through the index where it can be written, from the files where not."""
    try:
        with contextlib.closing(Index(store)) as index:
            return index.summaries()
    except CacheError:
        return [summary for shard in store.shards() for summary in _scan(store, store.shard_keys(shard))]
