"""A task of one's own: the worked example of CONTRIBUTING.md in a folder of its own, and what is refused."""

import ctypes.util
import os
import re
import subprocess
import sys
from pathlib import Path

import imageio.v3 as imageio
import pytest
import torch
import yaml

from code_cases import traced, variable
from porse import tables
from porse.errors import TaskError
from porse.pipeline import check_dependency
from porse.pool import policy_file, read_pool, write_pool
from porse.tasks import find_task, make_task
from tiny import write_inputs

NAME = "my_tasks.cart:CartPole"
REWARD = """def compute_reward(pole_angle: torch.Tensor, cart_pos: torch.Tensor):
    upright = torch.exp(-pole_angle.abs() / 0.1)
    middle = -0.1 * cart_pos * cart_pos
    return upright + middle, {"upright": upright, "middle": middle}
"""
RENDERERS = [name for name in ("EGL", "OSMesa") if ctypes.util.find_library(name)]
OFFERED = [variable("pole_angle"), variable("cart_pos")]
MAPPING = "def mapping_function(self):\n    return [self.pole_angle.abs()], [False], ['angle']\n"


@pytest.fixture(scope="module")
def project(root, tmp_path_factory) -> Path:
    """Returns a folder with the example's files, a tiny params.yaml, and a reward and a mapping."""
    folder = tmp_path_factory.mktemp("project")
    text = (root / "CONTRIBUTING.md").read_text(encoding="utf-8")
    for path, content in re.findall(r"^`(my_tasks/[\w.]+)`:\n\n```\w+\n(.*?)^```$", text, re.DOTALL | re.MULTILINE):
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_text(content, encoding="utf-8")
    params = yaml.safe_load((root / "params.yaml").read_text(encoding="utf-8"))
    params["task"] = NAME
    params["train"] |= {"num_envs": 8, "steps_per_epoch": 8, "rung_epochs": 2, "hidden": [8], "minibatches": 2}
    (folder / "params.yaml").write_text(yaml.safe_dump(params), encoding="utf-8")
    (folder / "reward.py").write_text(REWARD, encoding="utf-8")
    (folder / "mapping.py").write_text(MAPPING, encoding="utf-8")
    return folder


@pytest.fixture
def inside(project, monkeypatch) -> Path:
    """Runs the test in the project's folder; what it imports from there is forgotten afterwards."""
    monkeypatch.chdir(project)
    monkeypatch.setattr(sys, "path", [*sys.path])
    yield project
    for module in [name for name in sys.modules if name.split(".")[0] in ("my_tasks", "mine")]:
        del sys.modules[module]


