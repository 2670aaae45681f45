"""The data dictionary: what one row of each table means, and checked, sorted, reproducible reading and writing.

Nothing else in the project knows a column by heart. `write` refuses rows that differ from the declaration, sorts them by
the key, and writes the same bytes for the same rows. `read` refuses a file that differs from the declaration. Both refuse
rows that cannot be told apart, numbers that are not finite where they must be, and ids that are none: a table may come
from somebody else, and the names of files are made of its ids. Rows are plain dicts; a table of a few thousand rows needs
nothing faster.
"""

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import pyarrow as pa
import pyarrow.parquet as pq

from porse.errors import TableError

Row = dict[str, Any]


Form = Literal["any", "finite", "id", "ids"]
"""What values a column may hold: any of its type, finite numbers, an id, or ids joined by + (none: empty)."""


@dataclass(frozen=True)
class Column:
    """One column: its name, its Arrow type, what it means, with the unit, and which values of the type it may hold."""

    name: str
    type: pa.DataType
    meaning: str
    form: Form = "any"


@dataclass(frozen=True)
class Table:
    """One kind of table.

    Attributes:
        name: the file's stem.
        grain: what one row is.
        key: the columns that tell rows apart, in sorting order.
        columns: all columns, in the file's order.
        also: other columns that tell rows apart, none where the key alone does.
    """

    name: str
    grain: str
    key: tuple[str, ...]
    columns: tuple[Column, ...]
    also: tuple[str, ...] = ()

    @property
    def schema(self) -> pa.Schema:
        """The Arrow schema: no column may be null."""
        return pa.schema([pa.field(column.name, column.type, nullable=False) for column in self.columns])


_TEXT, _INT, _REAL, _FLAG = pa.string(), pa.int64(), pa.float64(), pa.bool_()
_ITERATION = Column("iteration", _INT, "iteration, from 1")
_RUNG = Column("rung", _TEXT, "rung, as in params.yaml")
_CANDIDATE = Column("candidate_id", _TEXT, "hash of the candidate's content", "id")

_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
_IDS = re.compile(rf"({_ID.pattern}(\+{_ID.pattern})*)?")
_FORMS: dict[Form, Callable[[Any], object] | None] = {
    "any": None,
    "finite": math.isfinite,
    "id": _ID.fullmatch,
    "ids": _IDS.fullmatch,
}
_EXPECTED: dict[Form, str] = {
    "finite": "finite numbers",
    "id": "ids (at most 100 letters, digits, dots, dashes and underscores, a letter or a digit first)",
    "ids": "ids joined by + (each at most 100 letters, digits, dots, dashes and underscores)",
}

REPLIES = Table(
    "replies",
    "one reply of the model",
    ("iteration", "kind", "slot", "attempt"),
    (
        _ITERATION,
        Column("kind", _TEXT, "what was asked for: reward, mapping, beta or alpha"),
        Column("slot", _INT, "place in the iteration, from 0; a reward and a mapping of one slot are a pair"),
        Column("attempt", _INT, "0: first reply, then repairs and fresh replies of the slot"),
        Column("key", _TEXT, "key of the recorded reply in llm_cache/"),
        Column("finish_reason", _TEXT, "why the model stopped"),
        Column("prompt_tokens", _INT, "tokens of the question when it was recorded"),
        Column("completion_tokens", _INT, "tokens of the reply when it was recorded"),
        Column(
            "recorded_usd",
            _REAL,
            "US dollars that the reply cost when it was recorded; a replay costs nothing",
            "finite",
        ),
        Column("answered_by", _TEXT, "who answered: a model's name, or a person"),
        Column("text", _TEXT, "the reply"),
    ),
)

VERDICTS = Table(
    "verdicts",
    "the verdict on the function in one reply",
    ("iteration", "kind", "slot", "attempt"),
    (
        _ITERATION,
        Column("kind", _TEXT, "reward or mapping"),
        Column("slot", _INT, "place in the iteration, from 0"),
        Column("attempt", _INT, "0: first reply, then repairs and fresh replies of the slot"),
        Column("key", _TEXT, "key of the recorded reply in llm_cache/"),
        Column("passed", _FLAG, "whether the function may be trained with"),
        Column("check", _TEXT, "the check that decided, ok when all passed"),
        Column("line", _INT, "line of the reply that it is about, from 1; 0: none"),
        Column("message", _TEXT, "the reason, for people and for the repair prompt; empty when it passed"),
        Column("warning", _TEXT, "what a person should know of a function that passed, else empty"),
    ),
)

