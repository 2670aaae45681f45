"""What PoRSE, the methods that it is compared with, and its ablations differ in: values, never code."""

import difflib
from collections.abc import Mapping
from typing import Any

from porse.errors import ParamsError
from porse.methods.sets import ABLATIONS, ASKED, METHODS, Set

__all__ = ["ABLATIONS", "METHODS", "Origin", "origins", "overridden"]

Origin = str
"""Where a value comes from: the file, `method NAME` or `ablation NAME`."""

PIPELINE = frozenset({"iterations", "rungs", "mutate.pool", "fuse.pool"})
"""What the `dvc.yaml` of each iteration is written from: it is the same for every method."""


def overridden(document: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Returns a parsed `params.yaml` with the values of its method, then of its ablation, in place of its own.

    Args:
        document: the parsed file; sections that are not mappings are left to the check of types.
        where: names the file in errors.

    Raises:
        ParamsError: the method or the ablation is unknown, or replaces what the pipeline's files are written from; or the
            ablation is one of a model's and no model writes.
    """
    result = dict(document)
    for _, sections in _chosen(document, where):
        for section, values in sections.items():
            own = result.get(section)
            result[section] = {**own, **values} if isinstance(own, Mapping) else own
    return result


def origins(document: Mapping[str, Any], where: str) -> dict[str, Origin]:
    """Returns where each value of `overridden` comes from that is not the file's own, by its dotted name.

    Raises:
        ParamsError: as for `overridden`.
    """
    return {
        f"{section}.{key}": origin
        for origin, sections in _chosen(document, where)
        for section, values in sections.items()
        for key in values
    }


def _chosen(document: Mapping[str, Any], where: str) -> list[tuple[Origin, Set]]:
    """Returns the sets that a document chooses, in the order that they are laid over it."""
    chosen = []
    for key, sets in (("method", METHODS), ("ablation", ABLATIONS)):
        if key in document:
            name = document[key]
            found = _find(key, name, sets, where)
            _check_set(found, f"{key} {name}")
            chosen.append((f"{key} {name}", found))
    _check_generator(document, where)
    return chosen


def _check_generator(document: Mapping[str, Any], where: str) -> None:
    """Raises a ParamsError where an ablation concerns the model, and no model is asked."""
    ablation, generator = document.get("ablation"), document.get("generator")
    if generator != "model" and ablation in ASKED:
        raise ParamsError(
            f"expected generator to be model with the ablation {ablation}, since {ASKED[ablation]}, found {generator!r} in "
            f"{where}; nobody is asked then, so the run would be that without the ablation: change one of the two"
        )


def _check_set(sections: Set, origin: Origin) -> None:
    names = {section for section in sections} | {
        f"{section}.{key}" for section in sections for key in sections[section]
    }
    for name in sorted(PIPELINE & names):
        raise ParamsError(
            f"expected the {origin} to leave {name} alone, found it replaced in porse/methods/sets.py; the dvc.yaml of "
            "each iteration is written from it and is the same for every method: change it in params.yaml, then run "
            "`porse pipeline`"
        )


def _find(key: str, name: Any, sets: Mapping[str, Set], where: str) -> Set:
    if isinstance(name, str) and name in sets:
        return sets[name]
    near = difflib.get_close_matches(str(name), list(sets), n=1)
    hint = f"did you mean {near[0]}?" if near else "change it there"
    raise ParamsError(f"expected {key} to be one of {', '.join(sets)}, found {name!r} in {where}; {hint}")
