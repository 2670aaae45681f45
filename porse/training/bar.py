"""A rung's progress: bars on a terminal, one line elsewhere, JSON lines, or nothing; and TensorBoard's files beside it.

This module only watches. Nothing here affects a result, so the variables below are not parameters:

| variable | meaning | default |
| --- | --- | --- |
| `PORSE_PROGRESS` | `auto`: bars where there is a terminal, else one line a rung; `quiet`: failures alone; `json`: a JSON object a line | `auto` |
| `PORSE_PLAN` | the file in which `porse repro` says what the stages are, and what comes after each rung | none |
| `PORSE_TENSORBOARD` | the folder that event files go to, one folder in it for each training | none |
"""

import json
import math
import os
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Any

import click

from porse.errors import ParamsError
from porse.printing import counted, echo
from porse.stage import PLAN_VARIABLE, PROGRESS_VARIABLE
from porse.training.job import Ended, Report

TENSORBOARD_VARIABLE = "PORSE_TENSORBOARD"

_MODES = ("auto", "quiet", "json")

ROOM_FOR = 12
"""So many candidates get a bar of their own, where the terminal is high enough."""

_BAR, _WORDS = (8, 40), 72
"""The least and the greatest width of a bar, and what names, numbers and words beside it take: with 80 columns nothing is cut."""


class RungBar:
    """Shows how the trainings of a rung go, a line for each that failed, and a line when it is done.

    Args:
        label: which rung.
        candidates: how many candidates are trained.
        epochs: epochs over all of them.
        steps_per_epoch: environment steps of one epoch.
    """

    def __init__(self, label: str, candidates: int, epochs: int, steps_per_epoch: int) -> None:
        self._label, self._candidates, self._epochs = label, candidates, epochs
        self._steps_per_epoch = steps_per_epoch
        self._best, self._done = -math.inf, 0
        self._failures: list[tuple[str, str]] = []
        self._started = time.monotonic()
        self._mode = _mode()
        self._stage, self._stages, self._after, whole = _planned(label)
        self._bars = None
        if self._mode == "auto" and sys.stdout.isatty():
            head = f"stage {self._stage} of {self._stages}" if self._stages else ""
            self._bars = _Bars(head, whole, whole - self._after - epochs, label, candidates, epochs)
        folder = os.environ.get(TENSORBOARD_VARIABLE, "")
        self._events = _Events(Path(folder) / label.replace(",", "").replace(" ", "-")) if folder else None

    def __enter__(self) -> "RungBar":
        if self._bars:
            self._bars.start()
        elif self._mode == "json":
            self._tell_json("rung")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bars:
            self._bars.stop()
        for name, why in self._failures:
            if self._mode == "json":
                self._tell_json("failed", candidate=name, failure=why)
            else:
                echo(f"{self._label}: {name} failed: {why}")
        if kind is not None:
            return
        if self._mode == "json":
            self._tell_json("done")
        elif self._mode != "quiet":
            candidates, epochs = counted(self._candidates, "candidate"), counted(self._done, "epoch")
            echo(f"{self._head()}: {candidates}, {epochs}, {self._figures()}")

    def tell(self, event: Report | Ended) -> None:
        """Shows that one epoch of one candidate is done, and keeps the reason of one that failed for the end."""
        if isinstance(event, Report):
            self._best = max(self._best, event.fitness)
            self._done += 1
            if self._bars:
                self._bars.advance(event.name, self._figures(), self._left(), event.fitness)
            elif self._mode == "json":
                self._tell_json("epoch", candidate=event.name, epoch=event.epoch, fitness=event.fitness)
        else:
            if event.outcome.failure:
                self._failures.append((event.name, event.outcome.failure))
            if self._events:
                self._events.write(event.name, event.outcome.rows)

    def _head(self) -> str:
        return f"[{self._stage}/{self._stages}] {self._label}" if self._stages else self._label

    def _figures(self) -> str:
        """Returns speed and best fitness so far in words; the best one never falls."""
        best = f", best fitness {self._best:.3f}" if self._done else ""
        return f"{self._done * self._steps_per_epoch / self._elapsed():,.0f} steps/s{best}"

    def _elapsed(self) -> float:
        return max(time.monotonic() - self._started, 1e-9)

    def _seconds_left(self) -> float | None:
        """Returns how long all trainings of the run still take at this rung's speed; None where no plan says what comes."""
        if not self._stages or not self._done:
            return None
        return (max(self._epochs - self._done, 0) + self._after) * self._elapsed() / self._done

    def _left(self) -> str:
        seconds = self._seconds_left()
        return "" if seconds is None else f"{in_words(seconds)} left over all"

    def _tell_json(self, event: str, **more: Any) -> None:
        left = self._seconds_left()
        line = {
            "event": event,
            "rung": self._label,
            "stage": self._stage,
            "stages": self._stages,
            "candidates": self._candidates,
            "epochs_done": self._done,
            "epochs": self._epochs,
            "steps_per_second": round(self._done * self._steps_per_epoch / self._elapsed(), 1),
            "best_fitness": self._best if self._done and math.isfinite(self._best) else None,
            "seconds_left": None if left is None else round(left, 1),
            **more,
        }
        click.echo(json.dumps(line))
        sys.stdout.flush()


