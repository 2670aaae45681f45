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
    kind = next(column.type for column in table.columns if column.name == last)
    values = ["b", "a"] if kind == pa.string() else [2, 1]
    tables.write(tmp_path / "one.parquet", table, [row_of(table, **{last: value}) for value in values])
    rows = tables.read(tmp_path / "one.parquet", table)
    assert [row[last] for row in rows] == sorted(values)
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
    ],
)
def test_rows_that_differ_from_the_declaration_are_refused_and_nothing_is_written(rows, message, tmp_path):
    with pytest.raises(TableError, match=message):
        tables.write(tmp_path / "t.parquet", tables.SCORES, rows)
    assert not (tmp_path / "t.parquet").exists()


def test_a_missing_a_damaged_and_a_foreign_file_are_told_apart(tmp_path):
    with pytest.raises(TableError, match="no such file; run `dvc repro`"):
        tables.read(tmp_path / "none.parquet", tables.SCORES)
    (tmp_path / "bad.parquet").write_bytes(b"PAR1 and then nothing")
    with pytest.raises(TableError, match="unreadable"):
        tables.read(tmp_path / "bad.parquet", tables.SCORES)
    pq.write_table(pa.table({"x": [1]}), tmp_path / "other.parquet")
    with pytest.raises(TableError, match="found x: int64"):
        tables.read(tmp_path / "other.parquet", tables.SCORES)
