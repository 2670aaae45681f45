"""Step evaluate: trains the winning lineage again with further seeds."""

import tempfile
from pathlib import Path

from porse import tables
from porse.config import Params
from porse.report.run import read_lineage
from porse.search.lengths import rung_epochs
from porse.training.evaluation import evaluate as evaluated


def evaluate(params: Params, run: Path, out: Path) -> str:
    """Writes the evaluation table of the run in the folder `run` to `out`; returns what to say about it."""
    chain = read_lineage(run, params)
    until = rung_epochs(params) * max(rung.until for rung in params.rungs)
    with tempfile.TemporaryDirectory() as scratch:
        rows = evaluated(chain, until, params, Path(scratch))
    tables.write(out / "evaluation.parquet", tables.EVALUATION, rows)
    return f"{len(chain)} links of the winning lineage, {params.evaluate.seeds} further seeds"
