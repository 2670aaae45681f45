"""The conversations that ask for functions: first, refinement, repair (section A.6 of the paper).

A refinement is cut to four messages, as in Eureka: what is wanted, the task, the best function so far, and how its
training went. A repair adds the broken reply and its verdict.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from porse.code.contract import Kind, contract_text
from porse.code.verdict import Verdict
from porse.llm.request import Message
from porse.prompts import number, numbers, render
from porse.tables import Row

PREFIXES: dict[Kind, str] = {"reward": "component/", "mapping": "progress/"}
"""The series that a kind of function is judged by, beside fitness."""


@dataclass(frozen=True)
class Brief:
    """What every conversation of an iteration starts from.

    Attributes:
        prompts: the folder of prompt texts.
        description: the task in words.
        environment: the task's observation code.
        winner: row of the previous winner; None in the first iteration.
        feedback: rows of the feedback on it.
    """

    prompts: Path
    description: str
    environment: str
    winner: Row | None
    feedback: Sequence[Row]


def conversation(brief: Brief, kind: Kind) -> tuple[Message, ...]:
    """Returns the messages that ask for one function of `kind`."""
    system = render(brief.prompts, f"{kind}-system", contract=contract_text(kind))
    task = render(brief.prompts, "task", description=brief.description, environment=brief.environment, kind=kind)
    first = (Message("system", system), Message("user", task))
    if brief.winner is None:
        return first
    rows = [row for row in brief.feedback if row["series"].startswith(("fitness", PREFIXES[kind]))]
    feedback = render(
        brief.prompts, f"{kind}-feedback", epochs=max(row["epoch"] for row in rows), feedback=_lines(rows)
    )
    best = f"```python\n{brief.winner[f'{kind}_source'].strip()}\n```"
    return (*first, Message("assistant", best), Message("user", feedback))


def repair(asked: tuple[Message, ...], reply: str, verdict: Verdict, prompts: Path) -> tuple[Message, ...]:
    """Returns the messages that send a broken function back with its verdict."""
    text = render(prompts, "repair", check=verdict.check, line=verdict.line, message=verdict.message)
    # An empty assistant message is refused by most endpoints.
    return (*asked, Message("assistant", reply or "(empty)"), Message("user", text))


def _lines(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Returns one line of feedback for each series, in the table's order with fitness first."""
    names = sorted({row["series"] for row in rows}, key=lambda name: (name != "fitness", name))
    lines: list[dict[str, Any]] = []
    for name in names:
        points = [row for row in rows if row["series"] == name]
        extremes = {key: number(points[0][key]) for key in ("maximum", "mean", "minimum")}
        shown = name.split("/", 1)[-1]
        lines.append({"name": shown, "points": numbers([point["value"] for point in points]), **extremes})
    return lines