def check_progress() -> None:
    """Checks the variables that say how progress is shown.

    Raises:
        ParamsError: PORSE_PROGRESS names no mode, or PORSE_TENSORBOARD no folder that can be there.
    """
    _mode()
    folder = os.environ.get(TENSORBOARD_VARIABLE, "")
    wrong = next(
        (place for place in (Path(folder), *Path(folder).parents) if place.exists() and not place.is_dir()), None
    )
    if folder and wrong is not None:
        raise ParamsError(
            f"expected {TENSORBOARD_VARIABLE} to be a folder, or one that can be made, found {folder!r}, where {wrong} is a "
            "file; set or unset it"
        )


def _mode() -> str:
    found = os.environ.get(PROGRESS_VARIABLE, "") or "auto"
    if found not in _MODES:
        raise ParamsError(
            f"expected {PROGRESS_VARIABLE} to be one of {', '.join(_MODES)}, found {found[:40]!r} in the environment; set or "
            "unset it"
        )
    return found


def in_words(seconds: float) -> str:
    """Returns a length of time in words: "40 s", "3 min", "2 h 5 min"."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def _planned(label: str) -> tuple[int, int, int, int]:
    """Returns the stage of a rung, the number of stages, the epochs that come after it and those of the whole run; zeros without a plan."""
    try:
        plan = json.loads(Path(os.environ[PLAN_VARIABLE]).read_text(encoding="utf-8"))
        return plan["bars"][label]["stage"], plan["stages"], plan["bars"][label]["epochs_after"], plan["epochs"]
    except (KeyError, OSError, ValueError):
        # A bar without a plan shows its rung alone.
        return 0, 0, 0, 0


class _Bars:
    """Rich's bars: one for the whole run, one for the rung, and one for each candidate where there is room.

    Args:
        head: which stage it is; empty where nobody knows, and the run has no bar.
        whole: epochs of the run.
        done: those before this rung.
        label: which rung.
        candidates: how many candidates are trained.
        epochs: epochs over all of them.
    """

    def __init__(self, head: str, whole: int, done: int, label: str, candidates: int, epochs: int) -> None:
        # Imported here: a run without a terminal needs none of it.
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

        console = Console()
        columns = (
            TextColumn("{task.description}"),
            BarColumn(max(_BAR[0], min(_BAR[1], console.width - _WORDS))),
            MofNCompleteColumn(),
            TextColumn("{task.fields[said]}"),
        )
        self._progress = Progress(*columns, console=console, transient=True)
        self._whole = self._progress.add_task(head, total=whole, completed=done, said="") if head else None
        self._rung = self._progress.add_task(label, total=epochs, said="")
        self._has_room = 1 < candidates <= min(ROOM_FOR, console.height - 5)
        self._each, self._own = epochs / max(candidates, 1), dict[str, tuple[Any, float]]()

    def start(self) -> None:
        self._progress.start()

    def stop(self) -> None:
        self._progress.stop()

    def advance(self, name: str, said: str, left: str, fitness: float) -> None:
        """Moves the rung's bar, the candidate's and the run's by one epoch."""
        self._progress.update(self._rung, advance=1, said=said)
        if self._whole is not None:
            self._progress.update(self._whole, advance=1, said=left)
        if not self._has_room:
            return
        if name not in self._own:
            self._own[name] = self._progress.add_task(f"  {name}", total=self._each, said=""), -math.inf
        bar, before = self._own[name]
        best = max(before, fitness)
        self._own[name] = bar, best
        self._progress.update(bar, advance=1, said=f"best fitness {best:.3f}")


class _Events:
    """TensorBoard's event files: each series of the curves table as a scalar, as large as it is there."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def write(self, name: str, rows: list[tuple[int, str, float]]) -> None:
        """Writes the series of one training: (epoch, series, value)."""
        # Imported here: it takes a second. Values are written in double precision, so that nothing is lost.
        from tensorboard.compat.proto.event_pb2 import Event
        from tensorboard.compat.proto.summary_pb2 import Summary
        from tensorboard.compat.proto.tensor_pb2 import TensorProto
        from tensorboard.compat.proto.types_pb2 import DT_DOUBLE
        from tensorboard.plugins.scalar.metadata import create_summary_metadata
        from tensorboard.summary.writer.event_file_writer import EventFileWriter

        writer = EventFileWriter(str(self._folder / name))
        metadata = create_summary_metadata("", "")
        for epoch, series, value in rows:
            tensor = TensorProto(dtype=DT_DOUBLE, double_val=[value])
            summary = Summary(value=[Summary.Value(tag=series, tensor=tensor, metadata=metadata)])
            writer.add_event(Event(wall_time=time.time(), step=epoch, summary=summary))
        writer.close()