CANDIDATES = Table(
    "candidates",
    "one candidate of a pool",
    ("iteration", "slot"),
    (
        _ITERATION,
        Column("slot", _INT, "place in the iteration, from 0; mutants count on"),
        _CANDIDATE,
        Column("origin", _TEXT, "new, elite (the previous winner's functions), mutant, probe, mutation or crossover"),
        Column("parent_id", _TEXT, "candidates that it comes from, joined by +; empty for a new one", "ids"),
        Column("reward_key", _TEXT, "key of the reply with the reward; empty where none is generated"),
        Column("mapping_key", _TEXT, "key of the reply with the mapping; empty where none is generated"),
        Column("reward_source", _TEXT, "the goal reward, as checked; empty where none is generated"),
        Column("mapping_source", _TEXT, "the mapping, as checked; empty where none is generated"),
        Column("reward_program", _TEXT, "the goal reward as an operator list, JSON: what is trained with"),
        Column("mapping_program", _TEXT, "the mapping as an operator list, JSON: what is trained with"),
        Column("beta", _REAL, "weight of the exploration bonus, 1", "finite"),
        Column("alpha", _REAL, "share of the previous winner in the first policy, 1", "finite"),
        Column("draw", _INT, "0: its training has the random draws that the iteration shares; else which of its own"),
        Column("policy", _TEXT, "stem of the file in policies/ that training goes on from", "id"),
        Column("epochs", _INT, "epochs trained so far in this iteration"),
        Column("failure", _TEXT, "why its training ended early, else empty"),
    ),
    also=("iteration", "candidate_id"),
)

CURVES = Table(
    "curves",
    "one series of one candidate at one epoch",
    ("iteration", "candidate_id", "series", "epoch"),
    (
        _ITERATION,
        _RUNG,
        _CANDIDATE,
        Column(
            "series",
            _TEXT,
            "fitness, reward, goal, bonus, terminated, component/NAME or progress/NAME: means; episode_length; goal_size,"
            " bonus_size, bonus_share; cells_visited, new_cells, where something is counted",
        ),
        Column("epoch", _INT, "epoch of the iteration, from 1"),
        Column(
            "value",
            _REAL,
            "mean over environments and the epoch's steps, goal and bonus before they are weighed, reward the total before it"
            " is scaled for PPO; a fitness over episodes: at the epoch's end; episode_length: over the episodes that ended, no"
            " row where none did; goal_size and bonus_size: standard deviation of what each adds to the total, and bonus_share"
            " bonus_size over that of the total, 0 without a bonus; cells_visited: the share of the cells visited so far, 0 to"
            " 1; new_cells: how many were first visited in this epoch",
        ),
    ),
)

SCORES = Table(
    "scores",
    "the score of one candidate at the end of one rung",
    ("iteration", "rung", "candidate_id"),
    (
        _ITERATION,
        _RUNG,
        _CANDIDATE,
        Column("rank", _INT, "0: best"),
        Column("score", _REAL, "what ranks it (eliminate.score), ties by mts; 0 when it failed", "finite"),
        Column("mts", _REAL, "highest fitness of the iteration so far; 0 when it failed", "finite"),
        Column(
            "failed", _FLAG, "whether its training ended early, or another probe beat it; such a candidate ranks last"
        ),
        Column("survives", _FLAG, "whether it survives"),
    ),
)

SURVIVORS = Table(
    "survivors",
    "one candidate that survived one rung",
    ("iteration", "rung", "rank"),
    (
        _ITERATION,
        _RUNG,
        Column("rank", _INT, "0: best"),
        _CANDIDATE,
        Column("score", _REAL, "what ranked it (eliminate.score)", "finite"),
    ),
    also=("iteration", "rung", "candidate_id"),
)

MUTANTS = Table(
    "mutants",
    "one mutant of the best survivor at half time",
    ("iteration", "index"),
    (
        _ITERATION,
        Column("index", _INT, "place among the values of the reply, from 0"),
        _CANDIDATE,
        Column("parent_id", _TEXT, "the best survivor", "ids"),
        Column("varied", _TEXT, "beta, alpha or draw"),
        Column("proposed", _REAL, "the model's value, 1; of a draw its number", "finite"),
        Column("value", _REAL, "the value after the particle-swarm step, 1", "finite"),
    ),
)

