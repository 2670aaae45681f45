"""The page `docs/data.md`, from the data dictionary: `python -m porse.report.data_page docs`."""

import sys
from collections.abc import Iterator
from pathlib import Path

from porse.tables import FEEDBACK, MEMBER_FEEDBACK, MEMBERS, TABLES, Table

PAGE = "data.md"

_BETWEEN = (FEEDBACK, MEMBERS, MEMBER_FEEDBACK)
"""Tables that an iteration hands to the next, and that `results/` has not."""

HEAD = """# The data

`python -m porse.report.data_page docs` writes this page from `porse/tables.py`; do not edit it. `porse tables` prints the same
dictionary.

A run leaves its tables in `results/`, as Parquet; a suite leaves those of each entry in `.porse/suites/NAME/results/ENTRY/results/`.
No column is ever null. Rows are sorted by the key, and the same run gives the same bytes. `feedback`, `members` and
`member_feedback` lie in `run/N/start/`, where an iteration starts from.

Any reader of Parquet will do. The examples want `pip install duckdb pandas` and run where `results/` is; a test runs them.

## How tables fit together

- `iteration` and `candidate_id` name a training: `candidates` has a row for each, `curves` its epochs, `scores` its rank after
  every rung that it was in, `survivors` the ranks of those that went on, `mutants` what is special about a mutant. An elite is a
  candidate of two iterations with functions of the first.
- `parent_id` leads from a candidate to the one that it comes from, by joining `candidates` with itself.
- `reward_key` and `mapping_key` lead to `key` in `replies` and in `verdicts`, and from there to the record in `llm_cache/`.
- `winner_id` of `iterations` is a `candidate_id` of that iteration.
- `evaluation`, `seeds` and `episodes` are about the winning lineage alone.

`porse report` and `porse trends` check that the tables of a run agree in counts and ids.
"""

EXAMPLES = '''## With DuckDB

The winners, and what their bonus was worth:

```python
import duckdb

winners = duckdb.sql("""
    SELECT i.iteration, c.origin, c.beta, c.alpha, i.score, i.bonus_share
    FROM 'results/iterations.parquet' i
    JOIN 'results/candidates.parquet' c ON c.iteration = i.iteration AND c.candidate_id = i.winner_id
    ORDER BY i.iteration
""")
print(winners)
```

Who was in each rung, best first, and how each ended:

```python
import duckdb

rungs = duckdb.sql("""
    SELECT s.iteration, s.rung, s.rank, s.candidate_id, c.origin, s.score, s.survives, c.failure
    FROM 'results/scores.parquet' s
    JOIN 'results/candidates.parquet' c USING (iteration, candidate_id)
    ORDER BY s.iteration, s.rung, s.rank
""")
print(rungs)
```

Why functions did not pass, and who had written them:

```python
import duckdb

reasons = duckdb.sql("""
    SELECT r.answered_by, v.kind, v."check", count(*) AS functions, any_value(v.message) AS example
    FROM 'results/verdicts.parquet' v
    JOIN 'results/replies.parquet' r USING (iteration, kind, slot, attempt)
    GROUP BY ALL
    ORDER BY functions DESC, r.answered_by, v.kind, v."check"
""")
print(reasons)
```

Several runs at once, those of a suite: `filename` says which entry a row is of.

```python
import duckdb

best = duckdb.sql("""
    SELECT filename, max(value) AS mts
    FROM read_parquet('.porse/suites/*/results/*/results/curves.parquet', filename = true)
    WHERE series = 'fitness'
    GROUP BY filename
    ORDER BY mts DESC
""")
print(best)
```

## With pandas

Fitness by epoch, a column for each candidate of the last iteration:

```python
import pandas

curves = pandas.read_parquet("results/curves.parquet")
last = curves[(curves.iteration == curves.iteration.max()) & (curves.series == "fitness")]
fitness = last.pivot(index="epoch", columns="candidate_id", values="value")
print(fitness)
```

What each component of a winner's reward did, from its first epoch to its last:

```python
import pandas

curves = pandas.read_parquet("results/curves.parquet")
winners = pandas.read_parquet("results/iterations.parquet")[["iteration", "winner_id"]]
own = curves.merge(winners, left_on=["iteration", "candidate_id"], right_on=["iteration", "winner_id"])
components = own[own.series.str.startswith("component/")].groupby(["iteration", "series"]).value.agg(["first", "last"])
print(components)
```

The final success, and how far it is spread:

```python
import pandas

outcomes = pandas.read_parquet("results/episodes.parquet").outcome
success = outcomes.describe()
print(success)
```
'''


def data_page() -> str:
    """Returns the page as Markdown."""
    return "\n".join([HEAD, "## Tables\n", *(_table(table) for table in TABLES.values()), EXAMPLES])


def _table(table: Table) -> str:
    return "\n".join([f"### {table.name}", "", *_lines(table), ""])


def _lines(table: Table) -> Iterator[str]:
    key = ", ".join(f"`{name}`" for name in table.key)
    yield f"One row is {table.grain}. Key: {key}."
    if table.also:
        yield f"No two rows have the same {' and '.join(f'`{name}`' for name in table.also)} either."
    if table in _BETWEEN:
        yield "It is in `run/N/start/` and not in `results/`."
    yield ""
    yield "| column | type | meaning |"
    yield "| --- | --- | --- |"
    for column in table.columns:
        yield f"| `{column.name}` | {column.type} | {column.meaning.replace('|', chr(92) + '|')} |"


def main(docs: Path) -> None:
    """Writes the page into the folder `docs`."""
    (docs / PAGE).write_text(data_page(), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
