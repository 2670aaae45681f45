"""Paths, lengths and places that a command cannot work with are refused before any work, in one sentence."""

import dataclasses
import hashlib
import json
import os
import shutil

import click
import pytest
import yaml
from click.testing import CliRunner

from porse import renderer, show
from porse.cli import main
from porse.errors import PorseError
from porse.inputs.resolve import resolve_inputs
from porse.outdated import another_run, changed_parameters
from porse.paths import at_root, check_target, project_root
from porse.repro import reproduce
from porse.training import memory
from porse.training.memory import check_memory, training_mib
from tiny import BIN, ROOT, committed_params, make_project, run


def porse(*words):
    return CliRunner().invoke(main, list(words), catch_exceptions=False)


@pytest.fixture(autouse=True)
def _nothing_is_drawn(monkeypatch):
    def refuse():
        raise AssertionError("the renderer was chosen before the input was checked")

    monkeypatch.setattr(show, "choose_renderer", refuse)


@pytest.mark.parametrize("value", ["nan", "inf", "-1", "0", "86401"])
@pytest.mark.parametrize("command", [["render", "Pen", "--out", "a.gif"], ["play", "Pen", "--out", "a.gif"]], ids=str)
def test_a_length_that_is_none_is_refused(command, value):
    done = porse(*command, "--seconds", value)
    assert done.exit_code == 2
    assert "expected more than 0 and at most 86400 seconds" in done.output


@pytest.mark.parametrize(
    "words", [("render", "--out", "a.png"), ("play",), ("check-code", "--reward", "a.py")], ids=lambda words: words[0]
)
def test_a_task_that_is_none_is_refused_with_the_nearest_names(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.py").touch()
    done = porse(words[0], "quadcoptre", *words[1:])
    assert (done.exit_code, done.output) == (
        1,
        "Error: expected task to be a name of `porse tasks` or module:Class, found 'quadcoptre' in the argument TASK; the "
        "nearest names are Quadcopter\n",
    )


def test_a_film_that_would_fill_the_memory_is_refused():
    done = porse("render", "Pen", "--out", "a.gif", "--seconds", "121")
    assert done.output == "Error: expected a film of at most 120 seconds, found --seconds 121; write a shorter one\n"


def test_the_suffix_of_a_film_is_checked_before_it_is_drawn():
    done = porse("play", "Pen", "--out", "a.webm")
    assert done.output == "Error: expected --out to end in .gif or .mp4, found a.webm; choose one of them\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--width", "481"], "expected an even number of pixels"),
        (["--height", "5000"], "5000 is not in the range"),
        (["--camera", "1,2,3"], "expected X,Y,Z,DISTANCE,AZIMUTH,ELEVATION"),
        (["--camera", "0,0,0,0,90,-10"], "a distance above 0"),
        (["--camera", "0,0,nan,1,90,-10"], "six numbers"),
        (["--seconds", "120", "--width", "3840", "--height", "2160"], "expected frames of at most 4096 MiB in memory"),
    ],
    ids=str,
)
def test_how_a_film_is_taken_is_checked_before_it_is_drawn(words, said):
    done = porse("play", "Pen", "--out", "a.mp4", *words)
    assert done.exit_code != 0
    assert said in done.output


def test_a_target_is_checked_before_any_work(tmp_path):
    check_target(tmp_path / "a.PNG", (".png", ".gif"))
    (tmp_path / "file").touch()
    (tmp_path / "folder.gif").mkdir()
    for path, words in (
        (tmp_path / "none" / "a.gif", "expected the folder .*none for --out .*, found none; make it first"),
        (tmp_path / "file" / "a.gif", "found a file there"),
        (tmp_path / "folder.gif", "found a folder; name a file in it"),
        (tmp_path / "a.jpg", r"expected --out to end in .png or .gif"),
    ):
        with pytest.raises(PorseError, match=words):
            check_target(path, (".png", ".gif"))


def test_a_read_only_target_is_refused(tmp_path, monkeypatch):
    # Root may write everywhere: what the system says of others is said here.
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK)
    with pytest.raises(PorseError, match="found it read-only; name a place of your own with --out"):
        check_target(tmp_path / "a.gif", (".gif",))


def test_a_file_where_a_folder_belongs_ends_in_a_sentence(tmp_path):
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(committed_params()))
    (tmp_path / "results").touch()
    done = porse("results", str(tmp_path))
    assert done.exit_code == 1
    assert f"at {tmp_path / 'results' / 'iterations.parquet'}, found no such file" in done.output


