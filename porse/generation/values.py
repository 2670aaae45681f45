"""Values of beta or alpha for the mutants: the question about the survivor's record, and the numbers in the reply."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from porse.config import Params
from porse.errors import SearchError
from porse.generation.about import About
from porse.generation.answers import answers
from porse.llm.request import Message, Origin, Question, Reply, request_of
from porse.prompts import number, numbers, render
from porse.search.feedback import Series
from porse.search.schedule import ALPHA
from porse.tables import Row

_BLOCK = re.compile(r"```[^\n`]*\n(.*?)```", re.DOTALL)


@dataclass(frozen=True)
class Proposal:
    """The values that a reply proposes.

    Attributes:
        values: beta or alpha of each mutant.
        replies: every reply that was asked for; the last one holds the values.
    """

    values: list[float]
    replies: list[Reply]


def beta_question(
    survivor: Row, record: Sequence[Series], about: About, params: Params, prompts: Path
) -> tuple[Message, ...]:
    """Returns the messages that ask for weights of goal reward and bonus.

    Args:
        survivor: row of the best survivor, whose weights are to be varied.
        record: its series so far, fitness first; the recent epochs of them are shown.
        about: the task in words.
        params: the run's parameters.
        prompts: the folder of the prompts' templates.
    """
    scale, made_of = params.candidate.scale, {"goal": params.candidate.goal, "bonus": params.candidate.bonus}
    system = render(prompts, "beta-system", scale=number(scale), count=params.mutate.mutants, **made_of)
    task = render(
        prompts,
        "beta-task",
        **about,
        **made_of,
        length=min(params.mutate.window, len(record[0].epochs)),
        **_shown([series.last(params.mutate.window).sampled(params.mutate.points) for series in record]),
        bonus_weight=number(survivor["beta"]),
        goal_weight=number(scale - survivor["beta"]),
    )
    return Message("system", system), Message("user", task)


def alpha_question(
    survivor: Row, record: Sequence[Series], about: About, params: Params, prompts: Path
) -> tuple[Message, ...]:
    """Returns the messages that ask for shares of the previous winner.

    Args:
        survivor: row of the best survivor, whose share is to be varied.
        record: sampled series of the previous winner, over the whole iteration that it won, fitness first.
        about: the task in words.
        params: the run's parameters.
        prompts: the folder of the prompts' templates.
    """
    system = render(prompts, "alpha-system", count=params.mutate.mutants)
    length, alpha = record[0].epochs[-1], number(survivor["alpha"])
    task = render(prompts, "alpha-task", **about, length=length, **_shown(record), alpha=alpha)
    return Message("system", system), Message("user", task)


def _shown(record: Sequence[Series]) -> dict[str, Any]:
    """Returns what prompts show of a record: the epochs of fitness, and a line for each series."""
    return {
        "epochs": record[0].epochs,
        "series": [{"name": series.name, "points": numbers(series.values)} for series in record],
    }


def propose(messages: tuple[Message, ...], varied: str, params: Params, iteration: int, cache: Path) -> Proposal:
    """Returns the model's values, asking afresh while a reply holds none.

    Raises:
        SearchError: no reply held usable values.
    """
    replies, reason = list[Reply](), ""
    for sample in range(params.mutate.max_fresh + 1):
        question = Question(
            request_of(params.llm, messages, sample), Origin("mutate", iteration, f"{varied}, attempt {sample}")
        )
        [reply] = answers([varied], [question], params, cache)
        replies.append(reply)
        try:
            return Proposal(parse_values(reply.text, varied, params.mutate.mutants, params.candidate.scale), replies)
        except ValueError as error:
            reason = str(error)
    raise SearchError(
        f"expected {params.mutate.mutants} values of {varied} for iteration {iteration}, found none in {len(replies)} replies; the last: {reason}. Raise mutate.max_fresh, or change the prompts or the model"
    )


def parse_values(text: str, varied: str, count: int, scale: float) -> list[float]:
    """Returns the values in the last block of a reply, or in the reply as a whole when it has no block.

    A pair of weights gives beta = scale x bonus / (goal + bonus), so that a pair with another sum keeps its ratio.

    Raises:
        ValueError: they are no JSON list of `count` numbers (alpha) or pairs of weights (beta) in range.
    """
    blocks = _BLOCK.findall(text)
    try:
        found = json.loads(blocks[-1] if blocks else text)
    except json.JSONDecodeError as error:
        raise ValueError(f"expected JSON in the last block, found {error}") from error
    if not isinstance(found, list) or len(found) != count:
        raise ValueError(f"expected a list of {count}, found {json.dumps(found)[:200]}")
    return [_alpha(item) if varied == ALPHA else _beta(item, scale) for item in found]


def _alpha(item: Any) -> float:
    if isinstance(item, bool) or not isinstance(item, int | float) or not 0.0 <= item <= 1.0:
        raise ValueError(f"expected a number in [0, 1], found {item!r}")
    return float(item)


def _beta(item: Any, scale: float) -> float:
    if not isinstance(item, dict):
        raise ValueError(f'expected a pair {{"goal": ..., "bonus": ...}}, found {item!r}')
    goal, bonus = _weight(item, "goal"), _weight(item, "bonus")
    if not 0.0 < goal + bonus < float("inf"):
        raise ValueError(f"expected weights with a finite sum above 0, found {item!r}")
    return scale * bonus / (goal + bonus)


def _weight(pair: dict[str, Any], name: str) -> float:
    weight = pair.get(name)
    if isinstance(weight, bool) or not isinstance(weight, int | float) or not weight >= 0:
        raise ValueError(f"expected a weight {name}, a number of 0 or more, found {weight!r} in {pair!r}")
    return float(weight)
