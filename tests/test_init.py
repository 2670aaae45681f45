"""A project outside the repository: from a checkout, and from a wheel that was built and unpacked, with the real commands."""

import hashlib
import json
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile

import pytest
import yaml
from click.testing import CliRunner
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from porse.cli import main
from porse.config import load_params
from porse.documents import read_yaml
from porse.errors import PorseError
from porse.init import make_project
from porse.inputs.files import changed_files
from porse.inputs.resolve import resolve_inputs
from porse.pipeline import check_dependency, check_pipeline
from porse.suite.resolve import code_id
from tiny import run

PORSE = (sys.executable, "-c", "import sys; from porse.cli import main; sys.argv[0] = 'porse'; main()")


@pytest.fixture(scope="module")
def mine(tmp_path_factory):
    """A project that the command made."""
    folder = tmp_path_factory.mktemp("init") / "mine"
    done = CliRunner().invoke(main, ["init", str(folder)], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return folder


def test_the_project_is_whole_and_trains_a_task_of_its_own_without_a_model(mine):
    params = load_params(mine / "params.yaml", mine)
    assert (params.task, params.generator) == ("my_tasks.cart:CartPole", "grammar")
    # By rule, from the sizes that the class states: 4 observations and 1 action.
    assert (params.train.num_envs, params.train.hidden) == (256, (64, 64))
    check_pipeline(mine, params)
    check_dependency(mine, params.task)
    assert (mine / ".git").is_dir()
    assert (mine / ".dvc").is_dir()
    assert not (mine / "porse").exists()


def test_a_folder_with_something_in_it_is_left_alone(mine, tmp_path):
    (tmp_path / "note").touch()
    done = CliRunner().invoke(main, ["init", str(tmp_path)], catch_exceptions=False)
    assert done.exit_code == 1
    assert f"expected an empty folder, or none, at {tmp_path}, found something in it; name another" in done.output
    assert [path.name for path in tmp_path.iterdir()] == ["note"]


@pytest.fixture
def edited(root, tmp_path, monkeypatch):
    """The files of this project, to edit them, as a checkout has them."""
    for name in (root / "porse" / "starter" / "files.txt").read_text().split():
        target = tmp_path / "checkout" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        (shutil.copytree if (root / name).is_dir() else shutil.copy)(root / name, target)
    monkeypatch.setattr("porse.init._CARRIED", tmp_path / "checkout")
    return tmp_path / "checkout"


def test_a_checkout_that_was_edited_starts_a_project_that_differs_by_the_edits(mine, edited, tmp_path):
    for name, before, after in (
        ("params.yaml", "task: Quadcopter\n", "task: Over   # for a while\n"),
        ("params.yaml", "generator: model\n", "generator: files\n"),
        ("params.yaml", "seed: 1\n", "seed: 7\n"),
        ("dvc.yaml", "      - porse\n", "      - others_tasks\n      - porse\n"),
    ):
        text = (edited / name).read_text()
        assert text.count(before) == 1
        (edited / name).write_text(text.replace(before, after))
    # An empty folder is as good as none.
    (tmp_path / "new").mkdir()
    make_project(tmp_path / "new")
    assert (tmp_path / "new" / "dvc.yaml").read_text() == (mine / "dvc.yaml").read_text()
    expected = (mine / "params.yaml").read_text().replace("seed: 1\n", "seed: 7\n").splitlines()
    text = (tmp_path / "new" / "params.yaml").read_text().splitlines()
    assert [line for line in text if line not in expected] == ["task: my_tasks.cart:CartPole # for a while"]
    assert len(text) == len(expected)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["checkout", "new"]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("params.yaml", "task: [", "expected YAML in {}/params.yaml"),
        ("params.yaml", "- 1\n", "expected the sections and keys of this project's file in {}/params.yaml"),
        ("params.yaml", "size: cpu\n", r"{}/params.yaml"),
        ("dvc.yaml", "stages: {}\n", "expected the sections and keys of this project's file in {}/dvc.yaml"),
    ],
)
def test_a_checkout_that_is_damaged_is_named_and_nothing_is_left_behind(edited, tmp_path, name, text, message):
    (edited / name).write_text(text)
    with pytest.raises(PorseError, match=re.escape(message.format(edited))):
        make_project(tmp_path / "new")
    assert [path.name for path in tmp_path.iterdir()] == ["checkout"]


def test_stages_depend_on_the_installed_package_under_the_names_of_a_checkout(mine, root):
    document = read_yaml(mine / "params.yaml")
    inputs = resolve_inputs(mine, document, "params.yaml")["train-population"].files
    assert {"my_tasks/cart.py", "my_tasks/cart.xml", "stages/train_population.py", "requirements.lock"} <= {*inputs}
    here = resolve_inputs(root, read_yaml(root / "params.yaml"), "params.yaml")["train-population"].files
    of_the_package = {name: digest for name, digest in inputs.items() if name.startswith("porse/")}
    assert len(of_the_package) > 20
    assert of_the_package == {name: here[name] for name in of_the_package}
    assert changed_files(mine, inputs) == []
    assert changed_files(mine, {**inputs, "porse/pool.py": "0" * 64}) == ["porse/pool.py"]


