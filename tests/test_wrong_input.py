"""Paths, lengths and places that a command cannot work with are refused before any work, in one sentence."""

import hashlib
import json
import os

import click
import pytest
import yaml
from click.testing import CliRunner

from porse import show
from porse.cli import main
from porse.errors import PorseError
from porse.outdated import another_run, changed_parameters
from porse.paths import at_root, check_target, project_root
from porse.repro import reproduce
from tiny import committed_params


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
    (tmp_path / "file").touch()
    done = porse("results", "--metrics", str(tmp_path / "file" / "metrics.json"))
    assert done.exit_code == 1
    assert f"at {tmp_path / 'file' / 'metrics.json'}, found: Not a directory" in done.output


@pytest.mark.parametrize(
    ("text", "words"), [("{", "found no JSON"), ("[]", "found others"), ('{"mts": 1}', "found others")]
)
def test_metrics_that_are_none_are_refused(tmp_path, text, words):
    (tmp_path / "metrics.json").write_text(text)
    done = porse("results", "--metrics", str(tmp_path / "metrics.json"))
    assert done.exit_code == 1
    assert words in done.output


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
    metrics = tmp_path / "metrics.json"
    metrics.write_text("{}")
    assert "warning: these results are another run's" in porse("results", "--metrics", str(metrics), "--json").stderr
    # Without the inputs of the run, nothing is known.
    cached.unlink()
    assert another_run(tmp_path) is None


def test_parameters_that_cannot_be_read_are_said(tmp_path):
    (tmp_path / "params.yaml").write_text("task: [")
    said = another_run(tmp_path)
    assert said is not None
    assert "cannot be read" in said


def test_a_source_archive_without_git_says_what_to_do(tmp_path):
    (tmp_path / "dvc.yaml").touch()
    with pytest.raises(PorseError, match="unpacked source archive; take a clone, or run: git init"):
        reproduce(tmp_path, (), print)


def test_a_display_that_does_not_answer_is_none(monkeypatch):
    monkeypatch.setattr(show.sys, "platform", "linux")
    monkeypatch.setenv("DISPLAY", ":4093")
    assert not show.has_display()
    monkeypatch.delenv("DISPLAY")
    assert not show.has_display()


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
