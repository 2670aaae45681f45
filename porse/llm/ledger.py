"""What this checkout has spent: one line in `.porse/llm-ledger.jsonl` for each reply that an endpoint gave.

A replay adds nothing, so the sum is zero on a machine that only replays. What the recorded replies cost when they were
recorded is in the records themselves.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from porse.llm.record import Record
from porse.llm.store import Store


@dataclass(frozen=True)
class Spending:
    """What one reply, or several together, cost.

    Attributes:
        replies: number of replies.
        prompt_tokens: tokens read by models.
        completion_tokens: tokens written by models.
        cost_usd: cost in US dollars, by the prices at the time of recording.
    """

    replies: int
    prompt_tokens: int
    completion_tokens: int
    cost_usd: float

    @classmethod
    def of(cls, record: Record) -> "Spending":
        """Returns what one recorded reply cost."""
        answer = record.answer
        return cls(1, answer.prompt_tokens or 0, answer.completion_tokens or 0, record.cost_usd)

    def __add__(self, other: "Spending") -> "Spending":
        """Returns the sum of both."""
        return Spending(
            self.replies + other.replies,
            self.prompt_tokens + other.prompt_tokens,
            self.completion_tokens + other.completion_tokens,
            self.cost_usd + other.cost_usd,
        )


NOTHING = Spending(0, 0, 0, 0.0)


def ledger_path(store: Store) -> Path:
    """Returns the file of the ledger."""
    return store.state_dir / "llm-ledger.jsonl"


def add_spending(store: Store, spending: Spending) -> None:
    """Appends one line; several processes may do so at once."""
    with ledger_path(store).open("a", encoding="utf-8") as file:
        file.write(json.dumps(asdict(spending), sort_keys=True) + "\n")


def total_spending(store: Store) -> Spending:
    """Returns what this checkout has spent; a line that was cut off by a crash is left out."""
    try:
        lines = ledger_path(store).read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        return NOTHING
    total = NOTHING
    for line in lines:
        try:
            total += Spending(**json.loads(line))
        except (ValueError, TypeError):
            continue
    return total
