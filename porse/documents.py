"""Files that people write: YAML as DVC reads it, and Python as text.

It is YAML 1.2, so that a value is the same for both, and a key that stands twice is refused.
"""

import ast
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

from porse.errors import ParamsError


def read_yaml(path: Path) -> Any:
    """Returns what a YAML file holds.

    Raises:
        FileNotFoundError: there is no such file.
        ParamsError: it is no YAML, or no text in UTF-8.
    """
    try:
        return parse_yaml(path.read_text(encoding="utf-8"), str(path))
    except UnicodeDecodeError as error:
        raise ParamsError(f"expected text in UTF-8 in {path}, found: {error}; save the file as UTF-8") from None


def parse_yaml(text: str, where: str) -> Any:
    """Returns what a YAML text holds; `where` names it in errors.

    Raises:
        ParamsError: it is no YAML, or holds something that is too large or nested too deep to be read.
    """
    # Imported here: stages read JSON, and this takes as long as all that they import besides.
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        # The very call of DVC's own reader.
        return YAML(typ="safe").load(text)
    except YAMLError as error:
        # The library adds how its own defaults could be changed; the first lines say what and where.
        found = " ".join(str(error).split("\n\n")[0].split())
    except (ValueError, RecursionError) as error:
        found = str(error)
    raise ParamsError(f"expected YAML in {where}, found: {found}; correct the file")


def parse_python(content: bytes, where: str) -> ast.Module:
    """Returns the syntax of what a Python file holds; `where` names it in errors. Nothing of it is run.

    Raises:
        ParamsError: it is no Python.
    """
    try:
        return ast.parse(content, where)
    except (SyntaxError, ValueError, RecursionError) as error:
        raise ParamsError(f"expected Python in {where}, found: {error}; correct the file") from None


def render_yaml(document: Any) -> str:
    """Returns a document as YAML text that `parse_yaml` and DVC read as the same document."""
    from ruamel.yaml import YAML

    # Of its writers, this one keeps the order of keys.
    writer = YAML()
    stream = io.StringIO()
    writer.dump(document, stream)
    return stream.getvalue()


def edited_yaml(text: str, where: str, edit: Callable[[Any], None]) -> str:
    """Returns a YAML text with changes; its comments and its layout, which are those of this project's files, stay.

    Args:
        text: the text.
        where: names it in errors.
        edit: changes the document in place, by its keys.

    Raises:
        ParamsError: it is no YAML, or has no such keys.
    """
    from ruamel.yaml import YAML

    parse_yaml(text, where)
    editor = YAML()
    editor.preserve_quotes = True
    editor.width = 2**16
    editor.indent(mapping=2, sequence=4, offset=2)
    editor.representer.add_representer(
        type(None), lambda writer, _: writer.represent_scalar("tag:yaml.org,2002:null", "null")
    )
    document = editor.load(text)
    try:
        edit(document)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ParamsError(
            f"expected the sections and keys of this project's file in {where}, found others ({error!r}); correct the file"
        ) from None
    stream = io.StringIO()
    editor.dump(document, stream)
    return stream.getvalue()
