"""`porse llm estimate`: what a run still has to ask, from its schedule and the sizes of recorded replies.

It stands here, and joins the other commands of `porse llm`, because it knows both the schedule and the cache.
"""

import dataclasses
import json
import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from porse.config import Params, load_params
from porse.llm.cli import CACHE, JSON, PARAMS, PROFILE, llm, with_profile
from porse.llm.ledger import totals
from porse.llm.pending import price_of
from porse.llm.record import Record, cost_usd
from porse.llm.request import LONGER_FACTOR, Message, Origin, request_of
from porse.llm.stats import text_table
from porse.llm.store import Store
from porse.printing import echo
from porse.renderer import import_without_drawing

BYTES_PER_TOKEN = 4.0
"""Of English and code, where nobody counted tokens."""

REPAIRS = "validate-code"


@dataclass(frozen=True)
class Planned:
    """One question that the schedule has, with what is known of it beforehand.

    Attributes:
        origin: where it is asked.
        kind: what it asks for: reward, mapping, beta or alpha.
        opening: the texts that its first messages begin with, as far as they are known.
        description: the task in words, which every question has.
    """

    origin: Origin
    kind: str
    opening: tuple[str, ...]
    description: str


@dataclass(frozen=True)
class Line:
    """What is asked in one iteration for one kind.

    Attributes:
        iteration: from 1.
        stage: the stage that asks.
        kind: what is asked for.
        planned: questions that the schedule has, or that repairs are expected to take.
        recorded: how many of them have a recorded reply.
        prompt_tokens: what one of the others is expected to read.
        completion_tokens: what one of the others is expected to write.
    """

    iteration: int
    stage: str
    kind: str
    planned: int
    recorded: int
    prompt_tokens: float
    completion_tokens: float

    @property
    def to_ask(self) -> int:
        """How many are still to be asked."""
        return self.planned - self.recorded


@llm.command()
@CACHE
@PARAMS
@PROFILE
@click.option(
    "--prompts",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("prompts"),
    show_default=True,
    help="Folder of prompt texts.",
)
@JSON
def estimate(cache_dir: Path, params_path: Path, profile: str | None, prompts: Path, as_json: bool) -> None:
    """Estimate the requests, tokens and cost that a run still needs."""
    params = load_params(params_path)
    params = dataclasses.replace(params, llm=with_profile(params.llm, profile))
    store = Store(cache_dir)
    records = [record for key in store.all_keys() if (record := store.read(key)) is not None]
    import_without_drawing()
    lines = estimated(planned_questions(params, prompts), records, params)
    if as_json:
        rows = [{**dataclasses.asdict(line), **_numbers([line], params)} for line in lines]
        most = {"requests_at_most": _most(lines, params), "profile": params.llm.profile}
        echo(json.dumps({"lines": rows, "total": {**_numbers(lines, params), **most}}, indent=2))
        return
    echo(_table(lines, params))
    counted = sum(None not in (record.answer.prompt_tokens, record.answer.completion_tokens) for record in records)
    ledger = totals(store)
    echo()
    echo(_summary(lines, params))
    echo(
        f"sizes: of {len(records)} recorded replies, {counted} with counted tokens; {BYTES_PER_TOKEN:g} bytes are a token "
        "elsewhere, and a reply of which none is recorded is as long as llm.max_tokens"
    )
    echo(f"the ledger of this checkout, which budgets count: {ledger.requests} requests, {ledger.usd:.6f} USD")


def planned_questions(params: Params, prompts: Path) -> list[Planned]:
    """Returns the questions of the schedule that a model answers, in the order of the run, without repairs."""
    # Imported here: these load the tasks, and with them a physics engine.
    from porse.generation.about import about
    from porse.generation.answers import writer
    from porse.generation.conversations import Brief, conversation
    from porse.generation.functions import first_places
    from porse.search.schedule import DRAW, is_searched, mutants, varied
    from porse.tasks import find_task

    task = find_task(params.task)
    brief = Brief(
        prompts=prompts,
        about=about(task),
        environment=task.observation_source().strip(),
        has_bonus=params.candidate.bonus != "none",
        beyond_goal=params.generate.beyond_goal,
        winner=None,
        feedback=[],
        breedings={},
        members={},
        member_feedback=[],
    )
    found: list[Planned] = []
    for n in (entry.n for entry in params.iterations):
        for kind, slot in first_places(params, n):
            opening = tuple(message.content for message in conversation(brief, kind, slot))
            found.append(Planned(Origin("generate", n, f"{kind} {slot}"), kind, opening, task.DESCRIPTION))
        value = varied(params, n)
        if is_searched(params, n) and mutants(params, n) and value != DRAW:
            found.append(Planned(Origin("mutate", n, f"{value}, attempt 0"), value, (), task.DESCRIPTION))
    return [question for question in found if not writer(question.kind, params)]


