"""Pictures of trained policies: which episode is shown and when, and the command on a policy file."""

import ctypes.util
import os
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from porse.checkpoint import write_checkpoint
from porse.config import parse_params
from porse.pool import BEST, policy_file
from porse.report.trained import HEIGHT, WIDTH, shown_episode
from porse.training.episodes import Episode
from porse.training.start import random_policy
from tiny import committed_params


def test_the_first_of_the_best_episodes_is_shown_and_its_last_picture_is_of_before_its_end() -> None:
    episodes = [Episode(9, 0.25), Episode(8, 0.75), Episode(3, 0.75), Episode(30, 0.5)]
    # Seven steps are taken before the last one: a third and two thirds of them are 2 and 4.
    assert shown_episode(episodes) == (1, [0, 2, 4, 7])
    assert shown_episode([Episode(1, -1.0)]) == (0, [0, 0, 0, 0])


RENDERER = next((name for name in ("EGL", "OSMesa") if ctypes.util.find_library(name)), None)


@pytest.mark.skipif(RENDERER is None, reason="needs EGL or OSMesa: install libegl1 or libosmesa6")
def test_the_command_draws_the_policy_of_the_first_seed_in_four_pictures(tmp_path: Path) -> None:
    for seed in (2, 1):
        document = {**committed_params(), "seed": seed}
        result = tmp_path / "results" / f"Quadcopter-human-{seed}"
        result.mkdir(parents=True)
        (result / "params.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
        write_checkpoint(
            policy_file(result / "run" / "result" / "start", BEST),
            random_policy(parse_params(document, "params.yaml"), seed),
        )
        (result / "done.json").write_text("{}")

    def drawn() -> np.ndarray:
        command = [sys.executable, "-m", "porse.report.trained", str(tmp_path / "results"), str(tmp_path / "out")]
        subprocess.run(command, check=True, timeout=200, env={**os.environ, "MUJOCO_GL": str(RENDERER).lower()})
        assert [path.name for path in (tmp_path / "out").iterdir()] == ["Quadcopter.png"]
        return np.asarray(Image.open(tmp_path / "out" / "Quadcopter.png").convert("RGB"))

    both = drawn()
    assert both.shape == (HEIGHT, 4 * WIDTH, 3)
    pictures = np.split(both, 4, axis=1)
    assert all(not np.array_equal(a, b) for a, b in pairwise(pictures))
    shutil.rmtree(tmp_path / "results" / "Quadcopter-human-2")
    assert np.array_equal(drawn(), both)
