"""Layers import downwards only, and the `deps` of each stage cover what its script imports."""

import ast
import itertools
import re
from pathlib import Path

import pytest
import yaml

LAYERS: list[set[str]] = [
    {"errors", "identity", "processes", "variables"},
    {"methods", "conversion", "tables", "checkpoint"},
    {"config"},
    {"numerics", "prompts", "pool"},
    {"stage"},
    {"llm", "functions", "sim"},
    {"tasks", "exploration"},
    {"search"},
    {"training", "generation"},
    {"report", "check_code", "film", "task_probe"},
    {"show", "suite"},
    {"cli"},
]
"""Lowest first. A room may import rooms of lower layers, and of its own layer only itself."""

MAY_NOT: dict[str, set[str]] = {
    "llm": {"torch", "mujoco"},
    "search": {"torch", "mujoco", "porse.llm", "porse.functions", "porse.tasks"},
    "training": {"porse.llm", "porse.generation", "porse.functions.read"},
    "tasks": {"porse.llm", "porse.functions"},
    "functions": {"porse.llm", "porse.tasks", "porse.sim"},
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


def file_of(root: Path, module: str) -> Path | None:
    base = root.joinpath(*module.split("."))
    for path in (base.with_suffix(".py"), base / "__init__.py"):
        if path.is_file():
            return path
    return None


def transitive(root: Path, script: Path) -> set[Path]:
    """Returns the files of porse that a script imports, directly or not."""
    found: set[Path] = set()
    todo = [script]
    while todo:
        for name in imports(todo.pop()):
            parts = name.split(".")
            for depth in range(1, len(parts) + 1):
                path = file_of(root, ".".join(parts[:depth])) if parts[0] == "porse" else None
                if path is not None and path not in found:
                    found.add(path)
                    todo.append(path)
    return found


NO_RESULT = {
    "porse/__init__.py",
    "porse/functions/__init__.py",  # a sentence
    "porse/report/__init__.py",  # a sentence
    "porse/search/__init__.py",  # a sentence
    "porse/errors.py",  # the words of an error change no result
    "porse/stage.py",  # the command line
    "porse/config.py",  # values are tracked as params
    "porse/conversion.py",  # as above
    "porse/methods/__init__.py",  # the chosen sets are tracked as params
    "porse/methods/sets.py",  # as above
    "porse/identity.py",  # fixed by golden vectors in its test
    "porse/processes.py",  # who ends when
    "porse/variables.py",  # a dataclass without behaviour
}
"""Modules that every stage imports and that change no result; rewording them retrains nobody."""


def stages(root: Path) -> dict[str, dict]:
    found = yaml.safe_load((root / "dvc.yaml").read_text())["stages"]
    return {name: stage.get("do", stage) for name, stage in found.items()}


STAGES = [
    "begin", "generate", "validate-code", "train-population", "eliminate", "mutate", "fuse", "evaluate", "summarise",
]  # fmt: skip


def test_the_stages_are_these(root):
    assert list(stages(root)) == STAGES


@pytest.mark.parametrize("name", STAGES)
def test_the_deps_of_a_stage_cover_what_its_script_imports(root, name):
    stage = stages(root)[name]
    script = re.search(r"-m (stages\.\w+)", stage["cmd"])[1].replace(".", "/") + ".py"
    deps = [dep for dep in stage["deps"] if dep.startswith(("porse", "stages"))]
    assert script in deps
    assert all((root / dep).exists() for dep in deps)
    needed = {str(path.relative_to(root)) for path in transitive(root, root / script)} - NO_RESULT
    missing = [path for path in sorted(needed) if not any(path == dep or path.startswith(f"{dep}/") for dep in deps)]
    assert missing == []
    unused = [dep for dep in deps if not any(path == dep or path.startswith(f"{dep}/") for path in [*needed, script])]
    assert unused == []


@pytest.mark.parametrize("name", STAGES)
def test_every_path_in_a_command_is_a_dep_or_an_out(root, name):
    stage = stages(root)[name]
    outs = [out if isinstance(out, str) else next(iter(out)) for out in [*stage["outs"], *stage.get("metrics", [])]]
    words = stage["cmd"].split()
    for option, value in itertools.pairwise(words):
        if option in {"--iteration", "--rung", "--until", "--keep", "-m"} or not option.startswith("--"):
            continue
        assert value in [*stage["deps"], *outs], f"{option} {value}"


@pytest.mark.parametrize("name", STAGES)
def test_every_stage_takes_the_place_of_the_shell_that_starts_it(root, name):
    assert stages(root)[name]["cmd"].startswith("exec ${python} -m stages.")


@pytest.mark.parametrize("name", STAGES)
def test_every_stage_says_what_it_does_and_names_its_parameters(root, name):
    stage = stages(root)[name]
    assert stage["desc"]
    sections = yaml.safe_load((root / "params.yaml").read_text())
    sets, *names = stage["params"]
    assert sets == {"porse/methods/sets.py": ["METHODS.${method}", "ABLATIONS.${ablation}"]}
    assert {name.split(".")[0] for name in names} <= set(sections)


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
    for name in ("train_population", "evaluate"):
        needed = {str(path.relative_to(root)) for path in transitive(root, root / "stages" / f"{name}.py")}
        assert not [path for path in needed if path.startswith("porse/functions/read")]
        assert "porse/functions/run/execute.py" in needed
