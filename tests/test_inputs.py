"""What a stage depends on: the parameters that it reads, the files that it runs, and that both stay as they were."""

import dataclasses
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from porse.config import load_document, load_params, parse_part
from porse.documents import parse_yaml, render_yaml
from porse.errors import ParamsError
from porse.inputs.files import changed_files, stage_files
from porse.inputs.imports import imported_files
from porse.inputs.resolve import Inputs, check_unchanged, read_inputs, resolve_inputs
from porse.inputs.stages import NO_RESULT, STAGES
from porse.methods import METHODS
from porse.pipeline import check_dependency, check_pipeline, write_pipeline
from porse.task_names import TASK_CLASSES
from tiny import COPIED, ROOT, committed_params

CART = "class Cart:\n    EPISODE_LENGTH = 250\n    NUM_OBSERVATIONS = 4\n    NUM_ACTIONS = 1\n"
TRAININGS = ("train-population", "evaluate")


@pytest.fixture(scope="module")
def project(tmp_path_factory) -> Path:
    """A copy of the project's files, to change them."""
    folder = tmp_path_factory.mktemp("project")
    for name in (*COPIED, "params.yaml", "llm_cache/refreshed.txt"):
        (folder / name).parent.mkdir(exist_ok=True)
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, folder / name)
    return folder


def inputs_of(project: Path, **changed) -> dict[str, Inputs]:
    return resolve_inputs(project, {**load_document(project / "params.yaml"), **changed}, "params.yaml")


def concerned(project: Path, name: str) -> set[str]:
    """The stages whose inputs a further line in a file changes."""
    before, path = inputs_of(project), project / name
    text = path.read_text()
    try:
        path.write_text(f"{text}# a comment\n")
        after = inputs_of(project)
    finally:
        path.write_text(text)
    return {stage for stage in STAGES if before[stage] != after[stage]}


@pytest.mark.parametrize(
    "name",
    [
        "porse/tasks/pen/task.py",
        "porse/tasks/anymal/scene.xml",
        "porse/picture.py",
        "porse/cli.py",
        "porse/report/task_pages.py",
    ],
)
def test_a_comment_in_what_a_run_does_not_use_concerns_no_stage(project, name):
    assert concerned(project, name) == set()


@pytest.mark.parametrize(
    "name",
    ["porse/training/bar.py", "porse/errors.py", "porse/task_names.py", "porse/config.py", "porse/printing.py"],
)
def test_a_comment_in_what_changes_no_result_concerns_no_stage(project, name):
    assert concerned(project, name) == set()


def test_a_change_of_the_random_draws_concerns_every_stage_that_draws(project):
    assert concerned(project, "porse/identity.py") >= {
        *TRAININGS,
        "begin",
        "generate",
        "validate-code",
        "mutate",
        "fuse",
    }


def test_a_change_of_the_runs_own_task_concerns_every_stage_that_makes_it(project):
    for name in ("task.py", "scene.xml"):
        found = concerned(project, f"porse/tasks/quadcopter/{name}")
        assert found >= {*TRAININGS, "begin", "generate", "validate-code"}, name
        assert not found & {"eliminate", "summarise"}, name


def test_a_change_of_a_prompt_or_of_a_reader_of_replies_concerns_no_training(project):
    prompt = next((project / "prompts").glob("*.jinja")).relative_to(project).as_posix()
    assert concerned(project, prompt) == {"generate", "validate-code", "mutate"}
    assert not concerned(project, "porse/generation/answers.py") & set(TRAININGS)


def test_a_change_of_the_packages_concerns_every_stage(project):
    assert concerned(project, "requirements.lock") == set(STAGES)


def test_a_change_of_a_script_concerns_its_stage_alone(project):
    assert concerned(project, "stages/eliminate.py") == {"eliminate"}


def test_a_recorded_reply_is_no_input(project):
    files = {name for own in inputs_of(project).values() for name in own.files}
    assert {name for name in files if name.startswith("llm_cache")} == {"llm_cache/refreshed.txt"}


def test_a_refreshed_reply_concerns_the_stages_that_ask(project):
    assert concerned(project, "llm_cache/refreshed.txt") == {"generate", "validate-code", "mutate"}


