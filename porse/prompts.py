"""Prompt texts: the files of `prompts/` with facts filled in. A fact that is missing is an error, not a blank."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined, TemplateError

from porse.errors import PorseError


def render(folder: Path, name: str, **facts: Any) -> str:
    """Returns the text of `folder/name.jinja` with `facts` filled in, without blank space at its ends.

    Raises:
        PorseError: the template is missing or wrong, or a fact that it wants is not given.
    """
    # Prompts are text for a model, not HTML: escaping would change the code in them.
    environment = Environment(
        loader=FileSystemLoader(folder), undefined=StrictUndefined, autoescape=False, keep_trailing_newline=False
    )
    try:
        return environment.get_template(f"{name}.jinja").render(**facts).strip()
    except TemplateError as error:
        raise PorseError(
            f"expected the prompt {name} in {folder} to render with {', '.join(sorted(facts))}, found: {error!r}; mend the template"
        ) from error


def number(value: float) -> str:
    """Returns a number as prompts print it: four significant digits."""
    return f"{value:.4g}"


def numbers(values: Sequence[float]) -> list[str]:
    """Returns numbers as prompts print them."""
    return [number(value) for value in values]
