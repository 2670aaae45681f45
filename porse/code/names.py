"""Names of components and progress variables: plain ones, in columns and in compiled graphs."""

import re
from functools import lru_cache
from typing import Any

from porse.functions.read.contract import MAX_NAME_CHARACTERS
from porse.code.graph import Writer


@lru_cache(maxsize=1024)
def plain_name(name: str) -> str:
    """Returns a name of at most 64 letters, digits and underscores, "unnamed" when nothing is left."""
    return re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")[:MAX_NAME_CHARACTERS].rstrip("_") or "unnamed"


def hold_plain_names(graph: Any) -> None:
    """Puts, in place, plain names where a graph returns constant ones, and whole lists of names and directions.

    So no call has to change or collect them. They stay as they are where something else reads what holds them, or where
    two names would become one.
    """
    returned = next(graph.outputs()).node()
    if returned.kind() == "prim::TupleConstruct":
        for part in list(returned.inputs()):
            _hold(graph, part)


def _hold(graph: Any, part: Any) -> None:
    holder = part.node()
    step = {"prim::DictConstruct": 2, "prim::ListConstruct": 1}.get(holder.kind())
    given = list(holder.inputs())[::step] if step else []
    if len(part.uses()) > 1 or not given or {_constant_type(value) for value in given} - {"str", "bool"}:
        return
    values = [plain_name(value.toIValue()) if _constant_type(value) == "str" else value.toIValue() for value in given]
    if step == 1:
        part.replaceAllUsesWith(Writer(graph, holder).constant(values))
        holder.destroy()
    elif len(set(values)) == len(values):
        for position, value in enumerate(values):
            holder.replaceInput(2 * position, Writer(graph, holder).constant(value))


def _constant_type(value: Any) -> str:
    return str(value.type().str()) if value.node().kind() == "prim::Constant" else ""
