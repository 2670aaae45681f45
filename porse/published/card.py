"""The card of a published run: what was asked, who answered, where it ran, what came out, and what that shows; from its data."""

from collections.abc import Mapping, Sequence

from porse.report.answer import Fact, answers, asked, author_of, budget, repliers
from porse.report.results import Results

NO_WORDS = "None yet."

_NOT_API = "not an API model"


def card(name: str, results: Results, words: str, kept: Sequence[Fact]) -> str:
    """Returns the card as Markdown.

    Args:
        name: the run's name.
        results: the run.
        words: what its author says of it; empty for nothing.
        kept: what of the run is here and what is not.
    """
    sections = [
        f"# {name}",
        f"How to look at it: `porse show {name}`, `porse play {name}`. How to compute it again: `porse replay {name}`.",
        "## Its author's words",
        words.strip() or NO_WORDS,
        "## What was asked",
        _table(asked(results.params)),
        "## Who answered",
        _table(_repliers(results)) or "Nobody was asked.",
        "## What came out",
        _table([*answers(results), *budget(results)]),
        "## What it shows",
        _list(shows(results)),
        "## What it does not show",
        _list(shows_not(results)),
        "## Where it ran",
        _table(_machine(results.environment)) or "The machine's record was not kept with the run.",
        "## What is here",
        _table(kept),
    ]
    return "\n\n".join(sections) + "\n"


def shows(results: Results) -> list[str]:
    """Returns what a run shows, a sentence each."""
    params, facts = results.params, {fact.name: fact for fact in answers(results)}
    success, normalised = facts["Final success"], facts["Human normalised score, by budget"]
    found = [
        f"That the pipeline, with these parameters and replies, ends with these bytes: `dvc.lock` names them, and "
        f"`porse replay` compares them{' on any x86-64 CPU with AVX2' if params.numerics == 'portable' else ''}.",
        f"How good the winner of this one search is: {success.value}, {success.note}.",
    ]
    if normalised.value != "undefined":
        found.append(
            f"Where that stands between the sparse reward (0) and the human one (1) at equal cost: {normalised.value}."
        )
    return found


def shows_not(results: Results) -> list[str]:
    """Returns what a run cannot show, a sentence each."""
    params = results.params
    found = [
        f"That {params.method} is better or worse than another method: it is one search with one seed. A suite compares methods "
        "over seeds.",
        "That the paper's numbers hold: simulator, budget and model are others.",
    ]
    names = [row["name"] for row in repliers(results.run.replies)]
    if author_of(params) != "model":
        found.append("What a language model can do: none was asked.")
    elif any(_NOT_API in name for name in names):
        found.append("What a certain model can do: who answered is no API model, so that nobody can ask it again.")
    if "grammar" in names and params.generator == "model":
        found.append("What the model would have answered where the grammar stood in for it.")
    if params.numerics == "fast":
        found.append("The same bits on another kind of CPU: `numerics: fast` keeps them on one kind alone.")
    return found


def _repliers(results: Results) -> list[Fact]:
    return [
        Fact(f"{row['replies']} replies ({row['kinds']})", row["name"], f"{row['usd']:.2f} US dollars when recorded")
        for row in repliers(results.run.replies)
    ]


def _machine(environment: Mapping[str, str]) -> list[Fact]:
    return [Fact(name, value) for name, value in environment.items()]


def _table(facts: Sequence[Fact]) -> str:
    """Returns facts as a table; empty where there are none."""
    if not facts:
        return ""
    rows = [f"| {_cell(fact.name)} | {_cell(fact.value)} | {_cell(fact.note)} |" for fact in facts]
    return "\n".join(["| | | |", "| --- | --- | --- |", *rows])


def _cell(text: str) -> str:
    """Returns a text that stays in its cell and is no HTML: who answered is named by somebody else."""
    for sign, other in (("&", "&amp;"), ("<", "&lt;"), (">", "&gt;"), ("|", "\\|")):
        text = text.replace(sign, other)
    return " ".join(text.split())


def _list(sentences: Sequence[str]) -> str:
    return "\n".join(f"- {sentence}" for sentence in sentences)