def run(root, project, *command) -> str:
    """Returns what a Python program prints, run in the project's folder as a user would."""
    environment = {key: value for key, value in os.environ.items() if key != "DISPLAY"} | {"PYTHONPATH": str(root)}
    done = subprocess.run(
        [sys.executable, *command], cwd=project, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


PORSE = ("-P", "-c", "from porse.cli import main; main()")
"""As the installed command runs it: the folder is not on the path."""


def test_the_example_is_short(project):
    lines = (project / "my_tasks" / "cart.py").read_text(encoding="utf-8").splitlines()
    assert len(lines) < 80


def test_the_example_balances_or_falls_as_its_physics_say(inside):
    task = make_task(NAME, 3, seed=1)
    # A control step of 0.02 s in 2 substeps, whatever the scene's file says.
    assert task._physics.model.opt.timestep == 0.01
    before = task.variables()["pole_angle"]
    assert float(before.abs().max()) <= 0.1
    for _ in range(40):
        task.step(torch.ones(3, 1))
    # A cart that is pushed to +x leaves its pole behind.
    assert bool(task.failed().all())
    assert bool((task.cart_pos > 0.3).all())
    assert bool((task.pole_angle < -0.5).all())
    assert task.fitness() == 0.0
    task.reset(task.terminated())
    assert task.fitness() == 1.0
    assert torch.equal(task.human_reward(), task.sparse_reward())


def test_the_example_continues_exactly_from_a_state(inside):
    one, two = make_task(NAME, 2, seed=1), make_task(NAME, 2, seed=2)
    one.step(torch.ones(2, 1))
    two.load_state(one.state())
    for task in (one, two):
        task.step(-torch.ones(2, 1))
        task.reset(torch.tensor([True, False]))
    assert torch.equal(one.observations(), two.observations())


def test_the_example_is_shown_to_a_model_as_it_is(inside):
    source = find_task(NAME).observation_source()
    assert "class CartPole:\n    # 1 actions in [-1, 1], control step 0.02 s." in source
    assert "# self.pole_angle: (num_envs,), rad, joint frame: angle of the pole" in source
    assert "    def compute_observations(self) -> Tensor:\n        return torch.stack(" in source


def test_check_code_finds_the_example_from_its_folder(root, project):
    said = run(root, project, *PORSE, "check-code", NAME, "--reward", "reward.py", "--mapping", "mapping.py")
    assert said.splitlines() == ["reward.py: accepted: upright, middle", "mapping.py: accepted: angle falls"]


@pytest.fixture(scope="module")
def trained(root, project) -> Path:
    """Returns the pool that the first stage and a rung, with a process for each candidate, leave."""
    for name in ("porse", "stages", "prompts", "llm_cache", "requirements.lock"):
        (project / name).symlink_to(root / name)
    write_inputs(project)
    run(root, project, "-m", "stages.begin", "--inputs", "inputs/begin.json", "--out", "run/1/start")
    start = next((project / "run" / "1" / "start").rglob("*.safetensors"))
    row = {
        "iteration": 1, "slot": 0, "candidate_id": "one", "origin": "new", "parent_id": "", "reward_key": "",
        "mapping_key": "", "reward_source": REWARD, "mapping_source": MAPPING,
        "reward_program": traced(REWARD, "reward", OFFERED).text,
        "mapping_program": traced(MAPPING, "mapping", OFFERED).text, "beta": 1.0, "alpha": 0.8, "draw": 0,
        "policy": "fused", "epochs": 0, "failure": "",
    }  # fmt: skip
    write_pool(project / "pool", [row, {**row, "candidate_id": "two", "slot": 1, "beta": 0.5}], [], {"fused": start})
    rung = ("--iteration", "1", "--rung", "1", "--until", "1", "--pool", "pool", "--out", "trained")
    run(root, project, "-m", "stages.train_population", "--inputs", "inputs/train-population.json", *rung)
    return project / "trained"


def test_stages_train_the_example(trained):
    assert [(row["epochs"], row["failure"]) for row in read_pool(trained).candidates] == [(2, ""), (2, "")]
    curves = tables.read(trained / "curves.parquet", tables.CURVES)
    assert {"fitness", "component/upright", "progress/angle"} <= {row["series"] for row in curves}


@pytest.mark.skipif(not RENDERERS, reason="needs EGL or OSMesa: install libegl1 or libosmesa6")
def test_the_example_is_drawn_and_a_trained_policy_of_it_is_shown(root, project, trained):
    assert run(root, project, *PORSE, "render", NAME, "--out", "cart.png") == "cart.png: CartPole\n"
    # The cart is blue and the floor grey.
    pixels = imageio.imread(project / "cart.png").astype(int)
    assert int((pixels[..., 2] > pixels[..., 0] + 40).sum()) > 500
    policy = policy_file(trained, "two")
    said = run(root, project, *PORSE, "play", NAME, "--checkpoint", str(policy), "--seconds", "0.2")
    assert said == "CartPole.gif: CartPole, 0.2 s\n"
    assert (project / "CartPole.gif").read_bytes().startswith(b"GIF89a")


def test_the_example_has_a_gymnasium_front(inside):
    from porse.gymnasium_front import TaskVectorEnv

    env = TaskVectorEnv(NAME, 2)
    observations, _ = env.reset(seed=1)
    assert env.observation_space.contains(observations)
    assert env.step(env.action_space.sample())[1].shape == (2,)


def test_the_recipe_gives_the_folder_to_the_stage_that_looks_for_changes(root, project, tmp_path):
    recipe = re.search(r"^sed -i '(.*)' dvc\.yaml$", (root / "CONTRIBUTING.md").read_text(), re.MULTILINE)[1]
    edited = subprocess.run(["sed", recipe, root / "dvc.yaml"], capture_output=True, text=True, check=True).stdout
    stages = yaml.safe_load(edited)["stages"]
    assert [name for name, stage in stages.items() if "my_tasks" in stage["deps"]] == ["resolve"]
    (tmp_path / "dvc.yaml").write_text(edited)
    check_dependency(tmp_path, NAME)


WRONG = """
from porse.tasks.base import Task
number = 3
class Half(Task):
    NAME = "Half"
    def _start(self, ids): pass
class Plain: pass
"""


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("mine:Half", "found no _act, _measure, compute_observations, fitness, scene, sparse_reward, DESCRIPTION,"),
        ("mine:Haf", r"the class Haf in .*mine\.py, found none; it has Half"),
        ("mine:Plain", "a class on porse.tasks.base.Task, found <class 'mine.Plain'>"),
        ("mine:number", "a class on porse.tasks.base.Task, found 3"),
        ("nowhere.at.all:Task", r"the module nowhere\.at\.all .* nowhere/at/all\.py"),
        ("my_tasks.car:CartPole", r"the module my_tasks\.car "),
        ("my_tasks/cart.py:CartPole", r'"module:Class"'),
        (":CartPole", r'"module:Class"'),
        ("my_tasks.cart:", r'"module:Class"'),
    ],
)
def test_a_name_that_is_no_task_is_answered_with_what_was_found(inside, name, says):
    (inside / "mine.py").write_text(WRONG, encoding="utf-8")
    with pytest.raises(TaskError, match=says):
        find_task(name)


