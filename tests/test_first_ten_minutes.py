"""docs/first-ten-minutes.md is what its recorder writes of its commands; and the commands are such that exist."""

import re
import shlex

import pytest
from click.testing import CliRunner

from first_ten_minutes import PAGE, PICTURES, SHOTS, STEPS, lines_of, outputs, shortened
from porse.cli import main
from test_commands import LEAVES, split


def test_the_page_has_every_command_of_the_recorder_in_its_order():
    assert re.findall(r"^\$ (.*)$", PAGE.read_text(), re.MULTILINE) == [step.command for step in STEPS]


def test_the_pages_pictures_are_there_and_small():
    shown = re.findall(r"\]\(first-ten-minutes/([^)]+)\)", PAGE.read_text())
    assert sorted(shown) == sorted(path.name for path in PICTURES.iterdir())
    assert {f"{name}.png" for name in SHOTS} | {f"{step.still}.svg" for step in STEPS if step.still} == {*shown}
    assert sum(path.stat().st_size for path in PICTURES.iterdir()) < 1.5 * 2**20


TYPED = [part for step in STEPS for part in step.command.split(" && ") if part.startswith("porse ")]


@pytest.mark.parametrize("command", TYPED)
def test_the_commands_of_porse_on_the_page_exist(command):
    name, _ = split(shlex.split(command)[1:])
    assert name in LEAVES


@pytest.mark.parametrize("command", ["porse tasks --tag door", "porse params --stage eliminate"])
def test_what_a_quick_command_says_is_what_the_page_shows(root, monkeypatch, command):
    monkeypatch.chdir(root)
    done = CliRunner().invoke(main, command.split()[1:])
    # The page's lines are those of a terminal, which breaks long ones.
    assert " ".join(outputs(PAGE.read_text())[command]).split() == done.output.split()


def test_the_page_names_no_machine():
    assert not re.search(r"/(work|tmp|home|root)/", PAGE.read_text())


def test_a_long_output_is_cut_in_the_middle_and_what_scrolled_off_is_kept():
    pytest.importorskip("pyte", reason="the recorder needs it: pip install pyte")
    # 60 lines in a terminal of 32; the last but one is written over, as a bar does.
    written = b"".join(f"line {n}\r\n".encode() for n in range(58)) + b"bar 1\rbar 2\r\nend"
    lines = lines_of([written[:50], written[50:]])
    assert lines == [*(f"line {n}" for n in range(58)), "bar 2", "end"]
    assert shortened(lines) == [*lines[:23], "...", *lines[-23:]]
    assert shortened(lines[:46]) == lines[:46]
