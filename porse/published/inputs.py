"""The inputs of a run's stages, as stage `resolve` wrote them then, and what differs between them and those of now."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from porse.config import leaves
from porse.inputs.resolve import Inputs
from porse.printing import visible
from porse.published.manifest import SHA256, refused


@dataclass(frozen=True)
class Changes:
    """What differs between the inputs of a stage then and now.

    Attributes:
        files: files that are not what they were, or are of one of the two alone.
        parameters: parameters that are not what they were.
    """

    files: tuple[str, ...]
    parameters: tuple[str, ...]

    def __bool__(self) -> bool:
        return bool(self.files or self.parameters)


def parse_inputs(data: bytes, where: str) -> Inputs:
    """Returns the inputs of a stage, their parameters unread: they may be those of another version.

    Raises:
        PorseError: the bytes hold something else; `where` names their file.
    """
    try:
        document = json.loads(data)
        inputs = Inputs(document["parameters"], document["files"])
        fine = isinstance(inputs.parameters, dict) and all(SHA256.fullmatch(each) for each in inputs.files.values())
        fine = fine and is_visible([inputs.parameters, inputs.files])
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        fine = False
    if not fine:
        raise refused(where, "the inputs of a stage, without control characters", "something else")
    return inputs


def is_visible(document: Any, keep: str = "\n\t") -> bool:
    """Returns whether a JSON document is free of control characters; `keep` names those that its values, not its names, may have."""
    if isinstance(document, dict):
        return is_visible([*document], keep="") and is_visible([*document.values()], keep)
    if isinstance(document, list):
        return all(is_visible(each, keep) for each in document)
    return not isinstance(document, str) or visible(document, keep) == document


def read_folder(folder: Path) -> dict[str, Inputs]:
    """Returns the inputs in a folder, by the kind of stage.

    Raises:
        PorseError: a file holds something else.
    """
    return {path.stem: parse_inputs(path.read_bytes(), str(path)) for path in sorted(folder.glob("*.json"))}


def changes(then: Inputs, now: Inputs) -> Changes:
    """Returns what differs between two inputs of one kind of stage."""
    return Changes(_differ(then.files, now.files), _differ(dict(leaves(then.parameters)), dict(leaves(now.parameters))))


def _differ(then: Mapping[str, Any], now: Mapping[str, Any]) -> tuple[str, ...]:
    # None is a value of its own: a name of one of the two alone differs from all.
    return tuple(
        name for name in sorted({*then, *now}) if name not in then or name not in now or then[name] != now[name]
    )
