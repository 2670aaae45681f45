"""Ctrl-C ends a command with what to do next and without a traceback. Real processes get the signal as a terminal sends it."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tiny import BIN, QUIET, committed_params, make_project


def interrupted(command: list[str], folder: Path, awaited: str, root: Path) -> tuple[int, str]:
    """Returns exit code and output of a command whose process group is interrupted once it has said `awaited`."""
    # A shell that starts these tests in the background has them ignore Ctrl-C, and a child would inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with subprocess.Popen(
        command,
        cwd=folder,
        env={**os.environ, **QUIET, "PYTHONPATH": str(root), "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stdout is not None
        said = ""
        for line in process.stdout:
            said += line
            if awaited in line:
                os.killpg(process.pid, signal.SIGINT)
                break
        said += process.stdout.read()
        return process.wait(timeout=60), said


def test_an_interrupted_porse_run_says_that_it_does_not_go_on(root, tmp_path):
    document = committed_params() | {"generator": "grammar"}
    params = tmp_path / "params.yaml"
    params.write_text(yaml.safe_dump(document, sort_keys=False))
    command = [str(BIN / "porse"), "run", "--out", str(tmp_path / "out"), "--params", str(params)]
    code, said = interrupted(command, root, "iteration 1", root)
    assert code == 130
    assert "stopped by Ctrl-C: `porse run` cannot continue; remove the --out folder" in said
    assert "Traceback" not in said


@pytest.mark.parametrize("arguments", [[], ["wait"]], ids=str)
def test_an_interrupted_porse_repro_says_that_it_goes_on(root, tmp_path, arguments):
    project = make_project(tmp_path / "project", committed_params(), Path(sys.prefix))
    (project / "dvc.yaml").write_text("stages:\n  wait:\n    cmd: echo at work && exec sleep 60\n")
    code, said = interrupted([str(BIN / "porse"), "repro", *arguments], project, "at work", root)
    assert code == 130
    assert said.count("stopped by Ctrl-C: run `porse repro` again, and it goes on") == 1
    # DVC's own words about it are for those who gave it arguments.
    assert ("interrupted by the user" in said or "failed to reproduce" in said) is bool(arguments)
    assert "Traceback" not in said


def test_an_interrupted_stage_of_dvc_repro_says_how_to_go_on(root, tmp_path):
    """`dvc repro` without `porse repro` around it: the stage itself says it."""
    project = make_project(tmp_path / "project", committed_params() | {"generator": "grammar"}, Path(sys.prefix))
    stage = "stages:\n  wait:\n    cmd: exec .venv/bin/python wait.py\n"
    (project / "dvc.yaml").write_text(stage)
    (project / "wait.py").write_text(WAITING)
    code, said = interrupted([str(BIN / "dvc"), "repro", "wait"], project, "at work", root)
    assert code != 0
    assert "Error: stopped by Ctrl-C: run `porse repro` again, and it goes on" in said
    assert "Traceback" not in said


WAITING = """
import time
import click
from porse.stage import PlainCommand, say

@click.command(cls=PlainCommand)
def main():
    say("at work")
    time.sleep(60)

main()
"""