def test_another_task_has_its_own_files_and_those_that_it_shares(project):
    files = inputs_of(project, task="Pen")["train-population"].files
    own = {f"porse/tasks/pen/{name}" for name in ("__init__.py", "scene.py", "task.py")}
    assert own | {"porse/tasks/base.py", "porse/tasks/hands/two_hands.py"} <= set(files)
    # Pictures and the environments of gymnasium are of no training.
    assert not {"porse/picture.py", "porse/gymnasium_front.py"} & set(files)


@pytest.mark.parametrize("task", TASK_CLASSES)
def test_a_task_has_the_files_of_its_folder_and_of_no_other_task(project, task):
    files = stage_files(project, STAGES["train-population"], task, ())
    folder = TASK_CLASSES[task].partition(":")[0].rpartition(".")[2]
    found = {name.split("/")[2] for name in files if name.startswith("porse/tasks/") and name.count("/") == 3}
    assert found - {"hands"} == {folder}
    there = {path for path in (project / "porse" / "tasks" / folder).iterdir() if path.is_file()}
    assert {path.relative_to(project).as_posix() for path in there} <= set(files)


def test_every_task_of_the_list_is_there(project):
    for task in TASK_CLASSES:
        stage_files(project, STAGES["begin"], task, ())


def test_a_task_of_ones_own_brings_all_that_is_in_its_folder(project):
    own = project / "my_tasks"
    own.mkdir()
    try:
        (own / "cart.py").write_text(f"from my_tasks import poles\n{CART}")
        (own / "poles.py").write_text("")
        (own / "cart.xml").write_text("<mujoco/>")
        files = inputs_of(project, task="my_tasks.cart:Cart")["train-population"].files
        assert {"my_tasks/cart.py", "my_tasks/poles.py", "my_tasks/cart.xml"} <= set(files)
        with pytest.raises(ParamsError, match="to depend on my_tasks"):
            check_dependency(project, "my_tasks.cart:Cart")
    finally:
        shutil.rmtree(own)


@pytest.mark.parametrize(("task", "says"), [("Quadcoper", "porse tasks"), ("my_tasks.cart:Cart", "no such file")])
def test_a_task_that_is_not_there_is_refused(project, task, says):
    with pytest.raises(ParamsError, match=says):
        inputs_of(project, task=task)


@pytest.mark.parametrize("task", ["Quadcopter", "Over"])
def test_words_in_a_preset_concern_no_stage(project, task):
    assert concerned(project, f"presets/{task}.yaml") == set()


def test_a_number_in_the_presets_of_other_tasks_and_sizes_concerns_no_stage_and_one_in_ones_own_those_that_read_it(
    project,
):
    def after(name: str, before: str, text: str) -> set[str]:
        path, first = project / "presets" / f"{name}.yaml", inputs_of(project)
        original = path.read_text()
        assert before in original
        path.write_text(original.replace(before, text))
        changed = {stage for stage, own in inputs_of(project).items() if own != first[stage]}
        path.write_text(original)
        return changed

    assert after("Over", "gamma: 0.96", "gamma: 0.9") == set()
    assert after("Quadcopter", "num_envs: 8192", "num_envs: 4096") == set()
    assert after("Quadcopter", "    window: 16", "    window: 7") == {"eliminate", "mutate", "fuse", "summarise"}


def test_a_stage_is_given_the_presets_values_and_no_null(project):
    for size, hidden, epochs in (("cpu", [256, 256, 128], 16), ("paper", [512, 256, 128], 500)):
        train = inputs_of(project, task="DoorOpenInward", size=size)["train-population"].parameters["train"]
        assert (train["hidden"], train["rung_epochs"], None in train.values()) == (hidden, epochs, False)


def test_what_is_named_as_without_a_result_is_there_and_imported(project):
    imported = set[str]()
    for stage in STAGES.values():
        script = project / f"{stage.script.replace('.', '/')}.py"
        imported |= {
            str(path.relative_to(project))
            for path in imported_files(script, {"porse": project, "stages": project}, frozenset())
        }
    missing = {name for name in NO_RESULT if name not in imported}
    assert missing <= {"stages/__init__.py"}
    assert (project / "stages/__init__.py").is_file()


