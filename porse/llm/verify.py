"""Checks a whole cache: every file, every hash, every name, secrets, and entries that nothing uses."""

import re
from collections.abc import Iterator
from pathlib import Path

from porse.errors import CacheError
from porse.llm.record import Record, parse_record
from porse.llm.store import KEY_PATTERN, REFRESHED, SHARD_DIGITS, SUPERSEDED_PATTERN

OTHER_FILES = frozenset({"README.md", REFRESHED})
"""What may lie in the cache besides records."""

SECRETS = {
    "an OpenAI-style API key": ("sk-", re.compile(r"\bsk-[A-Za-z0-9_-]{20,}")),
    "a bearer token": ("Bearer", re.compile(r"\bBearer\s+[A-Za-z0-9._~+/-]{20,}")),
    "an AWS access key": ("AKIA", re.compile(r"\bAKIA[0-9A-Z]{16}\b")),
    "a GitHub token": ("gh", re.compile(r"\bgh[pousr]_[A-Za-z0-9]{36,}")),
    "a GitHub access token": ("github_pat_", re.compile(r"\bgithub_pat_[A-Za-z0-9_]{40,}")),
    "a Hugging Face token": ("hf_", re.compile(r"\bhf_[A-Za-z0-9]{30,}")),
    "a Google API key": ("AIza", re.compile(r"\bAIza[A-Za-z0-9_-]{35}")),
    "a private key": ("PRIVATE KEY", re.compile(r"-----BEGIN [A-Z ]*PRIVATE KEY-----")),
}
"""What secrets look like, each with a part that is looked for first: that is a hundred times faster than the pattern."""


def verify(cache_dir: Path, used: set[str] | None = None) -> list[str]:
    """Returns one line for each problem of a cache, in the order of the paths; none means that it can be trusted.

    Args:
        cache_dir: the cache.
        used: keys that tables name, to find what is not used or not there; None leaves that out.

    Raises:
        CacheError: there is no such directory.
    """
    if not cache_dir.is_dir():
        raise CacheError(f"Expected a directory of recorded replies in {cache_dir}, found none. Pass it by `--cache`.")
    problems: list[str] = []
    records: dict[str, Record] = {}
    for path in sorted(path for path in cache_dir.rglob("*") if not path.is_dir() or path.is_symlink()):
        name = str(path.relative_to(cache_dir))
        if name in OTHER_FILES:
            continue
        data = path.read_bytes() if path.is_file() else b""
        problems.extend(f"{name}: expected no secrets, found {secret}" for secret in _secrets(data))
        try:
            record = _check_file(path, data, cache_dir)
        except CacheError as error:
            problems.append(f"{name}: {error}")
            continue
        if KEY_PATTERN.fullmatch(path.stem):
            records[path.stem] = record
    return problems + (_check_use(records, used) if used is not None else [])


def _check_file(path: Path, data: bytes, cache_dir: Path) -> Record:
    """Returns the record of a file that is named, placed and written as every record is.

    Raises:
        CacheError: it is not.
    """
    match = SUPERSEDED_PATTERN.fullmatch(path.stem)
    key = match[1] if match else path.stem
    if path.suffix != ".json" or not KEY_PATTERN.fullmatch(key) or path.is_symlink():
        raise CacheError("expected only record files `<key>.json`, found another file; move it elsewhere")
    expected = cache_dir / key[:SHARD_DIGITS] / path.name
    if path != expected:
        raise CacheError(f"expected this record in {expected.parent.name}/, found it misplaced; move it there")
    return parse_record(data, key, path.as_posix())


def _secrets(data: bytes) -> Iterator[str]:
    """Yields what looks like a secret, by kind: a line that is printed must not repeat it."""
    text = data.decode(errors="replace")
    return (kind for kind, (part, pattern) in SECRETS.items() if part in text and pattern.search(text))


def _check_use(records: dict[str, Record], used: set[str]) -> list[str]:
    """Returns problems between the records and the tables; a truncated reply is used when its repair is."""
    missing = [f"{key}.json: expected a record that the tables name, found none" for key in sorted(used - set(records))]
    unused = [
        f"{key}.json: expected a record that some table names, found it unused ({record.provenance.origin})"
        for key, record in sorted(records.items())
        if key not in used and not (record.truncated and record.request.longer().key in used)
    ]
    return missing + unused
