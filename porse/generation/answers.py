"""Who answers: the model by way of its recorded replies, the grammar, files, or a random splice of state variables.

Where llm.on_miss is `grammar`, it answers what has no recorded reply, too.

A question that nobody records still has its key, and what the grammar writes for it follows from the run's seed and that
key alone. So methods that ask the same question get the same answer, whoever answers.
"""

from collections.abc import Sequence
from pathlib import Path

from porse.config import Params
from porse.errors import SearchError
from porse.generation.grammar import mapping_text, reward_text, spliced_mapping_text, values_text
from porse.identity import seed_for
from porse.llm.ask import ask, ask_recorded
from porse.llm.request import Question, Reply
from porse.tasks import find_task

FILES, GRAMMAR, SPLICED = "files", "grammar", "spliced"
FOLDER = "functions"
"""Below it are the folders of one's own functions."""
FUNCTIONS = ("reward", "mapping")
"""Kinds of questions that a function answers; a list of values answers the others."""


def answers(kinds: Sequence[str], questions: Sequence[Question], params: Params, cache: Path) -> list[Reply]:
    """Returns the replies to the questions, in their order.

    Args:
        kinds: what each question asks for: reward, mapping, beta or alpha.
        questions: what to ask and where in the run it is asked.
        params: the run's parameters.
        cache: the folder of recorded replies.

    Raises:
        CacheMiss: replies are missing in frozen mode; and what else `porse.llm.ask.ask` raises.
        SearchError: a function's file is missing.
    """
    writers = [writer(kind, params) for kind in kinds]
    asked = [question for question, other in zip(questions, writers, strict=True) if not other]
    recorded = iter(_recorded(asked, params, cache) if asked else [])
    found = [None if other else next(recorded) for other in writers]
    return [
        reply or _written(other or GRAMMAR, kind, question, params)
        for kind, question, other, reply in zip(kinds, questions, writers, found, strict=True)
    ]


def _recorded(asked: Sequence[Question], params: Params, cache: Path) -> Sequence[Reply | None]:
    """Returns the model's replies; None, where the parameters allow it, for those that the grammar has to give."""
    return (ask_recorded if params.llm.on_miss == "grammar" else ask)(asked, params.llm, cache)


def writer(kind: str, params: Params) -> str:
    """Returns who writes in place of the model, empty for nobody."""
    if kind == "mapping" and params.generate.mappings == "spliced":
        return SPLICED
    return "" if params.generator == "model" else params.generator


def _written(writer: str, kind: str, question: Question, params: Params) -> Reply:
    key = question.request.key
    seed = seed_for(params.seed, writer, key)
    in_file = writer == FILES and kind in FUNCTIONS
    return Reply(
        key=key,
        text=_file_text(kind, question, params) if in_file else _text(writer, kind, seed, params),
        finish_reason="stop",
        prompt_tokens=0,
        completion_tokens=0,
        answered_by=writer,
        cost_usd=0.0,
    )


def _file_text(kind: str, question: Question, params: Params) -> str:
    """Returns the function of a question's slot as a reply; samples of a slot are K apart."""
    slot = question.request.sample % params.generate.candidates
    path = Path(FOLDER) / params.generate.functions / f"{kind}-{slot}.py"
    try:
        source = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise SearchError(
            f"expected the {kind} function of slot {slot} in {path}, found no such file; write it there, or lower generate.candidates"
        ) from None
    return f"```python\n{source.strip()}\n```\n"


def _text(writer: str, kind: str, seed: int, params: Params) -> str:
    if kind not in FUNCTIONS:
        return values_text(kind, params.mutate.mutants, params.candidate.scale, seed)
    variables = find_task(params.task).VARIABLES
    if writer == SPLICED:
        return spliced_mapping_text(variables, seed)
    return reward_text(variables, seed) if kind == "reward" else mapping_text(variables, seed)
