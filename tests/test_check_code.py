"""`porse check-code` in a real process: verdicts, exit codes, standard input, several files, and its speed."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

REPLIES = Path(__file__).parent / "replies"
GOOD, BAD = REPLIES / "reward_plain.md", REPLIES / "bad_unknown_variable.md"
MAPPING = REPLIES / "mapping_tuples.md"


def check_code(root, *arguments, **more):
    command = [sys.executable, "-c", "from porse.cli import main; main()", "check-code", *map(str, arguments)]
    environment = os.environ | {"PYTHONPATH": str(root)}
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False, **more)


def test_several_files_and_one_that_is_refused(root):
    result = check_code(root, "Quadcopter", "--reward", GOOD, "--reward", BAD, "--mapping", MAPPING)
    first, second, third = result.stdout.splitlines()
    assert result.returncode == 1, result.stderr
    assert first == f"{GOOD}: accepted: distance_reward, speed_reward"
    assert second.startswith(f"{BAD}:4: refused (variable): expected variables of the task, found root_position,")
    assert third == f"{MAPPING}: accepted: distance falls, height rises"


def test_standard_input_is_read_for_a_dash_and_json_is_one_object_a_line(root):
    result = check_code(root, "Quadcopter", "--mapping", "-", "--json", input=MAPPING.read_text())
    assert result.returncode == 0, result.stderr
    found = json.loads(result.stdout)
    assert json.loads(found.pop("program"))["names"] == ["distance", "height"]
    assert found == {
        "file": "-",
        "kind": "mapping",
        "passed": True,
        "check": "ok",
        "message": "",
        "line": 0,
        "names": ["distance", "height"],
        "rises": [False, True],
        "warning": "",
    }


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["Quadcopter"], "--reward FILE or --mapping FILE"),
        (["Quadcopter", "--reward", "nowhere.md"], "nothing at nowhere.md"),
        (["Quadcoptre", "--reward", str(GOOD)], "Quadcopter"),
    ],
)
def test_wrong_calls_say_what_was_expected(root, arguments, says):
    result = check_code(root, *arguments)
    assert result.returncode != 0
    assert "Error" in result.stderr
    assert says in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.slow
def test_one_file_takes_under_three_seconds_and_further_ones_under_50_ms(root):
    """Slow only because it wants the machine for itself."""
    times = []
    for count in (1, 21):
        started = time.perf_counter()
        assert check_code(root, "Quadcopter", *["--reward", GOOD] * count).returncode == 0
        times.append(time.perf_counter() - started)
    assert times[0] < 3.0
    assert (times[1] - times[0]) / 20 < 0.050