def run_of(folder, parameters):
    """Leaves what a run of these parameters does: an input of one stage in DVC's cache, and a lock that names it."""
    content = json.dumps({"parameters": parameters, "files": {}}).encode()
    digest = hashlib.md5(content, usedforsecurity=False).hexdigest()
    cached = folder / ".dvc" / "cache" / "files" / "md5" / digest[:2] / digest[2:]
    cached.parent.mkdir(parents=True)
    cached.write_bytes(content)
    lock = {"stages": {"summarise": {"cmd": "", "deps": [{"path": "inputs/summarise.json", "md5": digest}]}}}
    (folder / "dvc.lock").write_text(yaml.safe_dump(lock))
    return cached


def test_results_of_another_task_say_so(root, tmp_path):
    (tmp_path / "presets").symlink_to(root / "presets")
    document = committed_params()
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(document))
    cached = run_of(tmp_path, {"task": "Quadcopter", "seed": 1})
    assert another_run(tmp_path) is None
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(document | {"task": "Over", "seed": 7}))
    assert changed_parameters(tmp_path) == {"task": ("Quadcopter", "Over"), "seed": (1, 7)}
    said = another_run(tmp_path)
    assert said is not None
    assert said.startswith(
        'these results are another run\'s: expected task: "Over", seed: 7, as params.yaml says, found'
    )
    assert 'results of task: "Quadcopter", seed: 1; run `porse repro`' in said
    assert "warning: these results are another run's" in porse("results", str(tmp_path)).stderr
    assert "warning: these results are another run's" in porse("trends", str(tmp_path)).stderr
    # Without the inputs of the run, nothing is known.
    content = cached.read_bytes()
    cached.unlink()
    assert another_run(tmp_path) is None
    cached.write_bytes(content)
    # A suite keeps no presets, and `porse demo` no lock.
    (tmp_path / "presets").unlink()
    assert another_run(tmp_path) == said
    (tmp_path / "dvc.lock").unlink()
    assert "warning" not in porse("results", str(tmp_path)).stderr


def test_parameters_that_cannot_be_read_are_said_once(tmp_path):
    (tmp_path / "params.yaml").write_text("task: [")
    (tmp_path / "dvc.lock").touch()
    done = porse("results", str(tmp_path))
    assert (done.exit_code, done.output.count("expected YAML in"), "warning" in done.output) == (1, 1, False)


def test_a_source_archive_without_git_says_what_to_do(tmp_path):
    (tmp_path / "dvc.yaml").touch()
    with pytest.raises(PorseError, match="unpacked source archive; take a clone, or run: git init"):
        reproduce(tmp_path, (), print)


def test_a_display_that_does_not_answer_is_none(monkeypatch):
    monkeypatch.setattr(renderer.sys, "platform", "linux")
    monkeypatch.setenv("DISPLAY", ":4093")
    assert not renderer.has_display()
    monkeypatch.delenv("DISPLAY")
    assert not renderer.has_display()


@click.command()
@click.argument("paths", nargs=-1, type=click.Path())
@click.option("--params", default="params.yaml", type=click.Path())
@click.option("--word", default="")
def told(paths, params, word):
    """Prints what it was given, and where it ran."""
    click.echo(json.dumps([list(paths), params, word, os.getcwd()]))


def test_a_command_below_the_project_runs_at_its_root_with_the_paths_that_were_typed(tmp_path, monkeypatch):
    below = tmp_path / "a" / "b"
    below.mkdir(parents=True)
    monkeypatch.chdir(below)

    def run(*words):
        done = CliRunner().invoke(at_root(told), list(words), catch_exceptions=False)
        return json.loads(done.output)

    assert project_root(below) is None
    assert run("x", "--word", "y") == [["x"], "params.yaml", "y", str(below)]
    (tmp_path / "dvc.yaml").touch()
    (tmp_path / "params.yaml").touch()
    # An iteration's folder has a dvc.yaml, too.
    (tmp_path / "a" / "dvc.yaml").touch()
    assert project_root(below) == tmp_path
    assert run("x", "/y", "-", "--word", "y") == [[f"{below}/x", "/y", "-"], "params.yaml", "y", str(tmp_path)]
    assert run("--params", "own.yaml")[1] == f"{below}/own.yaml"
    assert os.getcwd() == str(below)
    # Somebody else's parameters beside the user are meant.
    (below / "params.yaml").touch()
    assert run("x")[3] == str(below)


# Memory.


