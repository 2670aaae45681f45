"""Progress looks on: what a bar says, what the plan knows, and where a pipeline is."""

import dataclasses
import json
import os
import re
import subprocess
import sys

import pytest
from click.testing import CliRunner

from porse import status as status_module
from porse.cli import main
from porse.config import load_document
from porse.inputs.resolve import resolve_inputs
from porse.plan import planned, write_plan
from porse.search.schedule import total_epochs
from porse.stage import say
from porse.training.bar import RungBar, in_words
from porse.training.job import Ended, Outcome, Report
from terminal import on_a_terminal


@pytest.fixture(autouse=True)
def _plain(monkeypatch):
    for name in ("PORSE_PROGRESS", "PORSE_PLAN", "PORSE_TENSORBOARD"):
        monkeypatch.delenv(name, raising=False)


def shown(events, label="iteration 2 rung 1"):
    with RungBar(label, 2, 6, 100) as bar:
        for event in events:
            bar.tell(event)


FALLING = [Report("a", 1, -0.5), Report("b", 1, -0.2), Report("a", 2, -0.9), Report("b", 2, -0.7)]


def test_without_a_terminal_a_rung_is_one_line_and_the_best_fitness_never_falls(capsys):
    shown(FALLING)
    [line] = capsys.readouterr().out.splitlines()
    assert line.startswith("iteration 2 rung 1: 2 candidates, 4 epochs, ")
    assert line.endswith("steps/s, best fitness -0.200")


def test_the_quiet_mode_says_what_fails_alone(capsys, monkeypatch):
    monkeypatch.setenv("PORSE_PROGRESS", "quiet")
    shown([*FALLING, Ended("a", Outcome([], "not finite"))])
    assert capsys.readouterr().out == "iteration 2 rung 1: a failed: not finite\n"


def test_the_json_mode_says_stage_and_time_left(capsys, monkeypatch, params, tmp_path):
    write_plan(tmp_path / "plan.json", params)
    monkeypatch.setenv("PORSE_PLAN", str(tmp_path / "plan.json"))
    monkeypatch.setenv("PORSE_PROGRESS", "json")
    shown([*FALLING, Ended("a", Outcome([], "not finite"))])
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [row["event"] for row in rows] == ["rung", "epoch", "epoch", "epoch", "epoch", "failed", "done"]
    assert [row["best_fitness"] for row in rows[:5]] == [None, -0.5, -0.2, -0.2, -0.2]
    # resolve, begin; 18 stages in each iteration: generate, validate-code, 7 rungs of 2, mutate, fuse; then 2 and the third.
    assert (rows[0]["stage"], rows[0]["stages"]) == (2 + 18 + 3, 2 + 5 * 18 + 2)
    assert rows[0]["seconds_left"] is None
    assert rows[-1]["seconds_left"] > 0


@pytest.mark.parametrize(
    ("mode", "line"),
    [
        ("", "[20/94] 6 of 6 survive\n"),
        ("auto", "[20/94] 6 of 6 survive\n"),
        ("quiet", ""),
        ("json", '{"event": "stage", "stage": 20, "stages": 94, "said": "6 of 6 survive"}\n'),
    ],
)
def test_a_stage_says_a_line_with_its_number_as_the_mode_wants_it(mode, line, capsys, monkeypatch, params, tmp_path):
    monkeypatch.setenv("PORSE_PROGRESS", mode)
    monkeypatch.setenv("DVC_STAGE", "iterations/1/dvc.yaml:fuse")
    say("6 of 6 survive")
    assert ("[" in capsys.readouterr().out) is False
    # resolve, begin, and the 18 of iteration 1, of which fuse is the last.
    write_plan(tmp_path / "plan.json", params)
    monkeypatch.setenv("PORSE_PLAN", str(tmp_path / "plan.json"))
    say("6 of 6 survive")
    assert capsys.readouterr().out == line


def test_stage_begin_says_a_line_with_its_number(params, root, tmp_path):
    """The stage itself, in a folder that has the project's files."""
    for name in ("porse", "stages", "requirements.lock"):
        (tmp_path / name).symlink_to(root / name)
    document = load_document(root / "params.yaml")
    (tmp_path / "begin.json").write_text(resolve_inputs(root, document, "params.yaml")["begin"].render())
    write_plan(tmp_path / "plan.json", params)
    done = subprocess.run(
        [sys.executable, "-m", "stages.begin", "--inputs", "begin.json", "--out", "start"],
        cwd=tmp_path, env=os.environ | {"PORSE_PLAN": "plan.json", "DVC_STAGE": "begin"}, capture_output=True, text=True,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "[2/94] iteration 1: no winner yet, a random policy\n"), done.stderr
    assert (tmp_path / "start" / "winner.parquet").is_file()


