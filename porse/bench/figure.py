"""One figure of the bench: what is wanted, and what rounds of measuring found."""

import statistics
from dataclasses import dataclass
from typing import Any, Literal

Suite = Literal["sim", "train", "pipeline", "llm"]


@dataclass(frozen=True)
class Bar:
    """What is wanted of a value.

    Attributes:
        sense: on which side of the limit it has to be; the limit itself is good enough.
        limit: the limit.
    """

    sense: Literal[">=", "<="]
    limit: float

    def holds(self, value: float) -> bool:
        """Returns whether a value is what is wanted."""
        return value >= self.limit if self.sense == ">=" else value <= self.limit


@dataclass(frozen=True)
class Measure:
    """What is measured.

    Attributes:
        suite: the suite that measures it.
        name: what it is called, unlike any other of its suite.
        unit: of the value.
        peer: what the value is a ratio to, or what it is a figure of.
        bar: what is wanted; None where nothing is.
    """

    suite: Suite
    name: str
    unit: str
    peer: str
    bar: Bar | None = None


@dataclass(frozen=True)
class Figure:
    """What was found.

    Attributes:
        measure: what was measured.
        rounds: the value of each round; none where it could not be measured.
        missing: why it could not be measured and what to do, else an empty text.
    """

    measure: Measure
    rounds: tuple[float, ...] = ()
    missing: str = ""

    @property
    def value(self) -> float | None:
        """The median of the rounds; None where nothing was measured."""
        return statistics.median(self.rounds) if self.rounds else None

    @property
    def holds(self) -> bool | None:
        """Whether the value is what is wanted; None where nothing is wanted, or nothing was measured."""
        if self.measure.bar is None or self.value is None:
            return None
        return self.measure.bar.holds(self.value)

    def as_json(self) -> dict[str, Any]:
        """Returns the figure as plain data; what is not there is None."""
        measure, bar = self.measure, self.measure.bar
        return {
            "suite": measure.suite,
            "name": measure.name,
            "value": self.value,
            "unit": measure.unit,
            "peer": measure.peer,
            "sense": bar.sense if bar else None,
            "bar": bar.limit if bar else None,
            "holds": self.holds,
            "low": min(self.rounds, default=None),
            "high": max(self.rounds, default=None),
            "rounds": len(self.rounds),
            "missing": self.missing or None,
        }


def ratios(over: list[float], under: list[float]) -> tuple[float, ...]:
    """Returns the quotient of each round. The two were measured in turn, so what else the machine did falls on both."""
    return tuple(one / other for one, other in zip(over, under, strict=True))
