"""Tables of the recorded replies: what they cost when they were recorded, who answered, how different samples are."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from porse.llm.ledger import NOTHING, Spending
from porse.llm.record import Record
from porse.llm.sampling import Samples
from porse.printing import visible

_KEY_DIGITS = 12
"""So many digits of a key are printed; every command takes the first digits of one."""


@dataclass(frozen=True)
class Line:
    """One line of the statistics.

    Attributes:
        group: what the line is about: a stage and an iteration, or a model.
        spending: replies, tokens and cost.
        truncated: replies that were cut off by their limit.
    """

    group: tuple[str, ...]
    spending: Spending
    truncated: int


def by_place(records: Iterable[Record]) -> list[Line]:
    """Returns one line for each iteration and stage that first asked, in this order."""
    return _grouped(
        ((record.provenance.origin.iteration, record.provenance.origin.stage), record) for record in records
    )


def by_model(records: Iterable[Record]) -> list[Line]:
    """Returns one line for each model asked and whoever answered, in this order."""
    return _grouped(((record.request.model, record.provenance.answered_by), record) for record in records)


def total(lines: Iterable[Line]) -> Spending:
    """Returns the sum of all lines."""
    return sum((line.spending for line in lines), NOTHING)


def spending_table(heading: tuple[str, str], lines: list[Line]) -> str:
    """Returns the lines as a text table; `heading` says what its first two columns are."""
    names = (*heading, "replies", "truncated", "prompt tokens", "completion tokens", "recorded USD")
    rows = [
        (
            *line.group,
            str(line.spending.replies),
            str(line.truncated),
            str(line.spending.prompt_tokens),
            str(line.spending.completion_tokens),
            f"{line.spending.cost_usd:.6f}",
        )
        for line in lines
    ]
    return text_table(names, rows, len(heading))


def samples_table(found: list[Samples]) -> str:
    """Returns how different the samples of each question are, as a text table."""
    names = ("iteration", "stage", "first asked for", "its key", "samples", "different replies", "different functions")
    rows = [
        (
            str(entry.origin.iteration),
            entry.origin.stage,
            entry.origin.subject,
            entry.key[:_KEY_DIGITS],
            str(entry.count),
            str(entry.replies),
            str(entry.functions),
        )
        for entry in found
    ]
    return text_table(names, rows, 4)


def text_table(names: tuple[str, ...], rows: Sequence[tuple[str, ...]], texts: int) -> str:
    """Returns a text table whose first `texts` columns are texts and whose others are numbers; each row is one line."""
    lines = [[visible(cell, keep="") for cell in row] for row in [names, *rows]]
    widths = [max(len(line[column]) for line in lines) for column in range(len(names))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if column < texts else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


def _grouped(pairs: Iterable[tuple[tuple[int | str, str], Record]]) -> list[Line]:
    groups: defaultdict[tuple[int | str, str], list[Record]] = defaultdict(list)
    for group, record in pairs:
        groups[group].append(record)
    return [
        Line(
            group=tuple(str(part) for part in group),
            spending=sum((Spending.of(record) for record in groups[group]), NOTHING),
            truncated=sum(record.truncated for record in groups[group]),
        )
        for group in sorted(groups)
    ]
