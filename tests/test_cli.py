import json
import os

import click
import pytest
import yaml
from click.testing import CliRunner

from porse import tables
from porse.cli import main
from porse.task_names import TAGS, TASK_CLASSES, TASK_TAGS
from terminal import on_a_terminal
from tiny import BIN, committed_params


def commands(group, prefix=()):
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        yield (*prefix, name), command
        if isinstance(command, click.Group):
            yield from commands(command, (*prefix, name))


ALL = dict(commands(main))


def porse(*words):
    return CliRunner().invoke(main, list(words), catch_exceptions=False)


@pytest.mark.parametrize("name", ALL, ids=" ".join)
def test_every_command_has_help(name):
    assert ALL[name].help
    assert porse(*name, "--help").exit_code == 0


@pytest.mark.parametrize(
    "name", [name for name, command in ALL.items() if not isinstance(command, click.Group)], ids=" ".join
)
def test_every_command_is_in_the_table_of_commands(root, name):
    assert f"| `porse {' '.join(name)}` |" in (root / "docs" / "commands.md").read_text()


PATHS = [
    (name, parameter)
    for name, command in ALL.items()
    for parameter in command.params
    if isinstance(parameter.type, click.Path)
    and f"{name[-1]} {parameter.name}" not in ("import source", "play checkpoint", "export run", "report runs")
]
"""Every path that is given to a command; only answers to import, and what to play, to export or to compare, may be a file or a
folder."""


@pytest.mark.parametrize(("name", "parameter"), PATHS, ids=lambda value: getattr(value, "name", None))
def test_a_path_is_a_file_or_a_folder_and_the_other_one_is_refused(tmp_path, name, parameter):
    file = tmp_path / "file"
    file.touch()
    wrong = tmp_path if parameter.type.file_okay else file
    with pytest.raises(click.BadParameter, match=f"{wrong}' is a (file|directory)"):
        parameter.type.convert(str(wrong), parameter, None)


def test_the_schedule_ends_with_the_sum(root):
    lines = porse("schedule", "--params", str(root / "params.yaml")).output.splitlines()
    # 5 iterations x 36 H epochs, H = 16
    assert lines[-1] == f"in all {5 * 36 * 16} epochs of {5 * 6 * 96} allowed"


def test_the_methods_are_printed_with_what_they_replace():
    lines = porse("methods").output.splitlines()
    assert lines[0] == "method   porse                params.yaml as it is"
    assert any(line.startswith("ablation cells-2000 ") and "exploration.cells: 2000" in line for line in lines)


def test_the_data_dictionary_names_every_column():
    output = porse("tables").output
    assert all(column.name in output for table in tables.TABLES.values() for column in table.columns)


def test_tasks_are_listed_as_json():
    rows = {row["task"]: row for row in json.loads(porse("tasks", "--json").output)}
    assert (rows["Quadcopter"]["observations"], rows["Quadcopter"]["actions"]) == (21, 12)
    assert (rows["Over"]["observations"], rows["Over"]["actions"]) == (398, 40)
    assert set(rows["Over"]) == {"task", "observations", "actions", "family", "description", "episode_length", "tags"}
    assert rows["DoorOpenOutward"]["tags"] == ["hands", "door", "easy"]


def test_every_task_has_tags_that_are_explained():
    assert set(TASK_TAGS) == set(TASK_CLASSES)
    assert {tag for tags in TASK_TAGS.values() for tag in tags} == set(TAGS)
    assert all({"easy", "hard"} - {*tags} for tags in TASK_TAGS.values())


def test_tasks_with_several_tags_have_all_of_them():
    lines = porse("tasks", "--tag", "door", "--tag", "hard").output.splitlines()
    # DoorCloseInward, which has a door, and SwingCup, which is hard, are others.
    assert [line.split()[0] for line in lines] == ["DoorCloseOutward", "DoorOpenInward"]
    assert "hands, door, hard" in lines[0]
    everything = porse("tasks").output
    assert "BottleCap " in everything
    assert "\ndoor        a double door is opened or closed\n" in everything


def test_results_without_a_run_say_what_to_do(tmp_path):
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(committed_params()))
    done = porse("results", str(tmp_path))
    assert done.exit_code == 1
    assert "iterations.parquet, found no such file; run `porse repro` to make it" in done.output


@pytest.mark.parametrize(
    "words", [["tables"], ["methods"], ["tasks", "--tag", "door"], ["params", "--params", "no.yaml"]]
)
def test_output_is_wrapped_at_the_width_of_a_terminal_and_whole_elsewhere(words):
    _, pieces = on_a_terminal([BIN / "porse", *words], 24, 70, os.environ)
    wrapped = b"".join(pieces).decode().replace("\r\n", "\n")
    assert max(map(len, wrapped.splitlines())) <= 70
    plain = CliRunner().invoke(main, words).output
    assert max(map(len, plain.splitlines())) > 70
    assert wrapped.split() == plain.split()