def test_the_memory_of_a_training_is_estimated_from_its_sizes(params):
    train = dataclasses.replace(params.train, num_envs=1024, steps_per_epoch=8, minibatches=2, hidden=(32, 16))
    # 8192 steps: each 4 bytes x (2 x 5 observations + 3 x 3 actions + 8) = 108, 884 736 bytes in all.
    # A batch of 4096 steps: 4 bytes x 2 networks x (5 + 3 x 48) = 1192 each, 4 882 432 bytes.
    # 1024 environments: 6144 + 64 x 5 = 6464 bytes each, 6 619 136. Together 12 386 304 bytes: 11.8 MiB.
    assert training_mib(train, 5, 3) == 11


def test_each_number_of_the_estimate_counts(params):
    sizes = {"num_envs": 2**19, "steps_per_epoch": 2, "minibatches": 3, "hidden": (48, 24)}
    train = dataclasses.replace(params.train, **sizes)
    # 2^20 steps: 4 x (2 x 37 + 3 x 5 + 8) bytes each, 388 MiB. A batch of 349 525: 4 x 2 x (37 + 3 x 72) bytes each,
    # 674.67 MiB. Environments: half of 6144 + 64 x 37, 4256 MiB. Together 5318.67.
    assert training_mib(train, 37, 5) == 5318


def test_what_just_fits_is_not_refused_and_a_mebibyte_more_is(params, monkeypatch):
    wide = dataclasses.replace(params, train=dataclasses.replace(params.train, num_envs=65536))
    # 131 073 environments of 6144 + 64 x 21 bytes: 936.007 MiB.
    many = dataclasses.replace(params, evaluate=dataclasses.replace(params.evaluate, episodes=131073))
    for found, needed, words in ((wide, training_mib(wide.train, 21, 12), "a training"), (many, 936, "evaluate")):
        monkeypatch.setenv("PORSE_MEMORY_MIB", str(needed))
        check_memory(found)
        monkeypatch.setenv("PORSE_MEMORY_MIB", str(needed - 1))
        with pytest.raises(PorseError, match=f"expected memory for {words}"):
            check_memory(found)


def test_the_estimate_is_near_what_trainings_were_measured_to_fill(params):
    train = dataclasses.replace(params.train, num_envs=16384, steps_per_epoch=16, minibatches=4, hidden=(64, 64))
    assert training_mib(train, 21, 12) == pytest.approx(435, rel=0.25)
    train = dataclasses.replace(train, num_envs=2048, hidden=(256, 256, 128))
    assert training_mib(train, 398, 40) == pytest.approx(408, rel=0.25)


def test_no_task_of_the_package_is_wider_than_the_widest():
    widths = [(row["observations"], row["actions"]) for row in json.loads(porse("tasks", "--json").output)]
    assert max(width for width, _ in widths) <= memory._WIDEST[0]
    assert max(width for _, width in widths) <= memory._WIDEST[1]


def test_a_training_that_may_take_its_memory_is_not_refused(params, monkeypatch):
    monkeypatch.setenv("PORSE_MEMORY_MIB", "64")
    check_memory(params)


ABSURD = {"num_envs": 131072, "steps_per_epoch": 32, "minibatches": 1}


def test_an_absurd_number_of_environments_is_refused_before_anything_starts(tmp_path, root):
    document = committed_params() | {"generator": "grammar"}
    document["train"] |= ABSURD
    project = make_project(tmp_path / "project", document, BIN.parent)
    for words in (["run", "--out", "out"], ["repro"], ["repro", "resolve"], ["demo", "--no-open"]):
        done = run(project, str(BIN / "porse"), *words, check=False, PYTHONPATH=str(root), PORSE_MEMORY_MIB="4096")
        assert done.returncode == 1
        assert "expected memory for a training of Quadcopter with train.num_envs = 131072" in done.stderr
        assert "found 4096 MiB that one may take; lower one of the two" in done.stderr
        assert "Traceback" not in done.stderr
    assert not any((project / name).exists() for name in ("inputs", "run", "out", "demo"))


def test_episodes_that_do_not_fit_into_memory_are_refused(params, monkeypatch):
    monkeypatch.setenv("PORSE_MEMORY_MIB", "500")
    many = dataclasses.replace(params, evaluate=dataclasses.replace(params.evaluate, episodes=131072))
    with pytest.raises(PorseError, match=r"expected memory for evaluate\.episodes = 131072 environments of Quadcopter"):
        check_memory(many)


