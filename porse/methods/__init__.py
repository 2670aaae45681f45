"""What PoRSE, the methods that it is compared with, and its ablations differ in: values, never code."""

import difflib
from collections.abc import Mapping
from typing import Any

from porse.errors import ParamsError
from porse.methods.sets import ABLATIONS, METHODS, Set

__all__ = ["ABLATIONS", "METHODS", "overridden"]


def overridden(document: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Returns a parsed `params.yaml` with the values of its method, then of its ablation, in place of its own.

    Args:
        document: the parsed file; sections that are no mappings are left to the check of types.
        where: names the file in errors.

    Raises:
        ParamsError: the method or the ablation is unknown.
    """
    result = dict(document)
    for key, sets in (("method", METHODS), ("ablation", ABLATIONS)):
        if key in document:
            for section, values in _find(key, document[key], sets, where).items():
                own = result.get(section)
                result[section] = {**own, **values} if isinstance(own, Mapping) else own
    return result


def _find(key: str, name: Any, sets: Mapping[str, Set], where: str) -> Set:
    if isinstance(name, str) and name in sets:
        return sets[name]
    near = difflib.get_close_matches(str(name), list(sets), n=1)
    hint = f"did you mean {near[0]}?" if near else "change it there"
    raise ParamsError(f"expected {key} to be one of {', '.join(sets)}, found {name!r} in {where}; {hint}")
