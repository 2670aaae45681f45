"""The suite `train`: epochs over their floor and beside rsl_rl's runner, workers, memory, and what is learned in ten seconds."""

from collections.abc import Iterator
from pathlib import Path

from porse.bench.figure import Figure, ratios
from porse.bench.table import FLOOR, MEMORY, MTS, PORTABLE, RUNNER, SECONDS, WORKERS, found
from porse.bench.workshop import Workshop, workshop

_TASK, _LARGE_TASK = "Quadcopter", "Over"
_EPOCHS = 4
"""Of Quadcopter, measured together: some tenths of a second."""
_SLOW_ROUNDS = 3
"""At most, of what takes many seconds a round."""
_CANDIDATES, _POOL_EPOCHS = 6, 8
_MEMORY_EPOCHS = 4
_LEARNING_EPOCHS = 90


def figures(count: int, params: Path) -> Iterator[Figure]:
    """Yields the figures of the suite.

    Args:
        count: rounds of each, fewer of what is slow.
        params: the file with the parameters; task, method, size and numbers follow from what is measured.

    Raises:
        PorseError: a training failed.
    """
    slow = min(count, _SLOW_ROUNDS)
    with workshop("fast", params) as fast, workshop("portable", params) as portable:
        yield from _epochs(count, fast, portable)
        yield from _large_epochs(slow, fast)
        yield from _pool(slow, portable)
        yield from _memory(slow, portable)
        yield from _learning(slow, portable)


def _epochs(count: int, fast: Workshop, portable: Workshop) -> Iterator[Figure]:
    """Measures epoch, runner and floor in both profiles, six in turn."""
    shops = {"fast": fast, "portable": portable}
    asked = {"epoch_s": {"epochs": _EPOCHS}, "runner_s": {"epochs": _EPOCHS}, "floor_s": {"times": 2}}
    times: dict[tuple[str, str], list[float]] = {(shop, what): [] for shop in shops for what in asked}
    # The first round finds caches cold, and libraries that import as they go.
    for _ in range(count + 1):
        for what, arguments in asked.items():
            for name, shop in shops.items():
                times[name, what].append(shop.ask(what, task=_TASK, **arguments))
    measured = {key: values[1:] for key, values in times.items()}
    for name in shops:
        own = measured[name, "epoch_s"]
        yield found("train", RUNNER.format(task=_TASK, profile=name), ratios(measured[name, "runner_s"], own))
    for name in shops:
        own = measured[name, "epoch_s"]
        yield found("train", FLOOR.format(task=_TASK, profile=name), ratios(own, measured[name, "floor_s"]))
    yield found("train", PORTABLE, ratios(measured["portable", "epoch_s"], measured["fast", "epoch_s"]))


def _large_epochs(count: int, fast: Workshop) -> Iterator[Figure]:
    own, floor = [], []
    for _ in range(count + 1):
        own.append(fast.ask("epoch_s", task=_LARGE_TASK, epochs=1))
        floor.append(fast.ask("floor_s", task=_LARGE_TASK, times=1))
    yield found("train", FLOOR.format(task=_LARGE_TASK, profile="fast"), ratios(own[1:], floor[1:]))


def _pool(count: int, shop: Workshop) -> Iterator[Figure]:
    times: dict[int, list[float]] = {1: [], 2: []}
    for _ in range(count):
        for workers, own in times.items():
            own.append(shop.ask("pool_s", task=_TASK, candidates=_CANDIDATES, epochs=_POOL_EPOCHS, workers=workers))
    yield found("train", WORKERS, ratios(times[1], times[2]))


def _memory(count: int, shop: Workshop) -> Iterator[Figure]:
    found_mb = [shop.ask("memory_mb", task=_TASK, epochs=_MEMORY_EPOCHS) for _ in range(count)]
    yield found("train", MEMORY, found_mb)


def _learning(count: int, shop: Workshop) -> Iterator[Figure]:
    runs = [shop.ask("learning", task=_TASK, seed=seed, epochs=_LEARNING_EPOCHS) for seed in range(1, count + 1)]
    yield found("train", MTS, [mts for mts, _ in runs])
    yield found("train", SECONDS, [spent for _, spent in runs])
