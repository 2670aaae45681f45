import math
import re

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from porse import tables
from porse.errors import TableError

SAMPLES = {pa.string(): "text", pa.int64(): 3, pa.float64(): 0.1, pa.bool_(): True}


def row_of(table, **changes):
    return {column.name: SAMPLES[column.type] for column in table.columns} | changes


@pytest.mark.parametrize("table", tables.TABLES.values(), ids=tables.TABLES)
def test_write_read_write_gives_the_same_bytes(table, tmp_path):
    last = table.key[-1]
    kinds = {column.name: column.type for column in table.columns}
    told_apart = {name: ["b", "a"] if kinds[name] == pa.string() else [2, 1] for name in (last, *table.also[-1:])}
    rows = [row_of(table, **{name: values[index] for name, values in told_apart.items()}) for index in (0, 1)]
    tables.write(tmp_path / "one.parquet", table, rows)
    rows = tables.read(tmp_path / "one.parquet", table)
    assert [row[last] for row in rows] == sorted(told_apart[last])
    tables.write(tmp_path / "two.parquet", table, reversed(rows))
    assert (tmp_path / "one.parquet").read_bytes() == (tmp_path / "two.parquet").read_bytes()


@pytest.mark.parametrize("table", tables.TABLES.values(), ids=tables.TABLES)
def test_every_table_says_what_it_holds(table):
    assert table.grain
    assert set(table.key) <= {column.name for column in table.columns}
    assert all(column.meaning for column in table.columns)


def test_an_empty_table_can_be_written_and_read(tmp_path):
    tables.write(tmp_path / "t.parquet", tables.SCORES, [])
    assert tables.read(tmp_path / "t.parquet", tables.SCORES) == []


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([row_of(tables.SCORES), row_of(tables.SCORES)], "found two with iteration = 3"),
        ([row_of(tables.SCORES, extra=1)], "extra"),
        ([{k: v for k, v in row_of(tables.SCORES).items() if k != "mts"}], "mts"),
        ([row_of(tables.SCORES, mts="high")], "declared types"),
        ([row_of(tables.SCORES, mts=None)], "missing values"),
        (
            [row_of(tables.CANDIDATES), row_of(tables.CANDIDATES, slot=4)],
            "one row for each one candidate of a pool, found two with iteration = 3, candidate_id = 'text'",
        ),
        ([row_of(tables.CANDIDATES, beta=math.nan)], "finite numbers in the column beta of candidates, found nan"),
        ([row_of(tables.SCORES, score=-math.inf)], "finite numbers in the column score of scores, found -inf"),
        *(
            (
                [row_of(tables.CANDIDATES, **{column: name})],
                f"ids .* in the column {column} of candidates, found {re.escape(repr(name))}",
            )
            for column in ("candidate_id", "policy")
            for name in ("", "../x", "a/b", ".hidden", "-x", "x\n", "x" * 101)
        ),
        ([row_of(tables.CANDIDATES, parent_id="one+../x")], r"ids joined by \+ .* found 'one\+../x'"),
    ],
)
def test_rows_that_differ_from_the_declaration_are_refused_and_nothing_is_written(rows, message, tmp_path):
    table = tables.CANDIDATES if "policy" in rows[0] else tables.SCORES
    with pytest.raises(TableError, match=message):
        tables.write(tmp_path / "t.parquet", table, rows)
    assert not (tmp_path / "t.parquet").exists()


def test_values_that_a_column_may_hold_pass(tmp_path):
    rows = [
        row_of(tables.CANDIDATES, slot=0, candidate_id="5c3f0a9e1b22", policy="alpha-0.250000", parent_id=""),
        row_of(tables.CANDIDATES, slot=1, candidate_id="x", policy="fused", parent_id="5c3f0a9e1b22+y"),
    ]
    tables.write(tmp_path / "t.parquet", tables.CANDIDATES, rows)
    assert tables.read(tmp_path / "t.parquet", tables.CANDIDATES) == rows
    # A component of a reward may be infinite where its total is not.
    curve = [row_of(tables.CURVES, value=math.inf)]
    tables.write(tmp_path / "c.parquet", tables.CURVES, curve)
    assert tables.read(tmp_path / "c.parquet", tables.CURVES) == curve


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([row_of(tables.CANDIDATES, candidate_id="../../x")], "found '../../x' in"),
        ([row_of(tables.CANDIDATES, policy="/etc/x")], "found '/etc/x' in"),
        ([row_of(tables.CANDIDATES, alpha=math.nan)], "column alpha of candidates, found nan in"),
        ([row_of(tables.CANDIDATES), row_of(tables.CANDIDATES)], "found two with iteration = 3, slot = 3 in"),
        ([row_of(tables.CANDIDATES), row_of(tables.CANDIDATES, slot=9)], "found two with iteration = 3, candidate_id"),
    ],
)
def test_a_file_from_elsewhere_is_held_to_what_is_written_here(rows, message, tmp_path):
    pq.write_table(pa.Table.from_pylist(rows, schema=tables.CANDIDATES.schema), tmp_path / "t.parquet")
    with pytest.raises(TableError, match=f"{re.escape(message)} .*t.parquet; no stage wrote it so"):
        tables.read(tmp_path / "t.parquet", tables.CANDIDATES)


def test_text_that_is_no_utf_8_is_refused_with_the_file(tmp_path):
    broken = pa.array([b"\xff"]).cast(pa.binary()).view(pa.string())
    row = pa.Table.from_pylist([row_of(tables.SCORES)], schema=tables.SCORES.schema)
    pq.write_table(row.set_column(1, row.schema.field(1), broken), tmp_path / "t.parquet")
    with pytest.raises(TableError, match=r"unreadable file: .*UTF8.*delete it and run"):
        tables.read(tmp_path / "t.parquet", tables.SCORES)


def test_a_missing_a_damaged_and_a_foreign_file_are_told_apart(tmp_path):
    with pytest.raises(TableError, match="no such file; run `porse repro`"):
        tables.read(tmp_path / "none.parquet", tables.SCORES)
    (tmp_path / "bad.parquet").write_bytes(b"PAR1 and then nothing")
    with pytest.raises(TableError, match="unreadable"):
        tables.read(tmp_path / "bad.parquet", tables.SCORES)
    pq.write_table(pa.table({"x": [1]}), tmp_path / "other.parquet")
    with pytest.raises(TableError, match="found x: int64"):
        tables.read(tmp_path / "other.parquet", tables.SCORES)