FAULTS = {
    "syntax": ("_act(self) -> None:", "_act(self) -> None", "be imported, found SyntaxError: expected ':'"),
    "import": (
        "import torch\n", "import no_torch\n", "be imported, found ModuleNotFoundError: No module named 'no_torch'",
    ),
    "class": ("ACTIONS = 1", "ACTIONS = one", "be imported, found NameError: name 'one' is not defined"),
    "no scene": ('"cart.xml"', '"card.xml"', "give a scene that MuJoCo compiles, found ValueError: .*card.xml'"),
    "constructor": ("._uniform(", "._unifrom(", "start its episodes, found AttributeError: .* no attribute '_unifrom'"),
    "measure": (".velocities()", ".velocity()", "start its episodes, found AttributeError: .* no attribute 'velocity'"),
    "failed": ("return self.pole", "return slef.pole", "start its episodes, found NameError: name 'slef' is not defined"),
    "observations": (
        "self.pole_vel), dim", "self.pole_vel[:1]), dim", "start its episodes, found RuntimeError: stack expects",
    ),
    "step": (
        "self.actions.", "self.action.",
        r"take a step with actions \(3, 1\), by its NUM_ACTIONS, in a scene with nu = 1, found AttributeError: .* 'action'",
    ),
    "reset": (
        "-0.1, 0.1, len(ids)", "-0.1, 0.1, 3",
        r"start an episode anew, found RuntimeError: shape mismatch: value tensor of shape \[3\]",
    ),
}  # fmt: skip
"""What stands in the example, what a user wrote instead, and what is said of it."""


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_in_a_users_code_is_told_in_pythons_words_with_its_line(inside, fault):
    right, wrong, says = FAULTS[fault]
    text = (inside / "my_tasks" / "cart.py").read_text(encoding="utf-8")
    assert text.count(right) == 1
    (inside / "my_tasks" / "faulty.py").write_text(text.replace(right, wrong), encoding="utf-8")
    line = 1 + text[: text.index(right)].count("\n")
    with pytest.raises(
        TaskError, match=rf"^expected my_tasks\.faulty:CartPole to {says}.*, at my_tasks/faulty\.py:{line}; mend it$"
    ):
        make_task("my_tasks.faulty:CartPole", 2, seed=0)


