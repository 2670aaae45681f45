"""Commands about the project itself: what there is, how it runs, and what came out."""

from pathlib import Path

import click

FOLDER = click.Path(file_okay=False, path_type=Path)
EXISTING = click.Path(exists=True, file_okay=False, path_type=Path)

with_params = click.option(
    "--params", "path", default="params.yaml", show_default=True, type=click.Path(dir_okay=False, path_type=Path)
)
"""Gives a command the file of parameters, as `path`."""