def test_the_code_of_a_suite_there_has_the_installed_package_in_it(mine, monkeypatch):
    before = code_id(mine, ["dvc.yaml"])
    assert code_id(mine, ["dvc.yaml"]) == before
    monkeypatch.setattr("porse.suite.resolve.sources", lambda root: "other")
    assert code_id(mine, ["dvc.yaml"]) != before


def test_the_task_of_the_contributing_page_is_the_one_of_a_new_project(root):
    page = (root / "CONTRIBUTING.md").read_text()
    for language, name in (("xml", "cart.xml"), ("python", "cart.py.txt")):
        block = re.search(rf"^```{language}\n(.*?)^```", page, re.DOTALL | re.MULTILINE)[1]
        assert block == (root / "porse" / "starter" / name).read_text()


def test_the_locked_versions_are_within_the_ranges_of_the_package(root):
    pins = re.findall(r"^([A-Za-z0-9._-]+)==([^\s;]+)", (root / "requirements.lock").read_text(), re.MULTILINE)
    locked = {canonicalize_name(name): version for name, version in pins}
    wanted = tomllib.loads((root / "pyproject.toml").read_text())["project"]["dependencies"]
    for requirement in map(Requirement, wanted):
        assert requirement.specifier.contains(locked[canonicalize_name(requirement.name)]), requirement
        assert "==" not in str(requirement.specifier)


@pytest.fixture(scope="module")
def installed(root, tmp_path_factory):
    """A folder with what an installed wheel has in it."""
    folder = tmp_path_factory.mktemp("wheel")
    files = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, text=True, check=True).stdout
    source = folder / "source"
    for name in filter(None, files.split("\0")):
        if (root / name).is_file() and not name.startswith(("tests/", "examples/", "docs/")):
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            (source / name).write_bytes((root / name).read_bytes())
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    run(folder, *command, "--wheel-dir", str(folder), str(source))
    with zipfile.ZipFile(next(folder.glob("*.whl"))) as wheel:
        wheel.extractall(folder / "site")
    return folder / "site"


def test_the_wheel_carries_what_a_project_needs(installed, root):
    for name in (root / "porse" / "starter" / "files.txt").read_text().split():
        carried = installed / "porse" / "project" / name
        files = [path for path in carried.rglob("*") if path.is_file()] if carried.is_dir() else [carried]
        assert files
        for path in files:
            assert path.read_bytes() == (root / path.relative_to(installed / "porse" / "project")).read_bytes()
    assert (installed / "porse" / "py.typed").is_file()
    assert (installed / "porse" / "tasks" / "quadcopter" / "scene.xml").is_file()


TINY = {
    "generate": {"candidates": 2, "elites": 1},
    "validate": {"probe_envs": 8, "probe_steps": 8},
    "train": {"num_envs": 8, "steps_per_epoch": 4, "rung_epochs": 1, "hidden": [8], "minibatches": 2},
    "mutate": {"pool": "eliminate-1", "mutants": 1},
    "fuse": {"pool": "eliminate-mutants"},
    "evaluate": {"seeds": 1, "episodes": 8},
}


def test_the_pipeline_of_an_installed_wheel_starts_with_the_package_as_it_is_there(installed, tmp_path):
    where = {"PYTHONPATH": str(installed)}
    run(tmp_path, *PORSE, "init", "mine", **where)
    project = tmp_path / "mine"
    # From a folder below, as everywhere.
    done = run(project / "my_tasks", *PORSE, "repro", "resolve", "begin", **where)
    assert re.findall(r"Running stage '([^']+)'", done.stdout) == ["resolve", "begin"]
    assert (project / "run" / "1" / "start" / "policies" / "random.safetensors").is_file()
    inputs = json.loads((project / "inputs" / "begin.json").read_text())["files"]
    checkpoint = (installed / "porse" / "checkpoint.py").read_bytes()
    assert inputs["porse/checkpoint.py"] == hashlib.sha256(checkpoint).hexdigest()


@pytest.mark.slow
def test_a_project_of_an_installed_wheel_runs_from_end_to_end_and_again_for_what_has_changed(installed, tmp_path):
    where = {"PYTHONPATH": str(installed)}
    run(tmp_path, *PORSE, "init", "mine", **where)
    project = tmp_path / "mine"
    document = yaml.safe_load((project / "params.yaml").read_text())
    for section, values in TINY.items():
        document[section] |= values
    document["iterations"] = [{"n": 1, "next": "result"}]
    document["rungs"] = [
        {"rung": 1, "pool": "validate-code", "until": 1, "keep": 1},
        {"rung": "mutants", "pool": "mutate", "until": 1, "keep": 1},
    ]
    (project / "params.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
    first = run(project, *PORSE, "repro", **where)
    assert re.findall(r"^\[(\d+/\d+)\]", first.stdout, re.MULTILINE)[-1] == "12/12"
    assert json.loads(run(project, *PORSE, "status", "--json", **where).stdout)["state"] == "finished"
    assert "Final success in 8 episodes" in run(project, *PORSE, "results", **where).stdout
    run(project, *PORSE, "report", **where)
    assert (project / "report.html").is_file()
    # The package changes: a stage that imports the changed module runs again, and none before it.
    module = installed / "porse" / "report" / "summary.py"
    module.write_text(module.read_text() + "\n# A comment.\n")
    second = run(project, *PORSE, "repro", **where)
    assert re.findall(r"^\[(\d+/\d+)\]", second.stdout, re.MULTILINE) == ["1/12", "12/12"]
