"""Stage evaluate: trains the winning lineage again with further seeds."""

import tempfile
from pathlib import Path

import click

from porse import tables
from porse.report.run import read_lineage
from porse.search.lengths import rung_epochs
from porse.stage import StageCommand, begin, folder, run_stage, say, write_manifest


@click.command(cls=StageCommand)
@folder("run")
@folder("out")
def main(run: Path, out: Path) -> None:
    """Writes the evaluation table."""
    params = begin()
    write_manifest()
    from porse.training.evaluation import evaluate

    chain = read_lineage(run, params)
    until = rung_epochs(params) * max(rung.until for rung in params.rungs)
    with tempfile.TemporaryDirectory() as scratch:
        rows = evaluate(chain, until, params, Path(scratch))
    tables.write(out / "evaluation.parquet", tables.EVALUATION, rows)
    say(f"{len(chain)} links of the winning lineage, {params.evaluate.seeds} further seeds")


if __name__ == "__main__":
    run_stage(main)
