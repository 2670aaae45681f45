"""Layers import downwards only, and every stage in a `dvc.yaml` is what the others expect it to be."""

import ast
import itertools
import re
from pathlib import Path

import pytest
import yaml

from porse.inputs.files import stage_files
from porse.inputs.stages import STAGES
from porse.pipeline import check_pipeline

LAYERS: list[set[str]] = [
    {"errors", "helpers", "identity", "processes", "quiet_dvc", "task_names", "variables"},
    {"paths", "printing", "renderer"},
    {"methods", "conversion", "documents", "tables", "checkpoint"},
    {"presets"},
    {"config"},
    {"inputs", "numerics", "prompts", "pool"},
    {"stage", "pipeline", "warm"},
    {"llm", "functions", "sim", "outdated"},
    {"tasks", "exploration"},
    {"search"},
    {"training", "generation", "picture"},
    {"report", "check_code", "llm_estimate", "film", "gymnasium_front", "task_probe"},
    {"steps"},
    {"iteration", "plan", "repair"},
    {"estimate", "repro", "schema"},
    {"show", "status", "suite"},
    {"comparison"},
    {"doctor", "demo", "experiments", "export", "init", "published"},
    {"commands"},
    {"bench"},
    {"cli"},
]
"""Lowest first. A room may import rooms of lower layers, and of its own layer only itself."""

MAY_NOT: dict[str, set[str]] = {
    "llm": {"torch", "mujoco"},
    "search": {"torch", "mujoco", "porse.llm", "porse.functions", "porse.tasks"},
    "training": {"porse.llm", "porse.generation", "porse.functions.read"},
    "tasks": {"porse.llm", "porse.functions"},
    "functions": {"porse.llm", "porse.tasks", "porse.sim"},
    "presets": {"torch", "mujoco", "porse.tasks"},
    "errors": {"torch", "mujoco", "pyarrow", "numpy", "yaml", "click"},
    "identity": {"torch", "mujoco", "pyarrow", "numpy", "yaml", "click"},
    "tables": {"torch", "mujoco"},
}


def modules(root: Path) -> list[Path]:
    return sorted((root / "porse").rglob("*.py"))


def imports(path: Path) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def room(module: str) -> str:
    return module.split(".")[1] if "." in module else ""


def layer(name: str) -> int:
    return next(index for index, rooms in enumerate(LAYERS) if name in rooms)


def room_of(path: Path, root: Path) -> str:
    return path.relative_to(root / "porse").parts[0].removesuffix(".py")


def test_every_room_has_a_layer(root):
    rooms = {room_of(path, root) for path in modules(root)} - {"__init__"}
    assert rooms == set().union(*LAYERS)


def test_layers_import_downwards_only(root):
    wrong = []
    for path in modules(root):
        own = room_of(path, root)
        if own == "__init__":
            continue
        for name in imports(path):
            other = room(name) if name.startswith("porse.") else ""
            if not other or other == own or other == "__version__":
                continue
            if layer(other) >= layer(own):
                wrong.append(f"{path.relative_to(root)} imports {name}")
    assert wrong == []


def test_rooms_do_not_import_what_they_must_not_know(root):
    wrong = []
    for path in modules(root):
        for banned in MAY_NOT.get(room_of(path, root), set()):
            wrong += [
                f"{path.relative_to(root)} imports {name}"
                for name in imports(path)
                if name == banned or name.startswith(f"{banned}.")
            ]
    assert wrong == []


def test_nothing_imports_the_stages(root):
    for path in [*modules(root), *(root / "stages").glob("*.py")]:
        assert not any(name.split(".")[0] == "stages" for name in imports(path)), path


def stages(root: Path) -> dict[str, dict]:
    """The stages of the root and of iteration 2, by name."""
    files = (root / "dvc.yaml", root / "iterations" / "2" / "dvc.yaml")
    return {name: stage for path in files for name, stage in yaml.safe_load(path.read_text())["stages"].items()}


NAMES = list(stages(Path(__file__).resolve().parent.parent))


def test_every_kind_of_stage_is_declared(root):
    kinds = {re.sub(r"^(train-population|eliminate)-.*", r"\1", name) for name in NAMES}
    assert kinds == {*STAGES, "resolve"}


@pytest.mark.parametrize("name", NAMES)
def test_a_stage_depends_on_its_inputs_and_on_folders_of_other_stages(root, name):
    stage = stages(root)[name]
    if name == "resolve":
        assert stage["outs"] == [f"inputs/{kind}.json" for kind in sorted(STAGES)]
        return
    kind = next(kind for kind in STAGES if name == kind or name.startswith(f"{kind}-"))
    assert f" -m {STAGES[kind].script} --inputs inputs/{kind}.json " in stage["cmd"]
    first, *others = stage["deps"]
    assert first == f"inputs/{kind}.json"
    assert all(dep.split("/")[0] in {"run", "evaluation"} for dep in others)


