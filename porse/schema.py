"""`porse schema`: what `params.yaml` may hold as JSON Schema, which editors complete and check by.

It is made from the dataclasses that the file is read into (`porse.config`): one source of types and ranges. What two
parameters mean together, only the commands check.
"""

import dataclasses
import json
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import click

from porse.config import Params
from porse.errors import ParamsError
from porse.methods import ABLATIONS, METHODS
from porse.presets import GIVEN

FILE = "params.schema.json"
"""Beside `params.yaml`, whose first line names it."""

_SCALARS = {bool: "boolean", int: "integer", float: "number", str: "string"}


def schema() -> dict[str, Any]:
    """Returns the schema of `params.yaml`."""
    document = _of(Params)
    document["properties"]["method"] = {"enum": [*METHODS]}
    document["properties"]["ablation"] = {"enum": [*ABLATIONS]}
    for section, keys in GIVEN.items():
        properties = document["properties"][section]["properties"]
        for key in keys:
            # Null leaves the value to the preset.
            properties[key] = {"anyOf": [properties[key], {"type": "null"}]}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "PoRSE's params.yaml", **document}


def rendered() -> str:
    """Returns the text of the file."""
    return json.dumps(schema(), indent=1) + "\n"


def _of(kind: Any) -> dict[str, Any]:
    """Returns the schema of an annotated type, of the kinds that `porse.conversion.convert` knows."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if dataclasses.is_dataclass(kind):
        hints = typing.get_type_hints(kind, include_extras=True)
        properties = {field.name.rstrip("_"): _of(hints[field.name]) for field in dataclasses.fields(kind)}
        return {
            "type": "object",
            "description": (kind.__doc__ or "").splitlines()[0],
            "properties": properties,
            "required": [*properties],
            "additionalProperties": False,
        }
    if origin is Annotated:
        number, bounds = _of(arguments[0]), arguments[1]
        return {**number, "minimum": bounds.low, "maximum": bounds.high}
    if origin is Literal:
        return {"enum": [*arguments]}
    if origin in (Sequence, tuple):
        return {"type": "array", "items": _of(arguments[0]), **({"minItems": 1} if origin is Sequence else {})}
    if origin is Mapping:
        return {"type": "object", "additionalProperties": _of(arguments[1])}
    if kind is Any:
        return {}
    if kind is type(None):
        return {"type": "null"}
    if kind in _SCALARS:
        return {"type": _SCALARS[kind]}
    return {"anyOf": [_of(other) for other in arguments]}


@click.command("schema")
@click.option("--check", is_flag=True, help=f"Write nothing; fail if {FILE} is out of date.")
def command(check: bool) -> None:
    """Write the JSON Schema of params.yaml; editors use it to complete and check the file."""
    path, text = Path(FILE), rendered()
    if not check:
        path.write_text(text, encoding="utf-8")
        click.echo(f"{path}: written")
    elif not path.is_file() or path.read_text(encoding="utf-8") != text:
        raise ParamsError(
            f"expected {path} to be the schema of porse/config.py, found it out of date; run `porse schema`"
        )
    else:
        click.echo(f"{path} is up to date")
