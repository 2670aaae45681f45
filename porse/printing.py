"""What people see on a terminal: every line that the program prints goes through here, its control characters written out."""

import shutil
import sys
import textwrap
import unicodedata

import click

_UNSEEN = ("Cc", "Cf", "Cs", "Zl", "Zp")
"""Kinds of characters that are no sign on a page: what a terminal obeys, what turns the direction of writing, breaks, half pairs."""


def visible(text: str, keep: str = "\n\t") -> str:
    """Returns the text with its control characters, and those that turn the direction of writing, written out.

    Args:
        text: whatever somebody wrote.
        keep: those that stay. A name that is to be on one line has none.
    """
    return "".join(
        _written(sign) if sign not in keep and unicodedata.category(sign) in _UNSEEN else sign for sign in text
    )


def _written(sign: str) -> str:
    number = ord(sign)
    return f"\\u{number:04x}" if number < 0x10000 else f"\\U{number:08x}"


def echo(text: str = "", err: bool = False, nl: bool = True) -> None:
    """Prints a text, visibly: no name and no reply in it can move the cursor, set a title or fill a clipboard.

    Args:
        text: its line breaks and tabs stay.
        err: to standard error.
        nl: whether a line break follows.
    """
    click.echo(visible(text), err=err, nl=nl)


def print_line(head: str, text: str, hang: int | None = None, err: bool = False) -> None:
    """Prints a line; on a terminal it is wrapped, and goes on below its text, or `hang` columns from the left."""
    # Before it is divided: what is written out divides nothing.
    line = visible(head + text)
    if (sys.stderr if err else sys.stdout).isatty():
        width = shutil.get_terminal_size().columns
        if hang is None:
            hang = len(head) if len(head) <= width // 2 else 8
        # What has several lines has them for a reason.
        line = "\n".join(
            textwrap.fill(
                part,
                width,
                subsequent_indent=" " * hang,
                break_long_words=False,
                break_on_hyphens=False,
                replace_whitespace=False,
            )
            for part in line.splitlines()
        )
    echo(line, err=err)


def counted(number: int, thing: str) -> str:
    """Returns a number of things in words: `1 epoch`, `2 epochs`."""
    return f"{number} {thing}{'' if number == 1 else 's'}"
