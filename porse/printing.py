"""Lines for people: wrapped on a terminal, as they are elsewhere; and counts in words."""

import shutil
import sys
import textwrap

import click


def print_line(head: str, text: str, hang: int | None = None, err: bool = False) -> None:
    """Prints a line; on a terminal it is wrapped, and goes on below its text, or `hang` columns from the left."""
    line = head + text
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
    click.echo(line, err=err)


def counted(number: int, thing: str) -> str:
    """Returns a number of things in words: `1 epoch`, `2 epochs`."""
    return f"{number} {thing}{'' if number == 1 else 's'}"
