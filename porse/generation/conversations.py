"""The conversations that ask for functions: first, refinement, mutation, crossover, repair (section A.6 of the paper).

A refinement is cut to four messages, as in Eureka: what is wanted, the task, the best function so far, and how its
training went. A mutation or a crossover shows one or two parents in a single question, as in REvolve. A repair adds the
broken reply and its verdict.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from porse.functions.contract import FUNCTION_NAMES, HELPERS
from porse.functions.verdict import MAX_NAMES, Kind, Verdict
from porse.generation.about import About
from porse.llm.request import Message
from porse.prompts import number, numbers, render
from porse.search.breeding import Breeding
from porse.search.feedback import shown_of
from porse.tables import Row

JUDGED_BY: dict[Kind, tuple[str, ...]] = {
    "reward": ("fitness", "episode_length", "component/"),
    "mapping": ("fitness", "progress/"),
}
"""The series that a kind of function is judged by, in the order that they are shown in."""

BRED_BY = ("fitness", "component/")
"""The series of a parent that is bred from (REvolve)."""


@dataclass(frozen=True)
class Brief:
    """What every conversation of an iteration starts from.

    Attributes:
        prompts: the folder of prompt texts.
        about: the task in words.
        environment: the task's observation code.
        has_bonus: whether policies are paid a bonus for exploration beside the goal reward.
        beyond_goal: whether mappings shall have dimensions beyond the goal.
        winner: row of the previous winner; None in the first iteration.
        feedback: rows of the feedback on it.
        breedings: slot -> how its reward is bred; empty where the winner is refined.
        members: candidate id -> row of the members table.
        member_feedback: rows of the feedback on the members.
    """

    prompts: Path
    about: About
    environment: str
    has_bonus: bool
    beyond_goal: bool
    winner: Row | None
    feedback: Sequence[Row]
    breedings: Mapping[int, Breeding]
    members: Mapping[str, Row]
    member_feedback: Sequence[Row]


def conversation(brief: Brief, kind: Kind, slot: int) -> tuple[Message, ...]:
    """Returns the messages that ask for the function of `kind` in `slot`; only bred rewards differ between slots."""
    contract = contract_text(brief.prompts, kind)
    system = render(brief.prompts, f"{kind}-system", contract=contract, beyond_goal=brief.beyond_goal)
    task = render(brief.prompts, "task", **brief.about, environment=brief.environment, kind=kind)
    first = (Message("system", system), Message("user", task))
    if kind == "reward" and brief.breedings:
        return _bred(first, brief, brief.breedings[slot])
    if brief.winner is None:
        return first
    feedback = render(
        brief.prompts,
        f"{kind}-feedback",
        epochs=max(row["epoch"] for row in brief.feedback),
        feedback=_lines(brief.feedback, JUDGED_BY[kind]),
        has_bonus=brief.has_bonus,
    )
    best = f"```python\n{brief.winner[f'{kind}_source'].strip()}\n```"
    return (*first, Message("assistant", best), Message("user", feedback))


def contract_text(prompts: Path, kind: Kind) -> str:
    """Returns the part of a prompt that says what a function of `kind` must look like."""
    name, helpers = FUNCTION_NAMES[kind][0], [*HELPERS.values()]
    return render(prompts, "contract", kind=kind, function=name, most=MAX_NAMES, helpers=helpers)


def _bred(first: tuple[Message, Message], brief: Brief, breeding: Breeding) -> tuple[Message, ...]:
    """Returns the single question that shows the parents of a reward and how their trainings went."""
    if not breeding.parents:
        return first
    parents = []
    for name in breeding.parents:
        rows = [row for row in brief.member_feedback if row["candidate_id"] == name]
        parents.append({"source": brief.members[name]["reward_source"].strip(), "feedback": _lines(rows, BRED_BY)})
    system, task = first
    text = render(brief.prompts, f"reward-{breeding.operator}", parents=parents)
    return system, Message("user", f"{task.content}\n\n{text}")


def repair(asked: tuple[Message, ...], reply: str, verdict: Verdict, prompts: Path) -> tuple[Message, ...]:
    """Returns the messages that send a broken function back with its verdict."""
    text = render(prompts, "repair", check=verdict.check, line=verdict.line, message=verdict.message)
    # An empty assistant message is refused by most endpoints.
    return (*asked, Message("assistant", reply or "(empty)"), Message("user", text))


def _lines(rows: Sequence[Row], shown: Sequence[str]) -> list[dict[str, Any]]:
    """Returns one line of feedback for each of the shown series."""
    names = shown_of({row["series"] for row in rows}, shown)
    lines: list[dict[str, Any]] = []
    for name in names:
        points = [row for row in rows if row["series"] == name]
        extremes = {key: number(points[0][key]) for key in ("maximum", "mean", "minimum")}
        shown = name.split("/", 1)[-1]
        lines.append({"name": shown, "points": numbers([point["value"] for point in points]), **extremes})
    return lines
