"""`porse render` and `porse play` with MuJoCo's own renderer and no display. One process runs them all, as torch loads once."""

import ctypes.util
import json
import os
import subprocess
import sys
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
import yaml

from porse import renderer
from porse.checkpoint import write_checkpoint
from porse.config import parse_params
from porse.errors import PorseError
from porse.pool import BEST, policy_file
from porse.training.start import random_policy
from tiny import BIN, committed_params

RUN = """
import json, sys
from click.testing import CliRunner
from porse.cli import main
for arguments in json.load(sys.stdin):
    result = CliRunner().invoke(main, arguments)
    print(json.dumps([result.exit_code, result.output]))
"""

RENDERER = next((name for name in ("EGL", "OSMesa") if ctypes.util.find_library(name)), None)
drawn = pytest.mark.skipif(RENDERER is None, reason="needs EGL or OSMesa: install libegl1 or libosmesa6")


@pytest.fixture(scope="module")
def shown(root, params, tmp_path_factory) -> tuple[Path, dict[str, tuple[int, str]]]:
    """Returns a folder and, for each file written into it, the exit code and the output of its command."""
    folder = tmp_path_factory.mktemp("shown")
    # Commands run in the project's root.
    (folder / "presets").symlink_to(root / "presets")
    write_checkpoint(folder / "policy.safetensors", random_policy(params, 1))
    write_checkpoint(policy_file(folder / "run" / "result" / "start", BEST), random_policy(params, 1))
    # A project beside the one that the commands run in, with other parameters.
    (folder / "project").mkdir()
    document = committed_params()
    document["train"] |= {"hidden": [16]}
    (folder / "project" / "params.yaml").write_text(yaml.safe_dump(document))
    other = random_policy(parse_params(document, "params.yaml"), 1)
    write_checkpoint(policy_file(folder / "project" / "run" / "result" / "start", BEST), other)
    pen = parse_params({**committed_params(), "task": "Pen"}, "params.yaml")
    write_checkpoint(folder / "pen.safetensors", random_policy(pen, 1))
    policy = ["--checkpoint", "policy.safetensors", "--params", str(root / "params.yaml"), "--seconds", "0.4"]
    commands = {
        "over.png": ["render", "Over", "--out", "over.png"],
        "quadcopter.gif": ["render", "Quadcopter", "--out", "quadcopter.gif", "--seconds", "0.4"],
        "over.gif": ["render", "Over", "--out", "over.gif", "--seconds", "0.1"],
        "again.gif": ["render", "Quadcopter", "--out", "again.gif", "--seconds", "0.4"],
        "Quadcopter.gif": ["play", "Quadcopter", *policy],
        "pen.gif": ["play", "Pen", "--out", "pen.gif", "--seconds", "0.2"],
        "pen_by_policy.gif": ["play", "Pen", "--out", "pen_by_policy.gif", *policy],
        "pen_by_its_own.gif": [
            "play",
            "Pen",
            "--out",
            "pen_by_its_own.gif",
            "--checkpoint",
            "pen.safetensors",
            *policy[2:],
        ],
        "of_run.gif": ["play", "Quadcopter", "--out", "of_run.gif", "--checkpoint", "run", *policy[2:]],
        "of_its_folder.gif": [
            "play",
            "Quadcopter",
            "--out",
            "of_its_folder.gif",
            "--checkpoint",
            "project",
            *policy[4:],
        ],
        "of_no_run.gif": ["play", "Quadcopter", "--out", "of_no_run.gif", "--checkpoint", "presets", *policy[2:]],
        "small.mp4": [
            "play",
            "Quadcopter",
            *policy,
            "--out",
            "small.mp4",
            "--width",
            "160",
            "--height",
            "120",
        ],
        "other_start.gif": ["render", "Quadcopter", "--out", "other_start.gif", "--seconds", "0.4", "--seed", "3"],
        "from_above.png": ["render", "Over", "--out", "from_above.png", "--camera", "0,-0.5,0.5,2,90,-80"],
        "pen.webp": ["render", "Pen", "--out", "pen.webp"],
        "nothing.png": ["render", "Penn", "--out", "nothing.png"],
    }
    headless = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "MUJOCO_GL")}
    done = subprocess.run(
        [sys.executable, "-c", RUN], cwd=folder, env=headless | {"PYTHONPATH": str(root)}, text=True, check=True,
        input=json.dumps(list(commands.values())), stdout=subprocess.PIPE,
    )  # fmt: skip
    results = [tuple(json.loads(line)) for line in done.stdout.splitlines()]
    return folder, dict(zip(commands, results, strict=True))


