"""`porse experiments`: `dvc exp show` with as many columns as fit a terminal.

DVC shows every parameter of params.yaml and of every preset, some hundreds, and the hash of everything that a stage depends on.
"""

import subprocess
import sys
from collections.abc import Sequence

import click

_HASHES = (
    "inputs/", "iterations/", "llm_cache/", "run$", "run/", "evaluation$", "results$", "presets$", "prompts", "functions", "porse$",
    "stages$", r"requirements\.lock$", r"params\.yaml$",
)  # fmt: skip
"""Columns of what stages depend on. A parameter of a preset is `presets/NAME.yaml:...`."""
_SAID = ("task$", "method$", "seed$")
"""Parameters that metrics say, too."""
_LEFT_OUT = ("Created$", "Executor$", "epochs_spent$", "valid_share$")


def arguments() -> list[str]:
    """Returns what `dvc exp show` is told: what all rows have in common is left out, and what says little."""
    return ["--only-changed", "--drop", "|".join((*_HASHES, *_SAID, *_LEFT_OUT))]


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("more", nargs=-1, type=click.UNPROCESSED)
@click.option("--json", "as_json", is_flag=True, help="Print all that `dvc exp show --json` does.")
def experiments(more: Sequence[str], as_json: bool) -> None:
    """Print the experiments of `dvc exp run`: whose they are, their metrics, and the parameters in which they differ.

    This is `dvc exp show`, which gets MORE arguments as they are, `--sort-by mts` for one, without the columns that do not differ.
    """
    shown = ["--json"] if as_json else arguments()
    sys.exit(subprocess.run([sys.executable, "-m", "dvc", "exp", "show", *shown, *more]).returncode)
