"""The files of the cache: `llm_cache/<first two>/<key>.json`, written once, found by their name alone.

A read needs no index and writes nothing, so a read-only checkout replays. A write is a temporary file outside the cache
(nothing but whole records may ever be seen in it), an fsync, and a hard
link to the final name, which fails when the name exists: the file system itself keeps records write-once.
"""

import contextlib
import hashlib
import itertools
import os
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from porse.errors import CacheError
from porse.llm.record import Record, parse_record
from porse.paths import open_plain

KEY_PATTERN = re.compile(r"[0-9a-f]{64}")
SUPERSEDED_PATTERN = re.compile(r"([0-9a-f]{64})\.([1-9][0-9]*)")
SHARD_DIGITS = 2
REFRESHED = "refreshed.txt"
"""In the cache, a line for each record that was replaced: stages that ask depend on this list, and on no record."""

ABANDONED_S = 3600.0
"""A temporary file of a process that is gone is removed when it is as old as this: one on another machine may write beside us."""

_TEMPORARY = re.compile(r"[0-9a-f]{64}\.([0-9]{1,9})\.[0-9]+")
"""The name of one: key, process, and a number of its own."""

_counter = itertools.count()


@dataclass(frozen=True)
class Store:
    """The record files under one directory.

    Attributes:
        cache_dir: the cache, `llm_cache` by convention.
    """

    cache_dir: Path

    @property
    def state_dir(self) -> Path:
        """Where the index, the open requests and temporary files live: beside the cache, never in it."""
        return self.cache_dir.parent / ".porse"

    @property
    def _temporary_dir(self) -> Path:
        return self.state_dir / "llm-tmp"

    def path(self, key: str) -> Path:
        """Returns the path of the record of `key`."""
        return self.cache_dir / key[:SHARD_DIGITS] / f"{key}.json"

    def read(self, key: str) -> Record | None:
        """Returns the record of `key`, its key and payload hash recomputed; None when there is none.

        Raises:
            CacheError: something is there, and is not a plain file with a whole, unedited record of `key`.
        """
        path = self.path(key)
        try:
            with open_plain(path) as file:
                data = file.read()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise CacheError(f"Expected a readable recorded reply, found {path}: {error.strerror}.") from error
        return parse_record(data, key, str(path))

    def all_keys(self) -> Iterator[str]:
        """Yields the keys of all records in ascending order, by file name; superseded records are not among them."""
        for shard in self.shards():
            yield from self.shard_keys(shard)

    def shards(self) -> list[str]:
        """Returns the names of the sub-directories of records, sorted."""
        if not self.cache_dir.is_dir():
            return []
        return sorted(
            entry.name
            for entry in os.scandir(self.cache_dir)
            if len(entry.name) == SHARD_DIGITS and entry.is_dir(follow_symlinks=True)
        )

    def shard_keys(self, shard: str) -> list[str]:
        """Returns the sorted keys of the records in one sub-directory."""
        names = (name for name in os.listdir(self.cache_dir / shard) if name.endswith(".json"))
        return sorted(stem for name in names if KEY_PATTERN.fullmatch(stem := name.removesuffix(".json")))

    def find(self, prefix: str) -> str:
        """Returns the one key that starts with `prefix`.

        Raises:
            CacheError: no recorded key starts so, or several do.
        """
        shards = [shard for shard in self.shards() if shard.startswith(prefix[:SHARD_DIGITS])]
        found = [key for shard in shards for key in self.shard_keys(shard) if key.startswith(prefix)]
        if len(found) == 1:
            return found[0]
        what = "none" if not found else f"{len(found)}, {found[0][:12]} and {found[1][:12]} among them"
        raise CacheError(
            f"Expected one recorded key in {self.cache_dir} that starts with {prefix!r}, found {what}. "
            "`porse llm stats --list` prints all keys."
        )

    def write(self, record: Record) -> bool:
        """Writes a record once; returns whether it was new.

        Raises:
            CacheError: a different reply is recorded under that key.
        """
        return self.write_all([record]) == 1

    def write_all(self, records: list[Record]) -> int:
        """Writes all the records or none; returns how many were new. A record that is there already is left alone.

        Raises:
            CacheError: a different reply is recorded under one of the keys.
        """
        fresh = [record for record in records if not self._is_recorded(record)]
        if fresh:
            self._sweep()
        staged: list[tuple[Path, Path]] = []
        linked: list[Path] = []
        try:
            for record in fresh:
                staged.append((self._stage(record), self.path(record.key)))
            for record, (temporary, path) in zip(fresh, staged, strict=True):
                path.parent.mkdir(parents=True, exist_ok=True)
                if self._publish(record, temporary, path):
                    linked.append(path)
        except BaseException as error:
            for path in linked:
                path.unlink()
            if isinstance(error, OSError):
                raise CacheError(
                    f"Expected to write {len(fresh)} records to {self.cache_dir} by way of {self.state_dir}, found: "
                    f"{error}. Nothing was recorded. Both must be on one file system that knows hard links and has room."
                ) from error
            raise
        finally:
            for temporary, _ in staged:
                temporary.unlink(missing_ok=True)
        for directory in {path.parent for path in linked}:
            _sync_directory(directory)
        return len(linked)

    def supersede(self, record: Record) -> Path:
        """Replaces the record of a key; returns where the old one was kept, `<key>.<n>.json` beside it.

        Raises:
            CacheError: there is no whole record of that key to replace.
        """
        path = self.path(record.key)
        if self.read(record.key) is None:
            raise CacheError(f"Expected a recorded reply to refresh, found no {path}. Record it first.")
        kept = self._keep(path)
        temporary = self._stage(record)
        # Before the record itself: a line too many has stages look again, one too few would leave them with the old reply.
        self._note(record)
        os.replace(temporary, path)
        _sync_directory(path.parent)
        return kept

    def _note(self, record: Record) -> None:
        """Adds a line to the list of refreshed records: its key and the hash of the new record."""
        line = f"{record.key} {hashlib.sha256(record.render()).hexdigest()}\n"
        with (self.cache_dir / REFRESHED).open("a", encoding="utf-8") as file:
            file.write(line)
            file.flush()
            os.fsync(file.fileno())

    def _keep(self, path: Path) -> Path:
        """Links the current record to its next free number; after a crash the copy may be there already."""
        for number in itertools.count(1):
            kept = path.with_name(f"{path.stem}.{number}.json")
            if not kept.exists():
                os.link(path, kept)
                return kept
            if kept.samefile(path):
                return kept
        raise AssertionError("unreachable: the count has no end")

    def _is_recorded(self, record: Record) -> bool:
        known = self.read(record.key)
        if known is None:
            return False
        if known.answer.text != record.answer.text or known.answer.finish_reason != record.answer.finish_reason:
            raise CacheError(_contradiction(self.path(record.key), record.key))
        return True

    def _stage(self, record: Record) -> Path:
        """Writes the record to a temporary file on the same file system and waits until the disk has it."""
        directory = self._temporary_dir
        directory.mkdir(parents=True, exist_ok=True)
        temporary = directory / f"{record.key}.{os.getpid()}.{next(_counter)}"
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(record.render())
                file.flush()
                os.fsync(file.fileno())
        except BaseException:
            temporary.unlink()
            raise
        return temporary

    def _sweep(self) -> None:
        """Removes temporary files that killed processes have left; a folder that cannot be read or written is let be.

        Cheap: the folder holds what is being written at this moment, and nothing else. Several processes may do so at once.
        """
        with contextlib.suppress(OSError), os.scandir(self._temporary_dir) as entries:
            for entry in entries:
                match = _TEMPORARY.fullmatch(entry.name)
                if match is None or time.time() - entry.stat().st_mtime <= ABANDONED_S:
                    continue
                # Imported here: of a thousand writes, none needs it.
                import psutil

                if not psutil.pid_exists(int(match[1])):
                    Path(entry.path).unlink(missing_ok=True)

    def _publish(self, record: Record, temporary: Path, path: Path) -> bool:
        """Links the file to its final name; returns False when another process was first with the same reply."""
        try:
            os.link(temporary, path)
        except FileExistsError:
            self._is_recorded(record)
            return False
        return True


def _contradiction(path: Path, key: str) -> str:
    return (
        f"Expected no reply or the same reply under key {key[:12]}, found a different one in {path}. Records are "
        f"written once: to replace it on purpose, run `porse llm refresh {key[:12]}`."
    )


def _sync_directory(directory: Path) -> None:
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