@drawn
def test_a_png_shows_the_task_at_an_episodes_start(shown):
    folder, results = shown
    assert results["over.png"] == (0, "over.png: Over\n")
    pixels = imageio.imread(folder / "over.png")
    assert pixels.shape == (360, 480, 3)
    # The floor, the hands, the egg and its goal: a blank picture has one colour.
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 500


@drawn
def test_a_gif_has_25_frames_a_second_and_moves(shown):
    folder, results = shown
    assert results["quadcopter.gif"] == (0, "quadcopter.gif: Quadcopter\n")
    frames = imageio.imread(folder / "quadcopter.gif")
    # 0.4 s of 0.01 s steps, every 4th of them, and the start
    assert frames.shape == (11, 360, 480, 3)
    assert not np.array_equal(frames[0], frames[-1])
    assert imageio.immeta(folder / "quadcopter.gif")["duration"] == 40


@drawn
def test_random_actions_are_the_same_each_time(shown):
    folder, _ = shown
    assert (folder / "quadcopter.gif").read_bytes() == (folder / "again.gif").read_bytes()


@drawn
def test_play_without_a_display_writes_a_gif_named_after_the_task(shown):
    folder, results = shown
    assert results["Quadcopter.gif"] == (0, "Quadcopter.gif: Quadcopter, 0.4 s\n")
    assert imageio.imread(folder / "Quadcopter.gif").shape == (11, 360, 480, 3)


@drawn
def test_a_film_keeps_the_colour_of_a_small_thing(shown):
    """The egg is orange, the goal green; the floor, the hands and the sky are neither."""
    folder, _ = shown
    red, green, blue = imageio.imread(folder / "over.gif")[0][..., :3].astype(int).transpose(2, 0, 1)
    assert ((red > green + 30) & (green > blue + 60)).sum() > 20
    assert ((green > red + 40) & (green > blue + 40)).sum() > 20


@drawn
def test_play_follows_the_policy(shown):
    """From the same start, the policy's actions lead elsewhere than the random ones of `render`."""
    folder, _ = shown
    by_policy, at_random = (imageio.imread(folder / name) for name in ("Quadcopter.gif", "quadcopter.gif"))
    assert np.array_equal(by_policy[0], at_random[0])
    assert not np.array_equal(by_policy[-1], at_random[-1])


@drawn
def test_of_a_run_play_shows_the_policy_that_it_ended_with(shown):
    folder, results = shown
    assert (folder / "of_run.gif").read_bytes() == (folder / "Quadcopter.gif").read_bytes()
    code, said = results["of_no_run.gif"]
    assert code == 1
    assert "expected a checkpoint at presets/result/start/policies/best.safetensors, found no such file" in said


@drawn
def test_of_the_folder_of_a_run_play_shows_that_policy_with_the_runs_own_parameters(shown):
    folder, results = shown
    assert results["of_its_folder.gif"] == (0, "of_its_folder.gif: Quadcopter, 0.4 s\n")
    assert (folder / "of_its_folder.gif").read_bytes() != (folder / "of_run.gif").read_bytes()


@drawn
def test_play_without_a_policy_is_random(shown):
    folder, results = shown
    assert results["pen.gif"] == (0, "pen.gif: Pen, 0.2 s\n")
    # 11 steps of 0.01667 s, every 2nd of them, and the start
    assert imageio.imread(folder / "pen.gif").shape[0] == 6


