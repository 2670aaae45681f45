"""The inputs of all stages, from `params.yaml` and the files as they are, and one of them read back by its stage."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from porse.config import Params, parse_params, parse_part, resolve_document
from porse.errors import ParamsError
from porse.inputs.files import changed_files, stage_files
from porse.inputs.stages import STAGES, Stage


@dataclass(frozen=True)
class Inputs:
    """The inputs of a stage.

    Attributes:
        parameters: the part of the resolved `params.yaml` that the stage reads.
        files: SHA-256 of each file that its result depends on, by its path below the root.
    """

    parameters: Mapping[str, Any]
    files: Mapping[str, str]

    def render(self) -> str:
        """Returns the inputs as JSON text, a value or a file a line."""
        return json.dumps({"parameters": self.parameters, "files": self.files}, indent=1, sort_keys=True) + "\n"


def resolve_inputs(root: Path, document: Any, where: str) -> dict[str, Inputs]:
    """Returns the inputs of every stage, by its name.

    Args:
        root: the project's root.
        document: the parsed `params.yaml`.
        where: names it in errors.

    Raises:
        ParamsError: a parameter is wrong, or the task's module is not there.
    """
    params = parse_params(document, where, root)
    resolved = resolve_document(document, where, root).document
    return {
        name: Inputs(
            _part(resolved, stage.parameters), stage_files(root, stage, params.task, _own_files(stage, params))
        )
        for name, stage in STAGES.items()
    }


def _own_files(stage: Stage, params: Params) -> tuple[str, ...]:
    """Returns the folder of a user's own functions, for a stage that reads them."""
    reads = params.generator == "files" and "generator" in stage.parameters
    return (f"functions/{params.generate.functions}",) if reads else ()


def read_inputs(path: Path) -> tuple[Inputs, Params]:
    """Returns the inputs in a file, and their parameters, checked.

    Raises:
        ParamsError: there is no such file, or it does not hold inputs.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        inputs = Inputs(document["parameters"], document["files"])
    except FileNotFoundError:
        raise ParamsError(
            f"expected a stage's inputs in {path}, found no such file; run `porse repro resolve`"
        ) from None
    except (ValueError, TypeError, KeyError):
        raise ParamsError(
            f"expected a stage's inputs in {path}, found something else; run `porse repro --force resolve`"
        ) from None
    return inputs, parse_part(inputs.parameters, str(path))


def check_unchanged(root: Path, path: Path, inputs: Inputs, when: str) -> None:
    """Checks that a stage's inputs are what they are on record.

    Args:
        root: the project's root.
        path: the file that the inputs were read from.
        inputs: what it held.
        when: ends the sentence about what has changed, "while the stage ran".

    Raises:
        ParamsError: a file has changed, or the inputs were written anew.
    """
    changed = changed_files(root, inputs.files)
    if not path.is_file() or path.read_text(encoding="utf-8") != inputs.render():
        changed = [str(path), *changed]
    if changed:
        more = f" and {len(changed) - 3} more" if len(changed) > 3 else ""
        raise ParamsError(
            f"expected the inputs of this stage to stay as they were, found {', '.join(changed[:3])}{more} changed {when}; "
            "its result would not match the recorded inputs, so nothing is kept: run `porse repro` again"
        )


def _part(document: Mapping[str, Any], names: tuple[str, ...]) -> dict[str, Any]:
    """Returns those values of a document that dotted names name."""
    part: dict[str, Any] = {}
    for name in names:
        section, _, key = name.partition(".")
        if key:
            part.setdefault(section, {})[key] = document[section][key]
        else:
            part[section] = document[section]
    return part