def test_imports_are_found_in_functions_and_in_names_of_modules_but_not_for_types(tmp_path):
    (tmp_path / "pack").mkdir()
    for name in ("__init__", "a", "b", "c", "d", "e", "typed"):
        (tmp_path / "pack" / f"{name}.py").write_text("")
    start = tmp_path / "start.py"
    start.write_text(
        "from typing import TYPE_CHECKING\n"
        "from pack import a\n"
        "if TYPE_CHECKING:\n    from pack import typed\nelse:\n    import pack.e\n"
        "def f():\n    import pack.b\n"
        'PRELOAD = ["pack.c"]\n'
        'LATER = "pack.d:main"\n'
        'TEXT = "see pack.nothing. Or pack."\n'
    )
    found = imported_files(start, {"pack": tmp_path}, frozenset())
    assert {path.stem for path in found} == {"start", "__init__", "a", "b", "c", "d", "e"}


def test_a_module_that_is_no_python_is_named(tmp_path):
    (tmp_path / "pack").mkdir()
    (tmp_path / "pack" / "__init__.py").touch()
    (tmp_path / "pack" / "broken.py").write_text("x = 1\ndef f(:\n")
    (tmp_path / "start.py").write_text("import pack.broken\n")
    with pytest.raises(
        ParamsError, match=r"^expected Python in .*pack/broken\.py, found: .* \(broken\.py, line 2\); correct"
    ):
        imported_files(tmp_path / "start.py", {"pack": tmp_path}, frozenset())


def test_values_of_a_method_and_of_an_ablation_are_laid_over_the_file(project):
    own = inputs_of(project, method="eureka", ablation="weights-sum-to-1")
    assert own["eliminate"].parameters == {
        "numerics": "portable",
        "eliminate": {"keep": "all", "window": 16, "score": "max"},
    }
    assert own["train-population"].parameters["candidate"] == {"goal": "generated", "bonus": "none", "scale": 1.0}


def test_editing_a_set_that_is_not_chosen_concerns_no_stage(project, monkeypatch):
    before = inputs_of(project)
    monkeypatch.setitem(METHODS, "eureka", {"candidate": {"beta": 0.5}})
    assert inputs_of(project) == before


@pytest.mark.parametrize("values", [{"mutate": {"pool": "eliminate-1"}}, {"fuse": {"pool": "x"}}, {"rungs": {}}])
def test_a_set_cannot_replace_what_the_pipeline_is_written_from(project, monkeypatch, values):
    monkeypatch.setitem(METHODS, "mine", values)
    with pytest.raises(ParamsError, match=r"expected the method mine to leave (mutate\.pool|fuse\.pool|rungs) alone"):
        inputs_of(project, method="mine")


def test_a_stage_cannot_read_what_it_does_not_depend_on(project, tmp_path):
    path = tmp_path / "eliminate.json"
    path.write_text(inputs_of(project)["eliminate"].render())
    _, params = read_inputs(path)
    assert params.eliminate == load_params(project / "params.yaml").eliminate
    with pytest.raises(ParamsError, match="found it reading train of Params"):
        _ = params.train
    part = parse_part({"candidate": {"goal": "sparse"}, "exploration": {"lambda": 0.5}}, "x")
    assert (part.candidate.goal, part.exploration.lambda_) == ("sparse", 0.5)
    with pytest.raises(ParamsError, match="found it reading alpha of CandidateParams"):
        _ = part.candidate.alpha
    assert part.with_seed(7).seed == 7


def test_a_part_is_checked_like_the_whole():
    with pytest.raises(ParamsError, match=re.escape("train.gamma to be a number in [0, 1], found 3.0")):
        parse_part({"train": {"gamma": 3.0}}, "x")
    with pytest.raises(ParamsError, match="gama"):
        parse_part({"train": {"gama": 3.0}}, "x")


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"parameters": {}}'])
def test_what_is_no_inputs_is_refused(tmp_path, text):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(ParamsError, match="found something else"):
        read_inputs(tmp_path / "a.json")


