"""A rung's progress on the terminal: epochs, environment steps per second, fitness."""

import time
from types import TracebackType

import click

from porse.training.job import Ended, Report


class RungBar:
    """One bar for all candidates of a rung, a line for each that failed, and a line when it is done.

    Args:
        label: which rung.
        candidates: how many candidates are trained.
        epochs: epochs over all of them.
        steps_per_epoch: environment steps of one epoch.
    """

    def __init__(self, label: str, candidates: int, epochs: int, steps_per_epoch: int) -> None:
        self._label, self._candidates, self._epochs = label, candidates, epochs
        self._steps_per_epoch = steps_per_epoch
        self._fitness: dict[str, float] = {}
        self._failures: list[tuple[str, str]] = []
        self._started = time.monotonic()
        self._bar = click.progressbar(
            length=self._epochs, label=label, item_show_func=lambda text: text or "", show_pos=True, show_eta=False,
        )  # fmt: skip
        self._done = 0

    def __enter__(self) -> "RungBar":
        self._bar.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.__exit__(kind, error, trace)
        for name, why in self._failures:
            click.echo(f"{self._label}: {name} failed: {why}")
        if kind is None:
            best = f", best fitness {max(self._fitness.values()):.3f}" if self._fitness else ""
            click.echo(f"{self._label}: {self._candidates} candidates, {self._done} epochs, {self._speed()}{best}")

    def tell(self, event: Report | Ended) -> None:
        """Shows that one epoch of one candidate is done, and keeps the reason of one that failed for the end."""
        if isinstance(event, Report):
            self._fitness[event.name] = event.fitness
            self._done += 1
            self._bar.update(1, f"{self._speed()}, best fitness {max(self._fitness.values()):.3f}")
        elif event.outcome.failure:
            self._failures.append((event.name, event.outcome.failure))

    def _speed(self) -> str:
        elapsed = max(time.monotonic() - self._started, 1e-9)
        return f"{self._done * self._steps_per_epoch / elapsed:,.0f} steps/s"
