"""Line charts as numbers: where axes, ticks and lines go. The macros of `pages/charts.jinja` draw them as SVG."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import TypeVar

WIDTH, WIDE, HEIGHT = 480, 960, 240
"""Of a drawing, in units of its view box; `WIDE` is the width of one that takes the whole page."""
LEFT, RIGHT, TOP, BOTTOM = 64, 12, 18, 40
"""Of the margins around the field that the lines are in."""
MOST_POINTS = 120
"""Of one line; a longer one keeps its lowest and its highest point of every stretch."""
COLOURS = 8
"""How many the style sheet has; further lines are dashed."""

Point = tuple[float, float]
Edge = tuple[float, float, float]
"""x, and the lower and the upper end of a band there."""
_Place = TypeVar("_Place", bound=tuple[float, ...])


@dataclass(frozen=True)
class Line:
    """One line.

    Attributes:
        name: what it is of.
        points: in the order of x.
        strong: whether it stands out.
        band: edges around it, in the order of x; empty for none.
    """

    name: str
    points: Sequence[Point]
    strong: bool = False
    band: Sequence[Edge] = ()


@dataclass(frozen=True)
class Mark:
    """A vertical line at `x`, with a word above it, and below its upper end what came and what went; empty for none."""

    x: float
    word: str = ""
    came: str = ""
    went: str = ""


@dataclass(frozen=True)
class Chart:
    """What a chart shows: its title, its axes, its lines, its marks, and whether it takes the whole page's width."""

    title: str
    x_label: str
    y_label: str
    lines: Sequence[Line]
    marks: Sequence[Mark] = ()
    wide: bool = False


@dataclass(frozen=True)
class Tick:
    """A place on an axis of a drawing, and the word beside it."""

    at: float
    word: str


@dataclass(frozen=True)
class Rule:
    """A mark in its place."""

    at: float
    mark: Mark


@dataclass(frozen=True)
class Stroke:
    """One line of a drawing.

    Attributes:
        name: the line's.
        style: its classes in the style sheet.
        paths: points of each unbroken part, as SVG writes them.
        dots: parts that are a single point.
        areas: outlines of its band.
    """

    name: str
    style: str
    paths: Sequence[str]
    dots: Sequence[Point]
    areas: Sequence[str] = ()


@dataclass(frozen=True)
class Drawing:
    """A chart with everything in its place, in units of the view box."""

    chart: Chart
    x_ticks: Sequence[Tick]
    y_ticks: Sequence[Tick]
    marks: Sequence[Rule]
    strokes: Sequence[Stroke]

    @property
    def width(self) -> int:
        """Its width; a wide one is drawn with the same letters."""
        return _width(self.chart)


def draw(chart: Chart) -> Drawing | None:
    """Returns the drawing of a chart; None where there is no finite point. A point that is not finite breaks its line."""
    finite = [point for line in chart.lines for point in line.points if all(map(math.isfinite, point))]
    if not finite:
        return None
    edges = [edge for line in chart.lines for _, *ends in line.band for edge in ends if math.isfinite(edge)]
    x_low, x_high = spread_apart([x for x, _ in finite])
    y_low, y_high = spread_apart([*(y for _, y in finite), *edges])
    width = _width(chart)

    def place(x: float, y: float) -> Point:
        across = (x - x_low) / (x_high - x_low)
        up = (y - y_low) / (y_high - y_low)
        return (
            round(LEFT + across * (width - LEFT - RIGHT), 1),
            round(HEIGHT - BOTTOM - up * (HEIGHT - TOP - BOTTOM), 1),
        )

    strokes = []
    for line, style in zip(chart.lines, _styles(chart.lines), strict=True):
        parts = [[place(*point) for point in thinned(part)] for part in _unbroken(line.points)]
        paths = [" ".join(f"{x:g},{y:g}" for x, y in part) for part in parts if len(part) > 1]
        outlines = [
            [*(place(x, low) for x, low, _ in part), *(place(x, high) for x, _, high in reversed(part))]
            for part in map(thinned_band, _unbroken(line.band))
        ]
        areas = [" ".join(f"{x:g},{y:g}" for x, y in outline) for outline in outlines]
        strokes.append(Stroke(line.name, style, paths, [part[0] for part in parts if len(part) == 1], areas))
    return Drawing(
        chart,
        [Tick(place(x, y_low)[0], f"{x:g}") for x in ticks(x_low, x_high) if float(x).is_integer()],
        [Tick(place(x_low, y)[1], f"{y:g}") for y in ticks(y_low, y_high)],
        [Rule(place(mark.x, y_low)[0], mark) for mark in chart.marks if x_low <= mark.x <= x_high],
        strokes,
    )


def ticks(low: float, high: float) -> list[float]:
    """Returns the multiples of 1, 2 or 5 times a power of ten between two numbers, four to nine of them.

    Args:
        low: the lower end.
        high: the upper end, above it.
    """
    power = 10.0 ** math.floor(math.log10((high - low) / 4))
    step = max(size * power for size in (1, 2, 5) if size * power <= (high - low) / 4 * (1 + 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    # 12 digits: 3 * 0.1 is 0.30000000000000004.
    return [float(f"{number * step:.12g}") for number in range(first, last + 1)]


def thinned(points: Sequence[Point]) -> list[Point]:
    """Returns at most `MOST_POINTS` of the points: the lowest and the highest of each of equal stretches, in their order."""
    if len(points) <= MOST_POINTS:
        return list(points)
    stretches = MOST_POINTS // 2
    kept: list[Point] = []
    for number in range(stretches):
        part = points[number * len(points) // stretches : (number + 1) * len(points) // stretches]
        ends = {part.index(min(part, key=lambda p: p[1])), part.index(max(part, key=lambda p: p[1]))}
        kept += [part[place] for place in sorted(ends)]
    return kept


def _styles(lines: Sequence[Line]) -> Iterator[str]:
    """Yields the classes of each line: a colour of its own; that of the ink for one that stands out among others."""
    among = not all(line.strong for line in lines)
    index = 0
    for line in lines:
        if line.strong and among:
            yield "ink strong"
            continue
        yield f"c{index % COLOURS}{' dashed' if index >= COLOURS else ''}{' strong' if line.strong else ''}"
        index += 1


def _width(chart: Chart) -> int:
    return WIDE if chart.wide else WIDTH


def thinned_band(edges: Sequence[Edge]) -> list[Edge]:
    """Returns at most half of `MOST_POINTS` edges: of each of equal stretches its middle, and its lowest and highest end."""
    stretches = MOST_POINTS // 2
    if len(edges) <= stretches:
        return list(edges)
    parts = [
        edges[number * len(edges) // stretches : (number + 1) * len(edges) // stretches] for number in range(stretches)
    ]
    return [(part[len(part) // 2][0], min(low for _, low, _ in part), max(high for *_, high in part)) for part in parts]


def spread_apart(values: Sequence[float]) -> Point:
    """Returns the lowest and the highest value, pulled apart where they are (nearly) equal."""
    low, high = min(values), max(values)
    least = max(abs(low), abs(high), 1.0) * 1e-6
    if high - low < least:
        half = max(abs(low), 1.0) / 2
        return low - half, high + half
    return low, high


def _unbroken(points: Iterable[_Place]) -> list[list[_Place]]:
    runs = groupby(points, key=lambda point: all(map(math.isfinite, point)))
    return [list(run) for is_finite, run in runs if is_finite]
