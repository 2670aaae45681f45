"""How different the samples of one question are: a sampler that always says the same is noticed here."""

import ast
import re
import warnings
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

from porse.identity import canonical_json
from porse.llm.record import Record
from porse.llm.request import Origin

MOST_CHARACTERS = 200_000
"""A longer reply is refused by the contract, whose bound this is. A parser would take hundreds of bytes for each letter of it."""

_BLOCK = re.compile(r"```[^\n`]*\n(.*?)```", re.DOTALL)


@dataclass(frozen=True)
class Samples:
    """The recorded samples of one question.

    Attributes:
        key: the key of the first of them.
        origin: where it was asked.
        count: how many samples there are.
        replies: how many different texts.
        functions: how many different functions, whatever they call their local names.
    """

    key: str
    origin: Origin
    count: int
    replies: int
    functions: int


def samples(records: Iterable[Record]) -> list[Samples]:
    """Returns one entry for each question with more than one sample, by iteration, stage, subject and key.

    Samples are requests that differ in `sample` alone. Of a reply that was cut off and asked for again, the longer one
    counts.
    """
    questions: defaultdict[str, dict[int, Record]] = defaultdict(dict)
    for record in sorted(records, key=lambda record: record.request.max_tokens):
        asked = record.request.body()
        for name in ("sample", "max_tokens"):
            del asked[name]
        questions[canonical_json(asked)][record.request.sample] = record
    found = [_compared(group) for group in questions.values() if len(group) > 1]
    return sorted(
        found, key=lambda entry: (entry.origin.iteration, entry.origin.stage, entry.origin.subject, entry.key)
    )


def _compared(group: dict[int, Record]) -> Samples:
    texts = [group[sample].answer.text for sample in sorted(group)]
    first = group[min(group)]
    return Samples(
        first.key, first.provenance.origin, len(texts), len(set(texts)), len({normalised(text) for text in texts})
    )


def normalised(text: str) -> str:
    """Returns what two replies have in common that hold the same function.

    That is the code in the reply's blocks, or the whole reply where it has none, without comments, layout and docstrings,
    and with names of our own for those that the code itself gives to values. What is no Python is compared word by word, and
    so is what is too long to be a function.
    """
    if len(text) > MOST_CHARACTERS:
        return " ".join(text.split())
    code = "\n".join(_BLOCK.findall(text)) or text
    try:
        with warnings.catch_warnings():
            # A text is read here and not judged: an odd escape in it is no news.
            warnings.simplefilter("ignore")
            tree = ast.parse(code)
            return ast.dump(_Plain(_own_names(tree)).visit(tree))
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return " ".join(code.split())


def _own_names(tree: ast.AST) -> dict[str, str]:
    """Returns a name of ours for each name that the code assigns to, in the order of their first appearance."""
    stored = (node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store))
    return {name: f"value {number}" for number, name in enumerate(dict.fromkeys(stored))}


class _Plain(ast.NodeTransformer):
    """Renames values and leaves docstrings and other idle texts out."""

    def __init__(self, names: dict[str, str]) -> None:
        self._names = names

    def visit_Name(self, node: ast.Name) -> ast.Name:
        return ast.Name(self._names.get(node.id, node.id), node.ctx)

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        idle = isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        return None if idle else self.generic_visit(node)