RUNG_ON_A_TERMINAL = """
import sys
from porse.training.bar import RungBar
from porse.training.job import Report
label, *names = sys.argv[1:]
with RungBar(label, 2, 6, 100) as bar:
    for epoch, fitness in enumerate((-10.5, -110.25), 1):
        for name in names:
            bar.tell(Report(name, epoch, fitness))
    bar._bars._progress.refresh()
"""


@pytest.mark.parametrize(
    ("label", "names"),
    [
        ("iteration 2 rung mutants", ("0123456789ab", "ba9876543210")),
        ("evaluation, iteration 2", ("0123456789ab seed 1", "0123456789ab seed 2")),
    ],
)
@pytest.mark.parametrize("rows", [24, 6])
def test_on_a_terminal_of_80_columns_nothing_is_cut(rows, label, names, params, tmp_path):
    """A real terminal. Of six rows, the candidates get none."""
    write_plan(tmp_path / "plan.json", params)
    environment = os.environ | {"PORSE_PLAN": str(tmp_path / "plan.json"), "TERM": "xterm-256color"}
    code, pieces = on_a_terminal([sys.executable, "-c", RUNG_ON_A_TERMINAL, label, *names], rows, 80, environment)
    written = b"".join(pieces)
    assert code == 0, written
    lines = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", written.decode()).replace("\r", "\n").splitlines()
    assert max(len(line) for line in lines if "━" in line) <= 80
    text = "\n".join(re.sub("[━╸╺ ]+", " ", line).strip() for line in lines)
    # Two epochs of each of both.
    assert re.search(rf"^{label} 4/6 [\d,]+ steps/s, best fitness -10.500$", text, re.MULTILINE)
    # The evaluation is 2 seeds x 5 links x 96 epochs.
    whole = total_epochs(params) + 2 * 5 * 96
    assert re.search(rf"^stage \d+ of 94 \d+/{whole} .* left over all$", text, re.MULTILINE)
    assert (f"{names[0]} 2/3 best fitness -10.500" in text) == (rows == 24)
    # The bars go, and a line stays.
    assert re.search(rf"\] {label}: 2 candidates, 4 epochs, ", text)


def test_the_plan_has_all_stages_in_order_and_the_epochs_after_each(params, root, tmp_path):
    import yaml

    stages = planned(params)
    files = {
        "": root / "dvc.yaml",
        **{f"iterations/{n}/dvc.yaml:": root / f"iterations/{n}/dvc.yaml" for n in range(1, 6)},
    }
    found = {
        f"{where}{name}": stage
        for where, path in files.items()
        for name, stage in yaml.safe_load(path.read_text())["stages"].items()
    }
    assert sorted(stage.name for stage in stages) == sorted(found)
    made: set[str] = set()
    to_come = {path for stage in found.values() for path in stage["outs"] if isinstance(path, str)}
    for stage in stages:
        assert not (set(found[stage.name]["deps"]) & to_come) - made, stage.name
        made |= {path for path in found[stage.name]["outs"] if isinstance(path, str)}
    assert len(made) > 90
    # The evaluation trains 2 seeds of each of 5 links for 6 x 16 epochs.
    assert {stage.name: stage.epochs for stage in stages}["evaluate"] == 2 * 5 * 96
    assert sum(stage.epochs for stage in stages) == total_epochs(params) + 2 * 5 * 96
    rungs = planned_bars(params, tmp_path)
    # Rung 1 of iteration 1 trains 6 candidates for 16 epochs; the evaluation alone is trained after the last rung.
    assert rungs["iteration 1 rung 1"]["epochs_after"] == total_epochs(params) - 6 * 16 + 2 * 5 * 96
    assert rungs["iteration 5 rung 6"]["epochs_after"] == 2 * 5 * 96


def planned_bars(params, tmp_path):
    write_plan(tmp_path / "plan.json", params)
    return json.loads((tmp_path / "plan.json").read_text())["bars"]


def test_each_link_of_the_evaluation_is_in_the_plan_with_what_comes_after_it(params, tmp_path):
    three = dataclasses.replace(params, evaluate=dataclasses.replace(params.evaluate, seeds=3))
    rungs = planned_bars(three, tmp_path)
    found = {label: rung for label, rung in rungs.items() if "evaluation" in label}
    # 3 seeds x 96 epochs a link; evaluate is the last stage but one of 94.
    assert found == {f"evaluation, iteration {n}": {"stage": 93, "epochs_after": (5 - n) * 3 * 96} for n in range(1, 6)}


def test_where_nothing_is_fused_one_link_is_evaluated_whichever_iteration_it_is_of(params, tmp_path):
    alone = dataclasses.replace(params, fuse=dataclasses.replace(params.fuse, policy="random"))
    rungs = planned_bars(alone, tmp_path)
    assert [rungs[f"evaluation, iteration {n}"]["epochs_after"] for n in range(1, 6)] == [0] * 5
    assert rungs["iteration 5 rung 6"]["epochs_after"] == 2 * 96


