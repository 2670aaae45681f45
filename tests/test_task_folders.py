"""A task has a folder to itself: naming it loads nothing of another, training with it needs all that is there."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from porse.inputs.files import task_files
from porse.task_names import TASK_CLASSES
from porse.tasks.franka_cabinet import FrankaCabinet
from porse.tasks.franka_cabinet.scene import ARMATURE, FINGER

FOLDERS = {name: module.partition(":")[0].rpartition(".")[2] for name, module in TASK_CLASSES.items()}

IMPORTED = """
import sys
from porse.task_names import TASK_CLASSES
from porse.tasks import find_task
for name in TASK_CLASSES:
    find_task(name)
    print(name, *sorted({module.split(".")[2] for module in sys.modules if module.startswith("porse.tasks.")}))
"""

READ = """
import sys
from porse.tasks import find_task
sys.addaudithook(lambda event, values: event == "open" and str(values[0]).endswith(".xml") and print(values[0]))
find_task("Humanoid")
print("found")
find_task("Humanoid").scene()
"""


def said_by(program: str) -> list[str]:
    return subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout.splitlines()


def test_finding_a_task_imports_its_folder_and_that_of_no_other():
    asked: set[str] = set()
    for line in said_by(IMPORTED):
        name, *imported = line.split()
        asked.add(FOLDERS[name])
        assert set(imported) & set(FOLDERS.values()) == asked, name
    assert asked == set(FOLDERS.values())


def test_a_scene_is_read_when_it_is_built_and_no_other_with_it(root):
    assert said_by(READ) == ["found", str(root / "porse" / "tasks" / "humanoid" / "scene.xml")]


def test_every_task_has_a_folder_of_its_own(root):
    assert len(set(FOLDERS.values())) == len(TASK_CLASSES)
    folders = {path.name for path in (root / "porse" / "tasks").iterdir() if path.is_dir()} - {"__pycache__"}
    assert folders == {*FOLDERS.values(), "hands"}


def test_nothing_lies_among_the_tasks_that_no_training_needs(root):
    needed = {path for task in TASK_CLASSES for path in task_files(root, task)}
    tasks = root / "porse" / "tasks"
    there = {path for path in tasks.rglob("*") if path.is_file() and "__pycache__" not in path.parts}
    # A training with a task of one's own needs own.py.
    assert {path.relative_to(tasks).as_posix() for path in there - needed} <= {"own.py", "__init__.py"}


def test_an_installed_package_has_every_scene(root):
    setuptools = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["setuptools"]
    tasks = root / "porse" / "tasks"
    carried = {path for pattern in setuptools["package-data"]["porse.tasks"] for path in tasks.glob(pattern)}
    data = {path for path in tasks.rglob("*") if path.is_file() and path.suffix not in {".py", ".pyc"}}
    assert data == carried
    assert {path.parent.name for path in data} == {"quadcopter", "anymal", "humanoid", "franka_cabinet"}


@pytest.mark.parametrize("name", ["quadcopter", "anymal", "humanoid"])
def test_a_static_scene_opens_as_a_file(root, name):
    import mujoco

    assert mujoco.MjModel.from_xml_path(str(root / "porse" / "tasks" / name / "scene.xml")).nu > 0


def test_the_arm_is_built_with_the_numbers_that_its_drives_are_computed_from():
    model = FrankaCabinet.scene().compile()
    joints = [model.joint(f"panda_joint{i}") for i in range(1, 8)] + [
        model.joint(f"panda_finger_joint{i}") for i in (1, 2)
    ]
    assert [float(joint.armature[0]) for joint in joints] == [ARMATURE] * 9
    assert [float(joint.damping[0]) for joint in joints] == [0.0] * 7 + [FINGER.damping] * 2


def test_the_folders_that_the_list_names_are_there(root):
    assert all((root / Path("porse/tasks", folder, "task.py")).is_file() for folder in FOLDERS.values())
