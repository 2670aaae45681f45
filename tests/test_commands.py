"""docs/commands.md shows every command, and its examples are read by the commands themselves; some of them are run."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys

import click
import pytest
from click.testing import CliRunner

from porse.cli import main
from porse.report.task_rows import task_rows
from test_cli import ALL
from tiny import BIN, ROOT

PAGE = (ROOT / "docs" / "commands.md").read_text()
EXAMPLES = [
    shlex.split(line)[1:]
    for block in re.findall(r"^```sh\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    for line in block.splitlines()
]
LEAVES = [name for name, command in ALL.items() if not isinstance(command, click.Group)]


def split(words):
    """Returns the name of an example's command, and its arguments."""
    name = next(name for name in (tuple(words[:2]), tuple(words[:1])) if name in LEAVES)
    return name, words[len(name) :]


@pytest.mark.parametrize("name", LEAVES, ids=" ".join)
def test_every_command_has_an_example(name):
    assert name in [split(words)[0] for words in EXAMPLES]


@pytest.mark.parametrize("words", EXAMPLES, ids=" ".join)
def test_every_example_is_what_its_command_takes(words, tmp_path, monkeypatch):
    """click reads the arguments, checks of paths included, and the command itself is not run."""
    name, arguments = split(words)
    for folder in ("prompts", "llm_cache", "run", "demo"):
        (tmp_path / folder).mkdir()
    for file in ("answers.jsonl", "new.txt"):
        (tmp_path / file).touch()
    monkeypatch.chdir(tmp_path)
    context = ALL[name].make_context(" ".join(name), arguments)
    assert not context.args


PRINTED = [
    words
    for words in EXAMPLES
    if split(words)[0]
    in {("params",), ("schedule",), ("methods",), ("tasks",), ("tables",), ("llm", "verify"), ("llm", "stats")}
]


@pytest.mark.parametrize("words", PRINTED, ids=" ".join)
def test_examples_that_only_print_do_so_from_a_folder_below_the_root(words, root, monkeypatch):
    monkeypatch.chdir(root / "docs")
    done = CliRunner().invoke(main, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert done.stdout.strip()


@pytest.mark.parametrize(
    ("words", "rows"),
    [
        (["tables"], lambda found: {row["table"] for row in found} > {"candidates", "curves"}),
        (["schedule"], lambda found: found["total_epochs"] == sum(row["epochs"] for row in found["rungs"])),
        (
            ["params", "--stage", "fuse"],
            lambda found: {"parameter": "seed", "value": 1, "origin": "params.yaml"} in found,
        ),
        (
            ["methods"],
            lambda found: {"kind": "ablation", "name": "cells-2000", "replaces": {"exploration.cells": 2000}} in found,
        ),
        (["llm", "pending"], lambda found: found == []),
        (["llm", "verify"], lambda found: found["problems"] == [] and found["records"] > 10),
        (["llm", "stats", "--list"], lambda found: {*found[0]} == {"key", "iteration", "stage", "subject"}),
        (
            ["llm", "stats"],
            lambda found: (
                sum(row["replies"] for row in found["by_place"]) == found["recorded"]["replies"]
                and found["by_place"][0]["iteration"] == 1
            ),
        ),
        (["llm", "estimate"], lambda found: found["total"]["to_ask"] == sum(line["to_ask"] for line in found["lines"])),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_tables_are_printed_as_json(words, rows, root, tmp_path, monkeypatch):
    # A cache of its own: what waits for an answer lies beside it.
    shutil.copytree(root / "llm_cache", tmp_path / "llm_cache")
    cache = ["--cache", str(tmp_path / "llm_cache")] if words[0] == "llm" else []
    monkeypatch.chdir(root)
    done = CliRunner().invoke(main, [*words, *cache, "--json"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert rows(json.loads(done.stdout))


def test_every_command_that_prints_a_table_has_json():
    without = {name for name in LEAVES if not any("--json" in option.opts for option in ALL[name].params)}
    # They write files, run something, or print a text that is meant to be read as it is.
    assert without == {
        ("demo",), ("export",), ("init",), ("pipeline",), ("schema",), ("run",), ("report",), ("render",), ("play",), ("publish",), ("show",), ("suite", "run"),
        ("llm", "export"), ("llm", "import"), ("llm", "show"), ("llm", "diff"), ("llm", "refresh"),
    }  # fmt: skip


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_shell_completes_as_the_page_says(shell):
    assert f"_PORSE_COMPLETE={shell}_source porse" in PAGE
    script = CliRunner().invoke(main, [], env={"_PORSE_COMPLETE": f"{shell}_source"}, prog_name="porse")
    # bash's version is looked up where there is a bash.
    assert "_PORSE_COMPLETE" in script.output


def test_the_tasks_are_listed_as_they_are_without_importing_one():
    code = "import sys; from porse.cli import main; main(['tasks', '--json'], standalone_mode=False); "
    code += "print({name.partition('.')[0] for name in sys.modules} & {'numpy', 'pyarrow', 'torch', 'mujoco'})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    listed, imported = done.stdout.rsplit("\n]\n", 1)
    assert json.loads(listed + "]") == task_rows(), "run: python -m porse.report.task_rows"
    assert imported.strip() == "set()"


def test_help_names_every_command_in_a_line_of_its_own_and_imports_none():
    code = "import sys; from porse.cli import main; main(['--help'], standalone_mode=False); "
    code += (
        "print({name.partition('.')[0] for name in sys.modules} & {'numpy', 'pyarrow', 'torch', 'yaml', 'pydantic'})"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    *lines, imported = said.splitlines()
    assert imported == "set()"
    listed = lines[lines.index("Commands:") + 1 :]
    names = sorted(name for (name,) in (words for words in ALL if len(words) == 1))
    # A line that were too long would go on below; one that click cut off would end in dots.
    assert [line.split()[0] for line in listed] == names
    assert all(line.endswith(".") and not line.endswith("...") for line in listed)


def test_the_shell_is_told_what_each_command_does_and_the_options_of_all():
    words = {"_PORSE_COMPLETE": "fish_complete", "COMP_WORDS": "porse pu", "COMP_CWORD": "pu"}
    done = subprocess.run([BIN / "porse"], env={**os.environ, **words}, capture_output=True, text=True, check=True)
    assert done.stdout == (
        "plain,publish\tMake published/NAME of a finished run.\nplain,published\tList the published runs.\n"
    )
    words = {"_PORSE_COMPLETE": "bash_complete", "COMP_WORDS": "porse --v", "COMP_CWORD": "1"}
    done = subprocess.run([BIN / "porse"], env={**os.environ, **words}, capture_output=True, text=True, check=True)
    assert done.stdout == "plain,--version\n"


def test_the_shell_is_told_the_commands_that_begin_as_typed():
    words = {"_PORSE_COMPLETE": "bash_complete", "COMP_WORDS": "porse llm p", "COMP_CWORD": "2"}
    done = subprocess.run([BIN / "porse"], env={**os.environ, **words}, capture_output=True, text=True, check=True)
    assert done.stdout == "plain,pending\n"