FEEDBACK = Table(
    "feedback",
    "one point of one series of the winner, as the next prompts show it",
    ("series", "epoch"),
    (
        Column("series", _TEXT, "fitness, episode_length, component/NAME or progress/NAME"),
        Column("epoch", _INT, "epoch of the iteration, from 1"),
        Column("value", _REAL, "the series at that epoch"),
        Column("maximum", _REAL, "over all epochs of the iteration"),
        Column("mean", _REAL, "over all epochs of the iteration"),
        Column("minimum", _REAL, "over all epochs of the iteration"),
    ),
)

MEMBERS = Table(
    "members",
    "one member of the islands that rewards evolve on",
    ("island", "candidate_id"),
    (
        Column("island", _INT, "island, from 0"),
        _CANDIDATE,
        Column("fitness", _REAL, "MTS of its training, by which it is drawn and admitted", "finite"),
        Column("reward_source", _TEXT, "the goal reward, as checked"),
    ),
)

MEMBER_FEEDBACK = Table(
    "member_feedback",
    "one point of one series of one member, as the next prompts show it",
    ("candidate_id", *FEEDBACK.key),
    (_CANDIDATE, *FEEDBACK.columns),
)

EVALUATION = Table(
    "evaluation",
    "one epoch of the lineage of winners, trained again with one seed",
    ("seed", "iteration", "epoch"),
    (
        Column("seed", _INT, "which of the further seeds, from 1"),
        _ITERATION,
        _CANDIDATE,
        Column("epoch", _INT, "epoch of the iteration, from 1"),
        Column("fitness", _REAL, "the epoch's fitness, as in the curves table", "finite"),
    ),
)

SEEDS = Table(
    "seeds",
    "one further seed that the lineage of winners was trained with",
    ("seed",),
    (
        Column("seed", _INT, "which of the further seeds, from 1"),
        Column("links", _INT, "links of the lineage that were trained to their end"),
        Column("failure", _TEXT, "why the training of the next link ended early, else empty"),
    ),
)

EPISODES = Table(
    "episodes",
    "one whole episode that the mean action of the run's winner played",
    ("episode",),
    (
        Column("episode", _INT, "which of them, from 0; each is the first of an environment of its own"),
        _CANDIDATE,
        Column("steps", _INT, "control steps that it took"),
        Column("outcome", _REAL, "whether it was solved, 1 or 0; else its mean fitness over the steps", "finite"),
    ),
)

ITERATIONS = Table(
    "iterations",
    "one iteration",
    ("iteration",),
    (
        _ITERATION,
        Column("winner_id", _TEXT, "best candidate at the end of the iteration", "id"),
        Column("beta", _REAL, "the winner's weight of the bonus, 1", "finite"),
        Column("alpha", _REAL, "the winner's share of the previous winner, 1", "finite"),
        Column("mts", _REAL, "highest fitness that any training of the iteration reached", "finite"),
        Column("winner_mts", _REAL, "highest fitness of the winner's training", "finite"),
        Column("score", _REAL, "the winner's score, by which it won (eliminate.score)", "finite"),
        Column(
            "bonus_share",
            _REAL,
            "standard deviation of beta R_e over that of the total, mean over the candidates and epochs of the first rung",
            "finite",
        ),
        Column(
            "cells_visited",
            _REAL,
            "share of the cells visited since the counts were last cleared, at the winner's last epoch; 0 without cells",
            "finite",
        ),
        Column(
            "new_cells",
            _REAL,
            "cells that the winner entered for the first time since the counts were last cleared; mean over its epochs; 0 without cells",
            "finite",
        ),
        Column("epochs", _INT, "epochs spent on all candidates"),
        Column("environment_steps", _INT, "environment steps of those epochs"),
        Column("replies", _INT, "replies with a function in them that were read"),
        Column("valid_replies", _INT, "replies whose function passed every check"),
        Column("repairs", _INT, "replies asked for because an earlier one did not pass"),
    ),
)