def estimated(questions: Sequence[Planned], records: Sequence[Record], params: Params) -> list[Line]:
    """Returns what is recorded of the questions and what is still to be asked, by iteration, stage and kind.

    A question counts as recorded when a reply to the same model and settings was first asked for at its place and begins
    as it does. From the first iteration on that lacks a reply, later questions are unknown, so all are to be asked.
    """
    places: defaultdict[Origin, list[Record]] = defaultdict(list)
    for record in records:
        places[record.provenance.origin].append(record)
    groups: defaultdict[tuple[int, str, str], list[bool]] = defaultdict(list)
    openings = {(question.origin.stage, question.kind): question.opening for question in questions}
    first_open = math.inf
    for question in questions:
        origin = question.origin
        # What is asked at half time depends on all that was asked at the start.
        place = origin.iteration + (0.5 if origin.stage == "mutate" else 0.0)
        known = place <= first_open and any(_answers(record, question, params) for record in places[origin])
        if not known:
            first_open = min(first_open, place)
        groups[origin.iteration, origin.stage, question.kind].append(known)
    lines: list[Line] = []
    for (iteration, stage, kind), known_ones in groups.items():
        sizes = _sizes(records, iteration, stage, kind, openings[stage, kind], params)
        lines.append(Line(iteration, stage, kind, len(known_ones), sum(known_ones), *sizes))
        if stage == "generate":
            repairs = math.ceil(_repair_rate(records, kind) * lines[-1].to_ask)
            sizes = _sizes(records, iteration, REPAIRS, kind, openings[stage, kind], params)
            lines += [Line(iteration, REPAIRS, kind, repairs, 0, *sizes)] if repairs else []
    return lines


def _answers(record: Record, question: Planned, params: Params) -> bool:
    """Returns whether a reply recorded at a question's place was asked for as the question would be now."""
    request = record.request
    texts = [message.content for message in request.messages]
    begins = len(texts) >= len(question.opening) and all(
        text.startswith(start) for text, start in zip(texts, question.opening, strict=False)
    )
    about = any(question.description in text for text in texts)
    return begins and about and request_of(params.llm, request.messages, request.sample).key == request.key


def _repair_rate(records: Sequence[Record], kind: str) -> float:
    """Returns how many further replies a recorded function of this kind took."""
    asked = [record.provenance.origin for record in records]
    first = sum(origin.stage == "generate" and origin.subject.startswith(kind) for origin in asked)
    further = sum(origin.stage == REPAIRS and origin.subject.startswith(kind) for origin in asked)
    return further / first if first else 0.0


def _sizes(
    records: Sequence[Record], iteration: int, stage: str, kind: str, opening: Sequence[str], params: Params
) -> tuple[float, float]:
    """Returns the prompt and completion tokens of a question: the mean of what is recorded of its like."""
    alike = [
        record
        for record in records
        if record.provenance.origin.stage == stage and record.provenance.origin.subject.startswith(kind)
    ]
    # A first question holds no feedback, and the chosen model is the best witness of itself.
    nearer = [record for record in alike if (record.provenance.origin.iteration == 1) == (iteration == 1)] or alike
    nearest = [record for record in nearer if record.request.model == params.llm.model] or nearer
    if not nearest:
        return sum(len(text.encode()) for text in opening) / BYTES_PER_TOKEN, float(params.llm.max_tokens)
    prompts = [_tokens(r.answer.prompt_tokens, r.request.messages) for r in nearest]
    replies = [_tokens(r.answer.completion_tokens, (Message("assistant", r.answer.text),)) for r in nearest]
    return math.fsum(prompts) / len(nearest), math.fsum(replies) / len(nearest)


def _tokens(counted: int | None, messages: Sequence[Message]) -> float:
    if counted is not None:
        return float(counted)
    return sum(len(message.content.encode()) for message in messages) / BYTES_PER_TOKEN


def _totals(lines: Sequence[Line], params: Params) -> tuple[int, int, int, float]:
    requests = sum(line.to_ask for line in lines)
    prompt = round(math.fsum(line.to_ask * line.prompt_tokens for line in lines))
    completion = round(math.fsum(line.to_ask * line.completion_tokens for line in lines))
    return requests, prompt, completion, cost_usd(price_of(params.llm), prompt, completion)


def _numbers(lines: Sequence[Line], params: Params) -> dict[str, float]:
    """Returns what is still to be asked, with its tokens in all and its cost, by name."""
    names = ("to_ask", "all_prompt_tokens", "all_completion_tokens", "usd")
    return dict(zip(names, _totals(lines, params), strict=True))


def _table(lines: Sequence[Line], params: Params) -> str:
    names = ("iteration", "stage", "kind", "planned", "recorded", "to ask", "prompt tokens", "completion tokens", "USD")
    rows = []
    for line in lines:
        requests, prompt, completion, usd = _totals([line], params)
        counts = (line.planned, line.recorded, requests, prompt, completion)
        rows.append((str(line.iteration), line.stage, line.kind, *map(str, counts), f"{usd:.6f}"))
    return text_table(names, rows, 3)


def _most(lines: Sequence[Line], params: Params) -> int:
    """Returns how many requests are sent if every reply is broken and cut off."""
    from porse.generation.functions import attempts_at_most

    functions = sum(line.to_ask for line in lines if line.stage == "generate")
    values = sum(line.to_ask for line in lines if line.stage == "mutate")
    return LONGER_FACTOR * (functions * attempts_at_most(params) + values * (params.mutate.max_fresh + 1))


def _summary(lines: Sequence[Line], params: Params) -> str:
    requests, prompt, completion, usd = _totals(lines, params)
    return (
        f"to ask: {requests} requests, {prompt} prompt and {completion} completion tokens, {usd:.6f} USD by the prices of "
        f"profile {params.llm.profile}; {_most(lines, params)} requests at most, if every reply is broken and cut off"
    )
