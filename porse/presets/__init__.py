"""Presets: the numbers that follow from a task and a size, where `params.yaml` says null.

`presets/TASK.yaml` holds them for the tasks of the package, once for each size. A task of one's own has its own file there,
or numbers by rule (`porse.presets.rules`) from what its class says of itself. Values only, never code.
"""

import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from porse.documents import read_yaml
from porse.errors import ParamsError
from porse.presets.own import sizes_of
from porse.presets.rules import values_by_rule
from porse.task_names import TASK_CLASSES, is_own, near_tasks

__all__ = ["FOLDER", "GIVEN", "SIZES", "Preset", "check_task_name", "filled", "find_preset", "given", "preset_file"]

FOLDER = "presets"
"""Where the files lie, below the project's root."""

SIZES = ("cpu", "paper")

GIVEN: Mapping[str, tuple[str, ...]] = {
    "train": (
        "rung_epochs", "num_envs", "steps_per_epoch", "hidden", "init_std", "normalise_observations", "learning_rate",
        "desired_kl", "gamma", "value_coefficient", "passes", "minibatches",
    ),
    "probe": ("least_epochs",),
    "eliminate": ("window",),
    "mutate": ("window",),
}  # fmt: skip
"""What every preset gives, no more and no less: keys by section. In `params.yaml` each of them may be null."""


@dataclass(frozen=True)
class Preset:
    """The numbers of one task at one size.

    Attributes:
        values: by section and key, all of `GIVEN`; types and ranges are not checked here.
        origin: what `porse params` shows beside a value, "preset Over cpu".
        where: names the file, or the class whose numbers were taken, in errors.
    """

    values: Mapping[str, Mapping[str, Any]]
    origin: str
    where: str


def find_preset(document: Mapping[str, Any], where: str, root: Path) -> Preset | None:
    """Returns the preset that a parsed `params.yaml` asks for; None where it asks for none, by having no null for one.

    Args:
        document: the parsed file; a task or a size that is not there is left to the check of types.
        where: names the file in errors.
        root: the project's root, where the presets are, and the modules of tasks of one's own.

    Raises:
        ParamsError: no task or size has that name; the preset's file is missing, or its keys are not those of `GIVEN`; or
            the class of a task of one's own does not say what the rules need.
    """
    task, size = document.get("task"), document.get("size")
    if not isinstance(task, str) or "size" not in document or not any(given(document)):
        return None
    if size not in SIZES:
        near = difflib.get_close_matches(str(size), SIZES, n=1)
        hint = f"did you mean {near[0]}?" if near else "change it there"
        raise ParamsError(f"expected size to be one of {', '.join(SIZES)}, found {size!r} in {where}; {hint}")
    check_task_name(task, where)
    path, origin = root / preset_file(task), f"preset {task} {size}"
    if is_own(task) and not path.is_file():
        return Preset(values_by_rule(size, sizes_of(task, root, path)), f"{origin}, by rule", task)
    return Preset(_read(path)[size], origin, f"{path}, size {size}")


def filled(document: Mapping[str, Any], preset: Preset) -> dict[str, Any]:
    """Returns a parsed `params.yaml` with the preset's values in place of those that are null there."""
    result = dict(document)
    for section, key in given(document):
        result[section] = {**result[section], key: preset.values[section][key]}
    return result


def given(document: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yields section and key of each value of a document that is null and left to the preset."""
    for section, keys in GIVEN.items():
        own = document.get(section)
        if isinstance(own, Mapping):
            yield from ((section, key) for key in keys if key in own and own[key] is None)


def preset_file(task: str) -> str:
    """Returns the path of a task's preset below the root: presets/Over.yaml, presets/my_tasks.cart.CartPole.yaml."""
    return f"{FOLDER}/{task.replace(':', '.')}.yaml"


def check_task_name(task: str, where: str) -> None:
    """Checks that a task is one of the package or of the form "module:Class".

    Raises:
        ParamsError: it is neither; `where` names the file, or whatever else it is in.
    """
    if not is_own(task) and task not in TASK_CLASSES:
        raise ParamsError(
            f"expected task to be a name of `porse tasks` or module:Class, found {task!r} in {where}; {near_tasks(task)}"
        )


def _read(path: Path) -> Mapping[str, Any]:
    """Returns what a preset's file holds: values by size, section and key.

    Raises:
        ParamsError: it is missing, is no YAML, or has other sizes, sections or keys.
    """
    try:
        document: Mapping[str, Any] = read_yaml(path)
    except FileNotFoundError:
        raise ParamsError(
            f"expected the preset of the task in {path}, found no such file; run from the project's root, or give every "
            "value that is null in params.yaml"
        ) from None
    _check_keys(document, SIZES, "", path)
    for size in SIZES:
        _check_keys(document[size], tuple(GIVEN), f"{size}.", path)
        for section, keys in GIVEN.items():
            _check_keys(document[size][section], keys, f"{size}.{section}.", path)
    return document


def _check_keys(found: Any, expected: tuple[str, ...], prefix: str, path: Path) -> None:
    name = prefix.rstrip(".") or "the preset"
    if not isinstance(found, Mapping):
        raise ParamsError(f"expected {name} to hold {', '.join(expected)}, found {found!r} in {path}; correct the file")
    for key in found:
        if key not in expected:
            near = difflib.get_close_matches(str(key), expected, n=1)
            hint = f"did you mean {prefix}{near[0]}?" if near else f"a preset gives {', '.join(expected)}"
            raise ParamsError(f"expected only what a preset gives in {path}, found {prefix}{key}; {hint}")
    for key in expected:
        if key not in found:
            raise ParamsError(f"expected {prefix}{key} in {path}, found none; a preset gives all values, add it")