TABLES = {
    table.name: table
    for table in (
        REPLIES,
        VERDICTS,
        CANDIDATES,
        CURVES,
        SCORES,
        SURVIVORS,
        MUTANTS,
        FEEDBACK,
        MEMBERS,
        MEMBER_FEEDBACK,
        ITERATIONS,
        EVALUATION,
        SEEDS,
        EPISODES,
    )
}


def write(path: Path, table: Table, rows: Iterable[Mapping[str, Any]]) -> None:
    """Writes `rows` as the table's file at `path`, sorted by the key; equal rows give equal bytes.

    Raises:
        TableError: a column is missing, unknown, null or of another type, two rows have one key, a number is not finite
            that must be, or an id is none.
    """
    ordered = sorted((dict(row) for row in rows), key=lambda row: _key_of(row, table, path))
    names = [column.name for column in table.columns]
    for row in ordered:
        if row.keys() != set(names):
            differ = sorted(set(names) ^ set(row))
            raise TableError(
                f"expected the columns {names} in a row of {table.name}, found a row that differs in {differ}, while writing {path}; correct the stage that made it"
            )
    try:
        arrow = pa.Table.from_pylist(ordered, schema=table.schema)
        arrow.validate(full=True)
    except (pa.ArrowInvalid, pa.ArrowTypeError) as error:
        raise TableError(
            f"expected values of the declared types in {table.name}, found: {error}, while writing {path}; correct the stage that made them"
        ) from error
    for column in arrow.column_names:
        if arrow[column].null_count:
            raise TableError(
                f"expected no missing values in {table.name}, found some in {column} while writing {path}; correct the stage that made them"
            )
    if fault := _fault(ordered, table):
        raise TableError(f"{fault} while writing {path}; correct the stage that made them")
    path.parent.mkdir(parents=True, exist_ok=True)
    # Fixed options: no statistics and no dictionary, so that the bytes follow from the rows and the pinned pyarrow alone.
    pq.write_table(arrow, path, compression="zstd", use_dictionary=False, write_statistics=False, version="2.6")


def read(path: Path, table: Table) -> list[Row]:
    """Returns the rows of the table's file at `path`, in key order.

    Raises:
        TableError: the file is missing, is no Parquet, has other columns than the declaration, or rows that `write`
            refuses.
    """
    try:
        arrow = pq.read_table(path, use_threads=False)
        arrow.validate(full=True)
    except FileNotFoundError:
        raise TableError(
            f"expected the table {table.name} at {path}, found no such file; run `porse repro` to make it"
        ) from None
    except (pa.ArrowInvalid, OSError) as error:
        raise TableError(
            f"expected the table {table.name} at {path}, found an unreadable file: {error}; delete it and run `porse repro`"
        ) from error
    if not arrow.schema.equals(table.schema):
        found = ", ".join(f"{field.name}: {field.type}" for field in arrow.schema)
        raise TableError(
            f"expected the columns of {table.name} (see `porse tables`), found {found} in {path}; the file is of another version, run `porse repro`"
        )
    rows: list[Row] = arrow.to_pylist()
    if fault := _fault(rows, table):
        raise TableError(f"{fault} in {path}; no stage wrote it so: delete it and run `porse repro`")
    return rows


def _fault(rows: Sequence[Row], table: Table) -> str:
    """Returns what was expected of rows that are sorted by the key, and what was found; empty when nothing is wrong."""
    for columns in (table.key, table.also):
        seen: set[tuple[Any, ...]] = set()
        for row in rows if columns else ():
            values = tuple(row[name] for name in columns)
            if values in seen:
                said = ", ".join(f"{name} = {row[name]!r}" for name in columns)
                return f"expected one row for each {table.grain}, found two with {said}"
            seen.add(values)
    for column in table.columns:
        has_form = _FORMS[column.form]
        if has_form is None:
            continue
        wrong = next((row for row in rows if not has_form(row[column.name])), None)
        if wrong is not None:
            found = repr(wrong[column.name])
            return f"expected {_EXPECTED[column.form]} in the column {column.name} of {table.name}, found {found}"
    return ""


def _key_of(row: Mapping[str, Any], table: Table, path: Path) -> tuple[Any, ...]:
    try:
        return tuple(row[name] for name in table.key)
    except KeyError as error:
        raise TableError(
            f"expected the key columns {table.key} in a row of {table.name}, found none named {error} while writing {path}; correct the stage that made it"
        ) from None
