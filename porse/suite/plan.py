"""A suite's file as frozen dataclasses, and the runs that it asks for, in order."""

import difflib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from porse.conversion import CONFIG, Range, Some, convert, wrong
from porse.documents import read_yaml
from porse.errors import ParamsError
from porse.methods import ABLATIONS, METHODS
from porse.task_names import TASK_CLASSES

CHOSEN = ("task", "method", "ablation", "seed")
"""The parameters that an entry is named after; overrides leave them alone."""

_FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
_OWN_TASK = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")

Seed = Annotated[int, Range(0, 2**31 - 1)]


@dataclass(frozen=True)
class Entry:
    """One run of a suite.

    Attributes:
        variant: name of the variant that its overrides come from, empty for none.
        overrides: laid over `params.yaml`, after the overrides of the suite.
    """

    __pydantic_config__ = CONFIG

    task: str
    method: str
    ablation: str
    variant: str
    seed: Seed
    overrides: dict

    @property
    def name(self) -> str:
        """The entry's name, which its folder and its log have: `Quadcopter-porse-without-fusion-2`."""
        ablation = () if self.ablation == "none" else (self.ablation,)
        variant = (self.variant,) if self.variant else ()
        return "-".join((self.task.replace(":", "."), self.method, *ablation, *variant, str(self.seed)))


@dataclass(frozen=True)
class Suite:
    """The runs that a suite's file asks for.

    Attributes:
        name: names the suite's folder.
        overrides: laid over `params.yaml` in every entry.
        entries: in the order that they run in.
    """

    name: str
    overrides: dict
    entries: Sequence[Entry]


@dataclass(frozen=True)
class _File:
    """A suite's file: lists that are combined, and further entries."""

    __pydantic_config__ = CONFIG

    name: str
    tasks: Some[str]
    methods: Some[str]
    ablations: Some[str]
    variants: dict
    seeds: Some[Seed]
    overrides: dict
    entries: list


def load_suite(path: Path) -> Suite:
    """Returns the checked suite of the file at `path`.

    Raises:
        ParamsError: the file is missing, is no YAML mapping, or what it says is unknown, mistyped or contradictory.
    """
    try:
        document = read_yaml(path)
    except FileNotFoundError:
        raise ParamsError(f"expected a suite in {path}, found no such file; name one as in suites/") from None
    return parse_suite(document, str(path))


def parse_suite(document: Any, where: str) -> Suite:
    """Returns the checked suite of a parsed document; `where` names it in errors.

    Its entries are tasks x methods x ablations x variants x seeds, the seed fastest, then those listed one by one. An
    ablation is one of PoRSE: other methods are combined with `none` alone. A variant is a name and its overrides.
    `ablations`, `variants`, `overrides` and `entries` may be left out: no ablation, one variant without a name, nothing
    else changed, no further entries.

    Raises:
        ParamsError: something is missing, unknown, mistyped or asked for twice.
    """
    file: _File = convert(
        _with(document, ablations=["none"], variants={"": {}}, overrides={}, entries=[]), _File, "", where
    )
    if not _FILE_NAME.fullmatch(file.name):
        raise ParamsError(wrong("name", "letters, digits, dots, dashes and underscores", file.name, where))
    _check_overrides(file.overrides, "overrides", where)
    for index, task in enumerate(file.tasks):
        _check_task(task, f"tasks[{index}]", where)
    for index, method in enumerate(file.methods):
        _check_known(method, METHODS, f"methods[{index}]", where)
    for index, ablation in enumerate(file.ablations):
        _check_known(ablation, ABLATIONS, f"ablations[{index}]", where)
    for variant, overrides in file.variants.items():
        _check_variant(variant, overrides, where)
    combined = [
        Entry(task, method, ablation, variant, seed, overrides)
        for task in file.tasks
        for method in file.methods
        for ablation in (file.ablations if method == "porse" else ("none",))
        for variant, overrides in file.variants.items()
        for seed in file.seeds
    ]
    listed = [_parse_entry(item, f"entries[{index}]", where) for index, item in enumerate(file.entries)]
    _check_distinct([*combined, *listed], where)
    return Suite(file.name, file.overrides, (*combined, *listed))


def _with(document: Any, **optional: Any) -> Any:
    """Returns a mapping with what it leaves out; anything else as it is, for `convert` to refuse."""
    return {**optional, **document} if isinstance(document, dict) else document


def _parse_entry(item: Any, name: str, where: str) -> Entry:
    entry: Entry = convert(_with(item, ablation="none", variant="", overrides={}), Entry, name, where)
    _check_task(entry.task, f"{name}.task", where)
    _check_known(entry.method, METHODS, f"{name}.method", where)
    _check_known(entry.ablation, ABLATIONS, f"{name}.ablation", where)
    _check_variant(entry.variant, entry.overrides, where)
    return entry


def _check_task(value: str, name: str, where: str) -> None:
    # One outside the package is found by the first stage, among the tracked files.
    if not _OWN_TASK.fullmatch(value):
        _check_known(value, TASK_CLASSES, name, where)


def _check_known(value: str, known: Iterable[str], name: str, where: str) -> None:
    names = list(known)
    if value not in names:
        near = difflib.get_close_matches(value, names, n=3)
        hint = f"did you mean {' or '.join(near)}?" if near else "change it there"
        raise ParamsError(f"expected {name} to be one of {', '.join(names)}, found {value!r} in {where}; {hint}")


def _check_variant(name: Any, overrides: Any, where: str) -> None:
    if name != "" and not (isinstance(name, str) and _FILE_NAME.fullmatch(name)):
        raise ParamsError(wrong("a variant", "letters, digits, dots, dashes and underscores", name, where))
    if not isinstance(overrides, dict):
        raise ParamsError(wrong(f"variants.{name}", "parameters and their values", overrides, where))
    _check_overrides(overrides, f"variants.{name}" if name else "overrides", where)


def _check_overrides(overrides: dict, name: str, where: str) -> None:
    for key in CHOSEN:
        if key in overrides:
            raise ParamsError(
                f"expected {name} to leave {key} alone in {where}, found {overrides[key]!r}; the suite's own lists and "
                "entries choose it"
            )


def _check_distinct(entries: Sequence[Entry], where: str) -> None:
    seen: set[str] = set()
    for entry in entries:
        if entry.name in seen:
            raise ParamsError(
                f"expected every entry once in {where}, found {entry.name} twice; take one away, or give it a "
                "variant of its own"
            )
        seen.add(entry.name)
