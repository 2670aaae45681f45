"""The suite `llm`: what each recorded reply costs a run."""

import dataclasses
import time
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

from porse.bench.figure import Figure
from porse.bench.table import KEY, LOOK_UP, VERIFY, found, missing
from porse.llm.store import Store
from porse.llm.verify import verify

_NAMES = (LOOK_UP, VERIFY, KEY)
_RECORDS = 500
"""So many are looked up in a round at most."""


def figures(count: int, cache: Path) -> Iterator[Figure]:
    """Yields the figures of the suite.

    Args:
        count: rounds of each.
        cache: the recorded replies.
    """
    keys = [*islice(Store(cache).all_keys(), _RECORDS)]
    if not keys:
        yield from (
            missing("llm", name, f"no recorded replies in {cache}: name a folder with --cache") for name in _NAMES
        )
        return
    measured = [_round_ms(cache, keys) for _ in range(count + 1)][1:]
    for name, values in zip(_NAMES, zip(*measured, strict=True), strict=True):
        yield found("llm", name, values)


def _round_ms(cache: Path, keys: Sequence[str]) -> tuple[float, float, float]:
    """Returns the processor milliseconds of a look-up, of a check, and of a key, each the mean over the records."""
    store = Store(cache)
    begun = time.process_time()
    records = [store.read(key) for key in keys]
    lookup = time.process_time() - begun
    begun = time.process_time()
    verify(cache)
    check = time.process_time() - begun
    # Copies: a request keeps the key that it has once computed.
    requests = [dataclasses.replace(record.request) for record in records if record is not None]
    begun = time.process_time()
    for request in requests:
        assert request.key
    computed = time.process_time() - begun
    everything = sum(1 for _ in store.all_keys())
    return 1e3 * lookup / len(keys), 1e3 * check / everything, 1e3 * computed / len(requests)