@pytest.mark.parametrize("name", NAMES)
def test_every_path_in_a_command_is_a_dep_or_an_out(root, name):
    stage = stages(root)[name]
    outs = [out if isinstance(out, str) else next(iter(out)) for out in [*stage["outs"], *stage.get("metrics", [])]]
    # Recorded replies never change, and prompts are among the inputs.
    known = {*stage["deps"], *outs, "llm_cache", "prompts"} | ({"inputs"} if name == "resolve" else set())
    words = stage["cmd"].split()
    for option, value in itertools.pairwise(words):
        if option in {"--iteration", "--rung", "--until", "--keep", "-m"} or not option.startswith("--"):
            continue
        assert value in known, f"{option} {value}"
    assert all(f" {path}" in stage["cmd"] for path in [*stage["deps"], *outs] if name != "resolve")


@pytest.mark.parametrize("name", NAMES)
def test_every_stage_takes_the_place_of_the_shell_that_starts_it(root, name):
    assert stages(root)[name]["cmd"].startswith("exec sh stages/python.sh -m stages.")


@pytest.mark.parametrize("name", NAMES)
def test_every_stage_says_what_it_does_and_runs_at_the_root(root, name):
    stage = stages(root)[name]
    assert stage["desc"]
    assert "params" not in stage
    in_iteration = name in yaml.safe_load((root / "iterations" / "2" / "dvc.yaml").read_text())["stages"]
    assert stage.get("wdir") == ("../.." if in_iteration else None)


def test_the_pipeline_is_that_of_the_committed_parameters(root, params):
    check_pipeline(root, params)


def test_every_module_says_what_it_holds(root):
    for path in [*modules(root), *(root / "stages").glob("*.py")]:
        assert ast.get_docstring(ast.parse(path.read_text())), path


RUNS_TEXT = {"porse/functions/read/runnable.py": "exec"}
"""Where generated text is run, in a confined process, after the static check."""


def test_nothing_reads_a_pickle_or_runs_text_but_the_one_place_that_is_for_it(root):
    banned = {"pickle", "dill", "cloudpickle", "marshal", "shelve", "joblib"}
    for path in [*modules(root), *(root / "stages").glob("*.py")]:
        assert not {name.split(".")[0] for name in imports(path)} & banned, path
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call):
                called = ast.unparse(node.func)
                allowed = RUNS_TEXT.get(str(path.relative_to(root)), "")
                banned_calls = {"exec", "eval", "torch.load", "torch.save"} - {allowed}
                assert called not in banned_calls, f"{path}:{node.lineno}"


def test_training_reads_no_text_of_a_model(root):
    """What a candidate is trained with is its operator list: how replies are read changes no training."""
    for name in ("train-population", "evaluate"):
        needed = stage_files(root, STAGES[name], "Quadcopter", ())
        assert not [path for path in needed if path.startswith("porse/functions/read")]
        assert "porse/functions/run/execute.py" in needed


def test_the_room_of_generated_code_stays_small(root):
    lines = sum(len(path.read_text().splitlines()) for path in (root / "porse" / "functions").rglob("*.py"))
    # 3 000 were set when 84 lines of what is porse/helpers.py today, the originals' helpers, stood in the room.
    assert lines <= 3000 - 84, "find the idea that makes a part needless: docs/decisions.md says what was tried"


PRINTS = {
    "porse/printing.py": "all that people see",
    "porse/published/check.py": "a protocol: the process that started it reads its lines",
    "porse/training/bar.py": "bars, and names and reasons that the program gives",
    "porse/training/local.py": "what a training prints",
    "porse/training/remote.py": "what a training prints",
    "porse/warm/client.py": "a sentence of its own",
}
"""Who prints by itself, and what."""

PRINTING = {"print", "click.echo", "click.secho", "click.echo_via_pager", "sys.stdout.write", "sys.stderr.write"}


def test_all_that_is_printed_goes_through_the_one_place_that_writes_control_characters_out(root):
    found = {
        str(path.relative_to(root))
        for path in [*modules(root), *(root / "stages").glob("*.py")]
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call | ast.Attribute)
        and ast.unparse(node.func if isinstance(node, ast.Call) else node) in PRINTING
    }
    assert found == {*PRINTS}
