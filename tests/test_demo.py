"""`porse demo` as a user gives it: a run, a film and a report, without a model and without a network."""

import ctypes.util
import html
import math
import os
import re
import subprocess
from collections.abc import Iterable
from pathlib import Path

import pytest
import yaml

from first_ten_minutes import PAGE, PICTURES, outputs
from porse.cli import main
from porse.config import load_params, parse_params
from porse.demo import smoke
from porse.report.results import read_figures, winners_policy
from porse.search.lineage import episodes_seed
from porse.search.schedule import total_epochs
from porse.tasks import make_task
from porse.training.actor import policy_actor
from porse.training.episodes import play_episodes
from tiny import BIN, committed_params

HEADLESS = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "MUJOCO_GL")}
THRESHOLD = -9.0
"""Of the report alone: no result depends on it."""


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


@pytest.fixture(scope="module")
def demo(root, tmp_path_factory) -> tuple[Path, list[str]]:
    """Returns the folder of the demo of a file like the committed one, and what the command said."""
    folder = tmp_path_factory.mktemp("demo")
    document = committed_params()
    document["summarise"]["thresholds"]["Quadcopter"] = THRESHOLD
    (folder / "params.yaml").write_text(yaml.safe_dump(document))
    out = folder / "demo"
    done = subprocess.run(
        [BIN / "porse", "demo", "--out", out, "--params", folder / "params.yaml"],
        cwd=root, env=HEADLESS | {"PORSE_LLM_MODE": "record"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return out, done.stdout.splitlines()


def test_the_demo_leaves_a_run_and_a_report(root, demo):
    out, said = demo
    assert {"run", "results", "metrics.json", "params.yaml", "report.html"} <= {path.name for path in out.iterdir()}
    assert load_params(out / "params.yaml", root).summarise.thresholds["Quadcopter"] == THRESHOLD
    assert any("Final success in 32 episodes" in line for line in said)
    # No display: nothing is opened.
    assert not any("opened" in line for line in said)


@pytest.mark.skipif(
    not any(map(ctypes.util.find_library, ("EGL", "OSMesa"))),
    reason="needs EGL or OSMesa: install libegl1 or libosmesa6",
)
def test_the_demo_leaves_a_film(demo):
    out, _ = demo
    assert (out / "Quadcopter.gif").read_bytes().startswith(b"GIF89a")
    assert 'src="data:image/gif;base64,' in (out / "report.html").read_text()


def results(lines: Iterable[str]) -> list[str]:
    """Returns lines without what depends on the machine, and without the numbers of stages."""
    return [re.sub(r"[\d,]+ steps/s", "steps/s", re.sub(r"^\[\d+/24\] ", "", line)) for line in lines]


def of_stages(lines: Iterable[str]) -> list[str]:
    """Returns the results among the lines of `porse repro`; the first stage is none of the demo's."""
    return results(line for line in lines if re.match(r"\[(?!1/)\d+/24\] ", line))


def test_the_first_ten_minutes_show_what_the_demo_says(demo):
    out, said = demo
    shown = outputs(PAGE.read_text())
    wanted = results(line.replace(f"{out}/", "demo/") for line in said if ".gif" not in line)
    assert [line for line in results(shown["make demo"][1:]) if ".gif" not in line] == wanted
    # Lines of stages, an empty line, the table and the interval, an empty line, files.
    end = wanted.index("")
    assert shown["porse results demo"] == wanted[end + 1 : -2]
    repro, again, _ = (of_stages(lines) for command, lines in shown.items() if command.endswith("&& porse repro"))
    assert repro == wanted[:end]
    # `evaluate` and `summarise` run again: two lines of trainings, two of the evaluation, two of the iterations.
    assert again[:3] + again[4:] == wanted[end - 6 : end - 3] + wanted[end - 2 : end]


def test_the_first_ten_minutes_show_how_the_winner_does_in_48_episodes(root, demo):
    out, _ = demo
    params = load_params(out / "params.yaml", root)
    task = make_task(params.task, 48, episodes_seed(params))
    played = play_episodes(task, policy_actor(task, winners_policy(out, params), params.train))
    mean = math.fsum(episode.outcome for episode in played) / 48
    text, before = PAGE.read_text(), read_figures(out)["success"]
    assert f"the winner's mean action in 48 whole episodes: {mean:.3f}\n" in text
    # DVC rounds to five places.
    change = [str(round(value, 5)) for value in (before, mean, mean - before)]
    assert outputs(text)["dvc params diff && dvc metrics diff"][-1].split() == ["metrics.json", "success", *change]


@pytest.mark.parametrize("name", ["demo", "repro"])
def test_the_terminals_in_the_first_ten_minutes_show_what_the_demo_says(demo, name):
    _, said = demo
    drawn = re.findall(r"<text[^>]*>([^<]*)</text>", (PICTURES / f"{name}.svg").read_text())
    lines = results(html.unescape(text).replace("\xa0", " ") for text in drawn)
    shown = [
        line for line in lines if re.match(r"(iteration|evaluation,) .*(fitness|score|replies|wins|mutants)", line)
    ]
    assert len(shown) > 10
    assert {*shown} <= {*results(said)}
