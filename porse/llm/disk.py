"""The index's database: diskcache reduced to plain text rows, in a directory that only its owner can write.

diskcache as it comes evicts silently, keeps large values in files that it also deletes, and unpickles any row whose
mode says so (CVE-2025-69872, version 5.6.3), which lets whoever can write the database run code in every reader. Here
every key and every value is a text in the database itself; any other row is refused unread.
"""

import os
import shutil
import sqlite3
import stat
from pathlib import Path
from typing import Any, NoReturn

import diskcache
from diskcache.core import MODE_RAW

from porse.errors import CacheError

OWNER_ONLY = 0o700

BUSY_S = 60
"""A process waits this long for another one's transaction, which takes milliseconds."""


class RowRefusedError(Exception):
    """A row is not plain text: the database is damaged, or somebody else wrote to it."""


class TextDisk(diskcache.Disk):  # diskcache has no types
    """Stores text keys and text values in the database and nothing else anywhere."""

    def put(self, key: Any) -> Any:
        """Returns the key as it is stored, marked as raw."""
        if not isinstance(key, str):
            raise RowRefusedError(f"a key of type {type(key).__name__}")
        return key, True

    def get(self, key: Any, raw: Any) -> str:
        """Returns a stored key; the base class would unpickle one that is not raw."""
        if not raw or not isinstance(key, str):
            raise RowRefusedError("a key that asks for unpickling")
        return key

    def store(self, value: Any, read: bool, key: Any = None) -> Any:
        """Returns the columns of a value: no file is ever written."""
        if read or not isinstance(value, str):
            raise RowRefusedError(f"a value of type {type(value).__name__}")
        return 0, MODE_RAW, None, value

    def fetch(self, mode: Any, filename: Any, value: Any, read: bool) -> str:
        """Returns a stored value; the base class would unpickle it, or open a file, when the row says so."""
        if mode != MODE_RAW or filename is not None or read or not isinstance(value, str):
            raise RowRefusedError(f"a value of mode {mode!r}")
        return value

    def filename(self, key: Any = None, value: Any = None) -> NoReturn:
        """Refuses: values are never files here."""
        raise RowRefusedError("a value that asks for a file")

    def remove(self, file_path: Any) -> None:
        """Deletes nothing: a planted row must not name a file for deletion."""


def open_disk(directory: Path) -> Any:
    """Returns the opened database in `directory`, made with its owner's permissions when it is not there.

    Raises:
        CacheError: the directory belongs to somebody else.
        sqlite3.DatabaseError: the database is damaged.
        OSError: the directory cannot be made.
    """
    directory.mkdir(mode=OWNER_ONLY, parents=True, exist_ok=True)
    status = directory.stat()
    if status.st_uid != os.geteuid():
        raise CacheError(
            f"Expected the index of recorded replies in {directory} to be yours, found it owned by user "
            f"{status.st_uid}. Use a checkout of your own; the index is rebuilt from the record files."
        )
    if stat.S_IMODE(status.st_mode) != OWNER_ONLY:
        directory.chmod(OWNER_ONLY)
    return diskcache.Cache(
        str(directory), timeout=BUSY_S, disk=TextDisk, eviction_policy="none", cull_limit=0, statistics=0
    )


def discard_disk(directory: Path) -> None:
    """Deletes a damaged database, unless the directory is a link; everything in it can be rebuilt."""
    shutil.rmtree(directory, ignore_errors=True)


def is_damage(error: Exception) -> bool:
    """Returns whether an error means that the database is damaged, and not that it is busy or cannot be written."""
    if isinstance(error, RowRefusedError):
        return True
    if not isinstance(error, sqlite3.DatabaseError):
        return False
    code = getattr(error, "sqlite_errorcode", 0)
    if code in (sqlite3.SQLITE_IOERR_SHORT_READ, sqlite3.SQLITE_READONLY_DBMOVED):
        return True
    return code & 0xFF in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB) or str(error).startswith("no such")