def test_inputs_that_change_under_a_stage_are_noticed(tmp_path):
    (tmp_path / "a.py").write_text("1")
    (tmp_path / "b.py").write_text("2")
    files = {"a.py": "6b86b273ff34fce19d6b804eff5a3f5747ada4eaa22f1d49c01e52ddb7875b4b", "b.py": ""}
    assert changed_files(tmp_path, files) == ["b.py"]
    path = tmp_path / "inputs.json"
    inputs = Inputs({}, {"a.py": files["a.py"]})
    path.write_text(inputs.render())
    check_unchanged(tmp_path, path, inputs, "now")
    path.write_text(Inputs({"seed": 2}, inputs.files).render())
    with pytest.raises(ParamsError, match=r"found .*inputs\.json changed now"):
        check_unchanged(tmp_path, path, inputs, "now")
    path.write_text(inputs.render())
    (tmp_path / "a.py").write_text("2")
    with pytest.raises(ParamsError, match=r"found a\.py changed now"):
        check_unchanged(tmp_path, path, inputs, "now")


STAGE = """
import click
from pathlib import Path
from porse.stage import StageCommand, begin, folder, run_stage

@click.command(cls=StageCommand)
@folder("out")
def main(out):
    params = begin()
    out.write_text(str(params.eliminate.window))
    {meanwhile}

if __name__ == "__main__":
    run_stage(main)
"""


@pytest.mark.parametrize(
    ("meanwhile", "says"),
    [
        ("pass", None),
        ('Path("porse/pool.py").write_text("changed")', "found porse/pool.py changed while the stage ran"),
        ('Path("inputs.json").write_text("{}")', "found inputs.json changed while the stage ran"),
        ("params.train", "found it reading train of Params"),
    ],
)
def test_a_stage_whose_inputs_change_while_it_runs_fails(project, tmp_path, meanwhile, says):
    (tmp_path / "porse").mkdir()
    shutil.copy(project / "porse" / "pool.py", tmp_path / "porse")
    own = inputs_of(project)["eliminate"]
    kept = Inputs(own.parameters, {"porse/pool.py": own.files["porse/pool.py"]})
    (tmp_path / "inputs.json").write_text(kept.render())
    (tmp_path / "script.py").write_text(STAGE.format(meanwhile=meanwhile))
    command = [sys.executable, "-P", "script.py", "--inputs", "inputs.json", "--out", "out"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode == 0) == (says is None), done.stderr
    assert "Traceback" not in done.stderr
    assert says is None or says in done.stderr


def test_a_stage_refuses_code_that_is_not_what_its_inputs_say(project, tmp_path):
    own = inputs_of(project)["eliminate"]
    (tmp_path / "inputs.json").write_text(own.render())
    (tmp_path / "script.py").write_text(STAGE.format(meanwhile="pass"))
    command = [sys.executable, "-P", "script.py", "--inputs", "inputs.json", "--out", "out"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 1
    assert "changed since stage resolve wrote them down" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "value"),
    [("010", 10), ("0o10", 8), ("1e-3", 0.001), ("yes", "yes"), ("12:30", "12:30"), ("1_000", 1000), ("0x10", 16)],
)
def test_yaml_is_read_as_dvc_reads_it(text, value):
    from dvc.utils.serialize import parse_yaml as dvc_reads

    assert parse_yaml(f"seed: {text}", "x") == {"seed": value} == dvc_reads(f"seed: {text}", "x")


@pytest.mark.parametrize(
    "text", ["a: 1\na: 2", "a: [", "a: \x01", "a: !!python/object:x {}", "a: 1" + "0" * 5000, "[" * 20000]
)
def test_what_is_no_yaml_is_one_paragraph(text):
    with pytest.raises(ParamsError, match="expected YAML in x, found"):
        parse_yaml(text, "x")


def test_parameters_that_are_written_are_read_as_the_same(project):
    document = {**committed_params(), "odd": ["0o10", "010", "yes", "1e5", 1e-7, None, {}, ""]}
    assert parse_yaml(render_yaml(document), "x") == document


def test_the_pipeline_follows_the_parameters(tmp_path):
    (tmp_path / "iterations").mkdir()
    shutil.copy(ROOT / "iterations" / "dvc.yaml.jinja", tmp_path / "iterations")
    params = load_params(ROOT / "params.yaml", ROOT)
    assert write_pipeline(tmp_path, params) == [f"iterations/{n}/dvc.yaml: written" for n in range(1, 6)]
    assert write_pipeline(tmp_path, params) == []
    check_pipeline(tmp_path, params)
    shutil.copytree(tmp_path / "iterations" / "5", tmp_path / "iterations" / "6")
    with pytest.raises(ParamsError, match="expected iterations/6 to be what iterations"):
        check_pipeline(tmp_path, params)
    assert write_pipeline(tmp_path, params) == ["iterations/6: removed"]
    (tmp_path / "iterations" / "2" / "dvc.yaml").write_text("stages: {}\n")
    with pytest.raises(ParamsError, match=r"expected iterations/2/dvc\.yaml"):
        check_pipeline(tmp_path, params)