def test_dvc_repro_says_what_is_wrong_with_a_method_or_with_memory_before_any_other_stage(tmp_path, root):
    project = make_project(tmp_path / "project", committed_params() | {"generator": "grammar"}, BIN.parent)
    text = (project / "params.yaml").read_text()
    (project / "params.yaml").write_text(text.replace("method: porse", "method: eurika"))
    asked = [str(BIN / "dvc"), "repro"], [str(BIN / "porse"), "repro"]
    for command in asked:
        done = run(project, *command, check=False, PYTHONPATH=str(root))
        assert done.returncode != 0
        assert "found 'eurika' in params.yaml; did you mean eureka?" in done.stderr
        assert "interpol" not in done.stderr
    document = committed_params() | {"generator": "grammar"}
    document["train"] |= ABSURD
    (project / "params.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
    done = run(project, *asked[0], check=False, PYTHONPATH=str(root), PORSE_MEMORY_MIB="4096")
    assert "expected memory for a training of Quadcopter" in done.stderr
    assert not (project / "run").exists()


# The environment, and places.


@pytest.mark.parametrize(
    ("variable", "value", "said"),
    [
        ("PORSE_PROGRESS", "loud", "to be one of auto, quiet, json, found 'loud' in the environment"),
        ("PORSE_EXECUTOR", "cloud", "to be local, inline or ray, found 'cloud' in the environment"),
        ("PORSE_WORKERS", "0", "to be a whole number from 1 to 999999999, found '0'"),
        ("PORSE_TENSORBOARD", "params.yaml/events", "where params.yaml is a file; set or unset it"),
    ],
)
@pytest.mark.parametrize("words", [("run", "--out", "out"), ("repro", "resolve")], ids=str)
def test_a_variable_that_says_nothing_is_refused_before_anything_starts(
    variable, value, said, words, tmp_path, root, monkeypatch
):
    monkeypatch.chdir(root)
    monkeypatch.setenv(variable, value)
    words = tuple(str(tmp_path / "out") if word == "out" else word for word in words)
    done = porse(*words)
    assert done.exit_code == 1
    assert f"expected {variable} " in done.output
    assert said in done.output
    assert not (tmp_path / "out").exists()


def test_a_python_that_is_none_is_said_in_a_sentence(tmp_path, root):
    project = make_project(tmp_path / "project", committed_params(), BIN.parent)
    done = run(project, str(BIN / "dvc"), "repro", "resolve", check=False, PORSE_PYTHON="/nowhere/python")
    assert (
        "Error: expected PORSE_PYTHON to name a Python, found /nowhere/python; set it to one, or unset it"
        in done.stderr
    )


def test_folders_that_are_not_there_are_refused(root, tmp_path, monkeypatch):
    monkeypatch.chdir(root)
    done = porse("run", "--out", str(tmp_path / "out"), "--prompts", "nowhere")
    assert done.exit_code == 2
    assert "Directory 'nowhere' does not exist" in done.output
    done = porse("llm", "stats", "--cache", "nowhere")
    assert done.exit_code == 1
    assert "Expected a directory of recorded replies in nowhere, found none." in done.output
    (tmp_path / "answers").mkdir()
    done = porse("llm", "import", str(tmp_path / "answers"), "--answered-by", "somebody", "--context", "fresh",
                 "--cache", str(tmp_path / "cache"))  # fmt: skip
    assert done.exit_code == 1
    assert f"Expected texts named <key>.md or <key>.txt in the directory {tmp_path / 'answers'}" in done.output


@pytest.mark.parametrize(
    "text", ["- a\n", "a\n", "stages: 3\n", "stages: {begin: 3}\n", "stages: {begin: {deps: [run]}}\n"]
)
def test_a_lock_that_is_no_lock_ends_in_a_sentence(root, tmp_path, monkeypatch, text):
    for name in (
        "porse",
        "stages",
        "prompts",
        "presets",
        "functions",
        "params.yaml",
        "dvc.yaml",
        "requirements.lock",
        "llm_cache",
    ):
        (tmp_path / name).symlink_to(root / name)
    (tmp_path / "iterations" / "1").mkdir(parents=True)
    (tmp_path / "dvc.lock").touch()
    (tmp_path / "iterations" / "1" / "dvc.lock").write_text(text)
    monkeypatch.chdir(tmp_path)
    for command in ("status", "results", "trends"):
        done = porse(command)
        assert done.exit_code == 1
        assert "expected in iterations/1/dvc.lock the entries of stages with the paths and hashes" in done.output
        assert "; run `porse repro`, which mends it" in done.output


def test_results_of_a_fresh_clone_say_that_they_are_another_tasks(root, tmp_path):
    clone = tmp_path / "clone"
    clone.mkdir()
    for name in ("porse", "stages", "prompts", "presets", "functions", "iterations"):
        shutil.copytree(root / name, clone / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("params.yaml", "dvc.yaml", "metrics.json", "requirements.lock"):
        shutil.copy(root / name, clone / name)
    (clone / "llm_cache").mkdir()
    shutil.copy(root / "llm_cache" / "refreshed.txt", clone / "llm_cache")
    # The lock of a run of these files: what was computed from the committed parameters.
    document = committed_params()
    digest = hashlib.md5(
        resolve_inputs(clone, document, "params.yaml")["summarise"].render().encode(), usedforsecurity=False
    ).hexdigest()
    lock = {"stages": {"summarise": {"cmd": "", "deps": [{"path": "inputs/summarise.json", "md5": digest}]}}}
    (clone / "dvc.lock").write_text(yaml.safe_dump(lock))
    for words in (
        ["init", "-q"],
        ["add", "."],
        ["-c", "user.name=a", "-c", "user.email=a@b", "commit", "-qm", "start"],
    ):
        run(clone, "git", *words)
    # The tables are not in Git: all that there is to say is where they come from.
    said = run(clone, str(BIN / "porse"), "results", check=False, PYTHONPATH=str(clone)).stderr
    assert "another run" not in said
    assert "results/iterations.parquet, found no such file; run `porse repro` to make it" in said
    text = (clone / "params.yaml").read_text()
    (clone / "params.yaml").write_text(text.replace("task: Quadcopter", "task: Over"))
    done = run(clone, str(BIN / "porse"), "results", check=False, PYTHONPATH=str(clone))
    assert 'these results are another run\'s: expected task: "Over"' in done.stderr
    assert 'found results of task: "Quadcopter"' in done.stderr


FAILS = "stages:\n  one:\n    cmd: echo Error, said the stage >&2 && exit 3\n"
STOPPED = "stopped by the error above: correct it, and run `porse repro` again, and it goes on from there\n"


@pytest.mark.parametrize(
    ("pipeline", "said"),
    [
        # What a stage says is enough.
        (FAILS, "Error, said the stage\n"),
        (
            "stages: {one: {cmd: echo, deps: [gone]}}",
            "ERROR: failed to reproduce 'one': dependency 'gone' does not exist\n",
        ),
        (
            "stages: {one: {cmd: echo, dep: []}}",
            "'./dvc.yaml' validation failed.\n\nextra keys not allowed, in stages -> one -> dep, line 1, column 32\n"
            "  1 stages: {one: {cmd: echo, dep: []}}",
        ),
    ],
    ids=["stage", "dependency", "schema"],
)
def test_the_error_of_a_stage_or_of_dvc_is_all_that_repro_prints(tmp_path, pipeline, said):
    project = make_project(tmp_path / "project", committed_params(), BIN.parent)
    (project / "dvc.yaml").write_text(pipeline)
    done = run(project, str(BIN / "porse"), "repro", check=False)
    assert (done.returncode, done.stdout) == (1, "")
    own, _, rest = done.stderr.partition(STOPPED)
    # Of a place in a file, DVC fills the line.
    assert (own.rstrip(" \n"), rest) == (said.rstrip("\n"), "")


def test_help_of_repro_is_its_own_and_a_wrong_option_is_dvcs():
    done = run(ROOT, str(BIN / "porse"), "repro", "--help")
    assert done.stdout.startswith("Usage: porse repro [OPTIONS] [ARGUMENTS]...")
    assert "ARGUMENTS go to `dvc repro`" in done.stdout
    done = run(ROOT, str(BIN / "porse"), "repro", "--no-such-option", check=False)
    assert (done.returncode, "unrecognized arguments: --no-such-option" in done.stderr) == (2, True)


def test_small_numbers_of_dvc_exp_run_are_read_as_numbers(tmp_path, root):
    project = make_project(tmp_path / "project", committed_params(), BIN.parent)
    run(project, "git", "add", ".")
    run(project, "git", "-c", "user.name=a", "-c", "user.email=a@b", "commit", "-qm", "start")
    values = {"probe.xi": "1e-05", "probe.noise": "1e-3", "train.learning_rate": "3e-4", "exploration.lambda": "1E1"}
    words = [word for name, value in values.items() for word in ("-S", f"{name}={value}")]
    run(project, str(BIN / "dvc"), "exp", "run", *words, "resolve", PYTHONPATH=str(root))
    found = json.loads(run(project, str(BIN / "porse"), "params", "--json", PYTHONPATH=str(root)).stdout)
    values = {row["parameter"]: row["value"] for row in found if row["parameter"] in values}
    assert values == {
        "probe.xi": 1e-05,
        "probe.noise": 0.001,
        "train.learning_rate": 0.0003,
        "exploration.lambda": 10.0,
    }