def test_a_bar_of_the_evaluation_has_its_stage_and_the_time_left_over_all(capsys, monkeypatch, params, tmp_path):
    write_plan(tmp_path / "plan.json", params)
    monkeypatch.setenv("PORSE_PLAN", str(tmp_path / "plan.json"))
    shown(FALLING, "evaluation, iteration 4")
    assert capsys.readouterr().out.startswith("[93/94] evaluation, iteration 4: 2 candidates, 4 epochs, ")
    monkeypatch.setenv("PORSE_PROGRESS", "json")
    shown(FALLING, "evaluation, iteration 4")
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (last["stage"], last["stages"], last["seconds_left"] is not None) == (93, 94, True)


@pytest.mark.parametrize(("seconds", "words"), [(9.6, "10 s"), (95, "2 min"), (7500, "2 h 5 min")])
def test_a_time_is_said_in_words(seconds, words):
    assert in_words(seconds) == words


def test_event_files_hold_every_value_as_it_is(monkeypatch, tmp_path):
    monkeypatch.setenv("PORSE_TENSORBOARD", str(tmp_path))
    value = 0.1 + 2**-40
    shown([Ended("a", Outcome([(1, "fitness", -1.5), (2, "fitness", value)], ""))])
    from tensorboard.backend.event_processing.event_file_loader import LegacyEventFileLoader

    [file] = (tmp_path / "iteration-2-rung-1" / "a").iterdir()
    found = [
        (event.step, item.tag, item.tensor.double_val[0])
        for event in LegacyEventFileLoader(str(file)).Load()
        for item in event.summary.value
    ]
    assert found == [(1, "fitness", -1.5), (2, "fitness", value)]


@pytest.fixture
def pipeline(tmp_path, monkeypatch, root, params):
    """A project with an input, and locks of the first three stages of which the third read another input."""
    import yaml

    from porse.inputs.resolve import Inputs

    (tmp_path / "dvc.yaml").touch()
    (tmp_path / "params.yaml").write_text((root / "params.yaml").read_text())
    (tmp_path / "presets").symlink_to(root / "presets")
    inputs = {name: Inputs({"name": name}, {}) for name in ("begin", "generate", "validate-code")}
    monkeypatch.setattr(status_module, "resolve_inputs", lambda *_: inputs)
    monkeypatch.chdir(tmp_path)

    def lock(name, path, deps, out):
        path.parent.mkdir(parents=True, exist_ok=True)
        document = yaml.safe_load(path.read_text()) if path.exists() else {"stages": {}}
        document["stages"][name] = {
            "deps": [{"path": dep, "md5": md5} for dep, md5 in deps.items()],
            "outs": [{"path": out[0], "md5": out[1]}],
        }
        path.write_text(yaml.safe_dump(document))
        (tmp_path / out[0]).mkdir(parents=True, exist_ok=True)

    import hashlib

    (tmp_path / "inputs").mkdir()
    md5s = {}
    for name, own in inputs.items():
        (tmp_path / "inputs" / f"{name}.json").write_text(own.render())
        md5s[name] = hashlib.md5(own.render().encode()).hexdigest()
    first = tmp_path / "iterations" / "1" / "dvc.lock"
    lock("begin", tmp_path / "dvc.lock", {"inputs/begin.json": md5s["begin"]}, ("run/1/start", "s"))
    lock("generate", first, {"inputs/generate.json": md5s["generate"], "run/1/start": "s"}, ("run/1/generate", "g"))
    lock("validate-code", first, {"run/1/generate": "another"}, ("run/1/validate-code", "v"))
    return tmp_path


def told():
    done = CliRunner().invoke(main, ["status", "--json"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return json.loads(done.output)


def test_a_stage_is_done_where_its_lock_names_what_is_there_now(pipeline):
    found = told()
    assert (found["state"], found["done"], found["stages"]) == ("stopped", 3, 94)
    assert found["next"] == "iterations/1/dvc.yaml:validate-code"
    assert (found["epochs_done"], found["epochs"]) == (0, 5 * 36 * 16)
    assert "`porse repro` goes on" in found["how_on"]


def test_an_output_that_is_gone_is_not_done(pipeline):
    (pipeline / "run" / "1" / "generate").rmdir()
    assert told()["next"] == "iterations/1/dvc.yaml:generate"


def test_before_the_first_stage_nothing_is_started_and_while_dvc_works_it_runs(pipeline, monkeypatch):
    (pipeline / "inputs" / "begin.json").unlink()
    assert told()["state"] == "not started"
    monkeypatch.setattr(status_module, "at_work", lambda root: True)
    said = CliRunner().invoke(main, ["status"]).output.splitlines()
    assert said[:2] == ["running: 0 of 94 stages, 0 of 2880 epochs", "at work: resolve"]
