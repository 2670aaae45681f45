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

A run writes its tables to `results/`, as Parquet. A suite keeps those of each entry in `.porse/suites/NAME/results/ENTRY/results/`.
No column is ever null. Rows are sorted by the key, and the same run gives the same bytes. `feedback`, `members` and
`member_feedback` lie in `run/N/start/`, where iteration N starts.

Any Parquet reader works. The examples need `pip install duckdb pandas` and run in the folder that holds `results/`; a test runs
them.

## How the tables fit together

- `iteration` and `candidate_id` identify a training. `candidates` has a row for each, `curves` its epochs, `scores` its rank after
  each of its rungs, `survivors` the ranks of those that went on, and `mutants` what is special about a mutant. An elite is a
  candidate of two iterations, with functions from the first.
- `parent_id` leads from a candidate to its parent; join `candidates` with itself.
- `reward_key` and `mapping_key` lead to `key` in `replies` and in `verdicts`, and to the record in `llm_cache/`.
- `winner_id` in `iterations` is a `candidate_id` of that iteration.
- `evaluation`, `seeds` and `episodes` describe the winning lineage only.

`porse report` and `porse trends` check that counts and ids agree across the tables of a run.
"""

EXAMPLES = '''## With DuckDB

The winners and the share of their bonus:

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

The candidates of each rung, best first, with the reasons of failures:

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

Why functions did not pass, and who wrote them:

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

Several runs at once, for example a suite; `filename` names the entry of a row:

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

Fitness by epoch, with a column for each candidate of the last iteration:

```python
import pandas

curves = pandas.read_parquet("results/curves.parquet")
last = curves[(curves.iteration == curves.iteration.max()) & (curves.series == "fitness")]
fitness = last.pivot(index="epoch", columns="candidate_id", values="value")
print(fitness)
```

Each component of a winner's reward in its first and last epoch:

```python
import pandas

curves = pandas.read_parquet("results/curves.parquet")
winners = pandas.read_parquet("results/iterations.parquet")[["iteration", "winner_id"]]
own = curves.merge(winners, left_on=["iteration", "candidate_id"], right_on=["iteration", "winner_id"])
components = own[own.series.str.startswith("component/")].groupby(["iteration", "series"]).value.agg(["first", "last"])
print(components)
```

The final success and its spread:

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
        yield "This table is in `run/N/start/`, not in `results/`."
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
