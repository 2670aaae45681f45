"""What the tests of meaning share: changed parameters, whole rows of tables, and the numbers of named draws."""

import dataclasses
import hashlib
from typing import Any

from porse.config import Params
from porse.tables import Row, Table

_NEUTRAL: dict[str, Any] = {"string": "", "int64": 0, "double": 0.0, "bool": False}


def changed(params: Params, **sections: dict[str, Any]) -> Params:
    """Returns the parameters with some values of some sections replaced."""
    replaced = {name: dataclasses.replace(getattr(params, name), **values) for name, values in sections.items()}
    return dataclasses.replace(params, **replaced)


def row_of(table: Table, **values: Any) -> Row:
    """Returns a row with these values, and neutral ones in every other column that the table declares."""
    neutral = {column.name: "id" if column.form == "id" else _NEUTRAL[str(column.type)] for column in table.columns}
    return neutral | values


def named(text: str) -> int:
    r"""Returns the number of a named draw from the draw's own text: `printf 'seed\n[5,"swarm",3]' | sha256sum`.

    It is what the first 16 hexadecimal digits of the digest say, without the last of their 64 bits.
    """
    return int(hashlib.sha256(f"seed\n{text}".encode()).hexdigest()[:16], 16) >> 1
