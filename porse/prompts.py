"""Prompt texts: the files of `prompts/` with facts filled in. A fact that is missing is an error, not a blank.

A template is text, and somebody else's may come with their prompts: it reaches the facts that it is given and the files
of its folder, and not Python's insides.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jinja2 import FileSystemLoader, StrictUndefined
from jinja2.sandbox import ImmutableSandboxedEnvironment

from porse.errors import PorseError


def render(folder: Path, name: str, **facts: Any) -> str:
    """Returns the text of `folder/name.jinja` with `facts` filled in, without blank space at its ends.

    Raises:
        PorseError: the template is missing or wrong, wants a fact that is not given, or reaches for more than facts.
    """
    # Prompts are text for a model, not HTML: escaping would change the code in them.
    environment = ImmutableSandboxedEnvironment(
        loader=FileSystemLoader(folder), undefined=StrictUndefined, autoescape=False, keep_trailing_newline=False
    )
    try:
        return environment.get_template(f"{name}.jinja").render(**facts).strip()
    except Exception as error:  # a template may compute, and what it computes may go wrong in every way
        raise PorseError(
            f"expected the prompt {name} in {folder} to render with {', '.join(sorted(facts))}, found: {error!r}; correct the template"
        ) from error


def number(value: float) -> str:
    """Returns a number as prompts print it: four significant digits."""
    return f"{value:.4g}"


def numbers(values: Sequence[float]) -> list[str]:
    """Returns numbers as prompts print them."""
    return [number(value) for value in values]
