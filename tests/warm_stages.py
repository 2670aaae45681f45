"""Projects whose stages are run by a warm server, so that a tiny `dvc repro` takes seconds. For tests."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from porse.warm.client import VARIABLE
from porse.warm.start import warm_server

PYTHON = """#!/bin/sh
{variable}={address} exec {python} "$@"
"""


@contextmanager
def warm_stages(folder: Path) -> Iterator[Path]:
    """Gives a folder that serves as a project's `.venv` while the block runs: its `bin/python` asks the server."""
    with warm_server("portable") as environment:
        python = folder / "bin" / "python"
        python.parent.mkdir()
        python.write_text(PYTHON.format(variable=VARIABLE, address=environment[VARIABLE], python=sys.executable))
        python.chmod(0o755)
        yield folder
