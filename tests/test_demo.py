"""`porse demo` as a user gives it: a run, a film and a report, without a model and without a network."""

import ctypes.util
import os
import subprocess

import pytest
import yaml

from porse.cli import main
from porse.config import load_params, parse_params
from porse.demo import smoke
from porse.search.schedule import total_epochs
from tiny import BIN, committed_params

HEADLESS = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "MUJOCO_GL")}


def test_smoke_is_the_files_parameters_with_a_small_schedule():
    document = committed_params() | {"seed": 7}
    small = parse_params(smoke(document), "here")
    # Each iteration: 4 candidates for a rung of 8 epochs, 2 mutants for one, 2 survivors for one.
    assert total_epochs(small) == 2 * (4 + 2 + 2) * 8
    assert (small.seed, small.llm.on_miss, small.train.num_envs) == (7, "grammar", 128)
    # What a section has besides stays.
    assert small.llm.max_tokens == document["llm"]["max_tokens"]
    assert [entry.n for entry in small.iterations] == [1, 2]


def test_a_folder_with_a_run_in_it_is_left_alone(root, tmp_path, monkeypatch):
    from click.testing import CliRunner

    (tmp_path / "demo" / "run").mkdir(parents=True)
    monkeypatch.chdir(root)
    done = CliRunner().invoke(main, ["demo", "--out", str(tmp_path / "demo")])
    assert done.exit_code == 1
    assert "expected a folder without a run in it, found run in" in done.output
    assert not (tmp_path / "demo" / "params.yaml").exists()


@pytest.mark.skipif(
    not any(map(ctypes.util.find_library, ("EGL", "OSMesa"))),
    reason="needs EGL or OSMesa: install libegl1 or libosmesa6",
)
def test_the_demo_leaves_a_run_a_film_and_a_report(root, tmp_path):
    document = committed_params()
    document["train"] |= {"num_envs": 8, "steps_per_epoch": 4, "hidden": [8], "minibatches": 2}
    (tmp_path / "tiny.yaml").write_text(yaml.safe_dump(document))
    out = tmp_path / "demo"
    done = subprocess.run(
        [BIN / "porse", "demo", "--out", out, "--params", tmp_path / "tiny.yaml"],
        cwd=root, env=HEADLESS | {"PORSE_LLM_MODE": "record"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert {"run", "results", "metrics.json", "params.yaml", "report.html", "Quadcopter.gif"} <= {
        path.name for path in out.iterdir()
    }
    assert load_params(out / "params.yaml", root).train.num_envs == 8
    assert (out / "Quadcopter.gif").read_bytes().startswith(b"GIF89a")
    assert 'src="data:image/gif;base64,' in (out / "report.html").read_text()
    assert "Final success in 32 episodes" in done.stdout
    # No display: nothing is opened.
    assert "opened" not in done.stdout