def test_an_action_too_many_is_told_with_the_size_of_the_scene(inside):
    text = (inside / "my_tasks" / "cart.py").read_text(encoding="utf-8")
    (inside / "my_tasks" / "faulty.py").write_text(text.replace("NUM_ACTIONS = 1", "NUM_ACTIONS = 2"), encoding="utf-8")
    with pytest.raises(TaskError, match=r"actions \(3, 2\), by its NUM_ACTIONS, in a scene with nu = 1, found Runtime"):
        make_task("my_tasks.faulty:CartPole", 2, seed=0)


@pytest.mark.parametrize(
    ("right", "wrong", "says"),
    [
        ("</mujoco>", "</mujoko>", r"found ValueError: XML parse error .*, at my_tasks/faulty\.py:39; mend it"),
        # MuJoCo reads it in a call of the package's own.
        (
            'joint="rail"',
            'joint="rial"',
            r"found ValueError: Error: unknown transmission target 'rial' .* line 18; mend",
        ),
    ],
)
def test_a_wrong_scene_is_told_in_mujocos_words(inside, right, wrong, says):
    for kind in ("py", "xml"):
        text = (inside / "my_tasks" / f"cart.{kind}").read_text(encoding="utf-8").replace("cart.xml", "faulty.xml")
        (inside / "my_tasks" / f"faulty.{kind}").write_text(text.replace(right, wrong), encoding="utf-8")
    with pytest.raises(TaskError, match=f"to give a scene that MuJoCo compiles, {says}"):
        find_task("my_tasks.faulty:CartPole")


def test_a_lack_of_memory_is_no_fault_of_the_users_code(inside):
    (inside / "mine.py").write_text("raise MemoryError\n", encoding="utf-8")
    with pytest.raises(MemoryError):
        find_task("mine:Half")


def test_commands_say_where_a_users_code_is_wrong_without_a_traceback(root, project):
    text = (project / "my_tasks" / "cart.py").read_text(encoding="utf-8")
    (project / "my_tasks" / "slip.py").write_text(text.replace("self.actions.", "self.action."), encoding="utf-8")
    name, environment = "my_tasks.slip:CartPole", os.environ | {"PYTHONPATH": str(root)}
    for command in (
        ["render", name, "--out", "cart.png"],
        ["check-code", name, "--reward", "reward.py"],
    ):
        done = subprocess.run(
            [sys.executable, *PORSE, *command],
            cwd=project,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 1
        assert " ".join(done.stderr.split()).endswith("has no attribute 'action', at my_tasks/slip.py:46; mend it")


def test_a_class_that_does_not_keep_what_it_says_is_refused_with_all_that_differs(inside):
    changes = """
from my_tasks.cart import CartPole
from porse.variables import Variable
class Wrong(CartPole):
    NAME, NUM_OBSERVATIONS = "Wrong", 5
    VARIABLES = (*CartPole.VARIABLES, Variable("pole_tip", "tensor", (3,), "m", "world", "the tip"))
    def failed(self):
        return self.pole_angle
    def fitness(self):
        return 1
    def sparse_reward(self):
        super().sparse_reward()
"""
    (inside / "mine.py").write_text(changes, encoding="utf-8")
    with pytest.raises(TaskError) as refusal:
        make_task("mine:Wrong", 2, seed=0)
    said = str(refusal.value)
    assert "no attribute pole_tip after a reset" in said
    assert "compute_observations returns (3, 4) of torch.float32 in place of (3, 5)" in said
    assert "failed returns (3,) of torch.float32 in place of (3,) of torch.bool" in said
    assert "sparse_reward returns None in place of (3,) of torch.float32" in said
    assert "fitness returns 1, which is not a float" in said


def test_a_class_of_the_package_passes_the_same_check():
    from porse.tasks.own import check_task

    check_task(make_task("Over", 2, seed=0))


def test_check_code_says_why_a_task_of_ones_own_is_refused(root, project):
    command = [sys.executable, *PORSE, "check-code", "my_tasks.cart:Cart", "--reward", "reward.py", "--json"]
    environment = os.environ | {"PYTHONPATH": str(root)}
    done = subprocess.run(command, cwd=project, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "it has CartPole" in done.stderr
    assert "Traceback" not in done.stderr
