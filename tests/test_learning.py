import csv
import json
import shutil

from click.testing import CliRunner

from porse import tables
from porse.report.learning import COLUMNS, main


def test_first_and_last_epochs_of_every_finished_run_are_compared(root, tmp_path):
    for entry, fitness in (("a", [0.0] * 10 + [9.0] + [2.0] * 9 + [4.0]), ("b", [1.0]), ("unfinished", [])):
        folder = tmp_path / "results" / entry
        (folder / "results").mkdir(parents=True)
        shutil.copy(root / "params.yaml", folder)
        metrics = {"epochs_spent": len(fitness), "environment_steps": 4096 * len(fitness), "mts": 9.0}
        (folder / "metrics.json").write_text(json.dumps(metrics))
        rows = [
            {"iteration": 1, "rung": "1", "candidate_id": "x", "series": "fitness", "epoch": epoch, "value": value}
            for epoch, value in enumerate(fitness, 1)
        ]
        tables.write(folder / "results" / "curves.parquet", tables.CURVES, rows)
        if fitness:
            (folder / "done.json").write_text("{}")
    done = CliRunner().invoke(main, [str(tmp_path / "results"), str(tmp_path / "out.csv")], catch_exceptions=False)
    assert done.exit_code == 0
    rows = list(csv.DictReader((tmp_path / "out.csv").read_text().splitlines()))
    assert [tuple(row) for row in rows] == [COLUMNS, COLUMNS]
    # The last ten are nine times 2 and once 4: 22 / 10.
    assert (rows[0]["first"], rows[0]["last"], rows[0]["mts"]) == ("0.0", "2.2", "9.0")
    assert (rows[0]["epochs"], rows[0]["environment_steps"]) == ("21", str(21 * 4096))
    assert (rows[1]["first"], rows[1]["last"]) == ("1.0", "1.0")
