"""`porse schema`: what `params.yaml` may hold as JSON Schema, which editors complete and check by.

It is made from the dataclasses that the file is read into (`porse.config`): one source of types and ranges. What two
parameters mean together, only the commands check.
"""

import json
from pathlib import Path
from typing import Any

import click

from porse.config import Params
from porse.errors import ParamsError
from porse.methods import ABLATIONS, METHODS
from porse.presets import GIVEN
from porse.printing import echo

FILE = "params.schema.json"
"""Beside `params.yaml`, whose first line names it."""


def schema() -> dict[str, Any]:
    """Returns the schema of `params.yaml`."""
    # Imported here: `porse --help` names this command, too.
    from pydantic import TypeAdapter
    from pydantic.json_schema import GenerateJsonSchema

    document = TypeAdapter(Params).json_schema()
    document["properties"]["method"] = {"enum": [*METHODS]}
    document["properties"]["ablation"] = {"enum": [*ABLATIONS]}
    for section, keys in GIVEN.items():
        properties = document["$defs"][f"{section.title()}Params"]["properties"]
        for key in keys:
            # Null leaves the value to the preset.
            properties[key] = {"anyOf": [properties[key], {"type": "null"}]}
    return {"$schema": GenerateJsonSchema.schema_dialect, **document, "title": "PoRSE's params.yaml"}


def rendered() -> str:
    """Returns the text of the file."""
    return json.dumps(schema(), indent=1) + "\n"


@click.command("schema")
@click.option("--check", is_flag=True, help=f"Write nothing; fail if {FILE} is out of date.")
def command(check: bool) -> None:
    """Write the JSON Schema of params.yaml; editors use it to complete and check the file."""
    path, text = Path(FILE), rendered()
    if not check:
        path.write_text(text, encoding="utf-8")
        echo(f"{path}: written")
    elif not path.is_file() or path.read_text(encoding="utf-8") != text:
        raise ParamsError(
            f"expected {path} to be the schema of porse/config.py, found it out of date; run `porse schema`"
        )
    else:
        echo(f"{path} is up to date")