def test_what_is_no_more_leaves_the_lock_and_the_workspace_and_the_rest_stays_byte_for_byte(tmp_path):
    params = load_params(ROOT / "params.yaml", ROOT)
    shutil.copytree(ROOT / "iterations", tmp_path / "iterations")
    locks = [tmp_path / "iterations" / str(n) / "dvc.lock" for n in range(1, 6)]
    texts = [lock.read_text() for lock in locks]
    # As DVC left them: the train-population and eliminate of each rung, one entry after the other.
    kept = [re.sub(r"(?m)^  (train-population|eliminate)-2:\n(    .*\n)+", "", text) for text in texts]
    assert all(text.count("\n") > short.count("\n") > 100 for text, short in zip(texts, kept, strict=True))
    outs = ["1/train-2", "1/train-3", "1/start", "4/eliminate-2", "5/start", "5/mutate", "result/start", "notes"]
    for out in outs:
        (tmp_path / "run" / out).mkdir(parents=True)
    entries = [
        dataclasses.replace(entry, next=entry.next if entry.n < 4 else "result") for entry in params.iterations[:4]
    ]
    rungs = [rung for rung in params.rungs if rung.rung != 2]
    shorter = dataclasses.replace(params, iterations=entries, rungs=rungs)
    # Iteration 5 is gone, too, and iteration 4 no longer makes its start.
    assert write_pipeline(tmp_path, shorter) == [
        "run/1/train-2: removed, no stage makes it any more",
        "iterations/1/dvc.lock: train-population-2, eliminate-2 removed",
        "iterations/2/dvc.lock: train-population-2, eliminate-2 removed",
        "iterations/3/dvc.lock: train-population-2, eliminate-2 removed",
        "run/4/eliminate-2: removed, no stage makes it any more",
        "run/5/start: removed, no stage makes it any more",
        "iterations/4/dvc.lock: train-population-2, eliminate-2 removed",
        "run/5/mutate: removed, no stage makes it any more",
        *(f"iterations/{n}/dvc.yaml: written" for n in range(1, 5)),
        "iterations/5: removed",
    ]
    assert [lock.read_text() for lock in locks[:4]] == kept[:4]
    assert [out for out in outs if (tmp_path / "run" / out).exists()] == [
        "1/train-3",
        "1/start",
        "result/start",
        "notes",
    ]
    assert write_pipeline(tmp_path, shorter) == []


@pytest.mark.parametrize(
    "text", ["", "[]\n", "stages:\n  fuse: 1\n", "stages: {fuse: {outs: [{path: ../out}]}}\n", "<<<<<<< \n"]
)
def test_a_lock_that_is_none_and_what_lies_elsewhere_stay_as_they_are(tmp_path, params, text):
    project = tmp_path / "project"
    shutil.copytree(ROOT / "iterations", project / "iterations")
    (tmp_path / "out").mkdir()
    lock = project / "iterations" / "1" / "dvc.lock"
    lock.write_text(text)
    assert write_pipeline(project, params) == []
    assert (lock.read_text(), (tmp_path / "out").is_dir()) == (text, True)


def test_params_prints_what_a_stage_reads_and_where_it_comes_from(project):
    from click.testing import CliRunner

    from porse.cli import main

    changed = project / "human.yaml"
    changed.write_text((project / "params.yaml").read_text().replace("method: porse", "method: human"))
    done = CliRunner().invoke(
        main, ["params", "--params", str(changed), "--stage", "eliminate"], catch_exceptions=False
    )
    assert done.output.splitlines() == [
        'numerics: "portable"',
        'eliminate.keep: "all"  # method human',
        'eliminate.score: "mean"',
        "eliminate.window: 16  # preset Quadcopter cpu",
    ]
    everything = CliRunner().invoke(main, ["params", "--params", str(changed)], catch_exceptions=False).output
    assert "candidate.scale: 1.0  # method human\n" in everything
    assert json.loads(everything.split("train.hidden: ")[1].split("  # ")[0]) == [64, 64]