@drawn
def test_a_policy_of_another_task_is_refused(shown):
    _, results = shown
    code, said = results["pen_by_policy.gif"]
    assert code == 1
    # The observations and actions of the task's page, and the networks of its preset; the file is of Quadcopter.
    assert "expected a policy of Pen with 417 observations, hidden layers of 256-256-128 and 52 actions, " in said
    assert (
        "found 21 observations, hidden layers of 64-64 and 12 actions in policy.safetensors; name the task and" in said
    )


@drawn
def test_a_policy_has_the_networks_of_the_task_that_is_shown(shown):
    # The file of parameters is of Quadcopter, whose preset has 64-64; that of Pen has 256-256-128.
    _, results = shown
    assert results["pen_by_its_own.gif"] == (0, "pen_by_its_own.gif: Pen, 0.4 s\n")


@drawn
def test_another_kind_of_file_and_an_unknown_task_are_refused(shown):
    folder, results = shown
    assert results["pen.webp"] == (
        1, "Error: expected --out to end in .png or .gif or .mp4, found pen.webp; choose one of them\n",
    )  # fmt: skip
    assert results["nothing.png"][0] == 1
    assert "found 'Penn' in the argument TASK; the nearest names are Pen" in results["nothing.png"][1]
    assert not (folder / "nothing.png").exists()


def test_the_renderer_is_the_one_that_is_there_and_the_users_choice_goes_first(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr(renderer.sys, "platform", "linux")
    for found, expected in (({"EGL", "OSMesa"}, "egl"), ({"OSMesa"}, "osmesa")):
        monkeypatch.setenv("MUJOCO_GL", "")
        monkeypatch.setattr(ctypes.util, "find_library", lambda name, found=found: name if name in found else None)
        renderer.choose_renderer()
        assert os.environ["MUJOCO_GL"] == expected
    monkeypatch.setenv("MUJOCO_GL", "")
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: None)
    with pytest.raises(PorseError, match="libegl1 or libosmesa6"):
        renderer.choose_renderer()
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    renderer.choose_renderer()
    assert os.environ["MUJOCO_GL"] == "glfw"


@pytest.mark.parametrize(
    "command", [["render", "Quadcopter", "--out", "a.png"], ["play", "Quadcopter", "--out", "a.gif"]]
)
def test_a_renderer_that_is_not_there_is_named(tmp_path, command):
    done = subprocess.run(
        [BIN / "porse", *command], cwd=tmp_path, capture_output=True, text=True, check=False,
        env={**os.environ, "MUJOCO_GL": "vulkan"},
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == (
        "Error: expected vulkan to draw a picture, found RuntimeError: invalid value for environment variable MUJOCO_GL: "
        "vulkan; install libegl1 or libosmesa6, or set MUJOCO_GL to egl or osmesa\n"
    )


@pytest.mark.parametrize("command", [["estimate", "--seconds", "0.1"], ["llm", "estimate"]])
def test_a_renderer_that_is_not_there_stops_nothing_that_draws_nothing(root, command):
    done = subprocess.run(
        [BIN / "porse", *command], cwd=root, capture_output=True, text=True, check=False,
        env={**os.environ, "MUJOCO_GL": "vulkan"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


@drawn
def test_a_film_has_the_size_the_start_and_the_camera_that_were_chosen(shown):
    folder, results = shown
    assert results["other_start.gif"] == (0, "other_start.gif: Quadcopter\n")
    first, other = (imageio.imread(folder / name)[0] for name in ("quadcopter.gif", "other_start.gif"))
    assert not np.array_equal(first, other)
    assert results["from_above.png"] == (0, "from_above.png: Over\n")
    assert not np.array_equal(imageio.imread(folder / "over.png"), imageio.imread(folder / "from_above.png"))


@drawn
def test_an_mp4_has_as_many_frames_as_a_gif(shown):
    reader = pytest.importorskip("imageio_ffmpeg")
    folder, results = shown
    assert results["small.mp4"] == (0, "small.mp4: Quadcopter, 0.4 s\n")
    assert reader.count_frames_and_secs(str(folder / "small.mp4")) == (11, pytest.approx(0.44))
    frames = reader.read_frames(str(folder / "small.mp4"))
    assert next(frames)["size"] == (160, 120)
    frames.close()
