"""What every registered task promises. Adding a task to `TASKS` adds it to every test here."""

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import mujoco
import pytest
import torch
from safetensors.torch import load_file, save_file

from porse.errors import TaskError
from porse.sim.physics import CpuPhysics
from porse.tasks import TASKS, make_task
from porse.tasks.base import Task
from porse.tasks.franka_cabinet.scene import FINGER
from task_cases import at_rest

ENVS = 4
NAMES = sorted(TASKS)
FIXED_STARTS = {
    "BlockStack", "BottleCap", "DoorCloseInward", "DoorCloseOutward", "DoorOpenInward", "DoorOpenOutward",
    "GraspAndPlace", "Kettle", "LiftUnderarm", "Pen", "PushBlock", "Scissors", "SwingCup", "Switch", "SwitchReachable",
}  # fmt: skip
"""Tasks whose originals start every episode in one state."""

CONSTANT = {
    # Where the object shall go, or is thrown to: one place for all episodes.
    "Over": [*range(387, 390)],
    "CatchAbreast": [*range(411, 414)],
    "CatchOver2Underarm": [*range(411, 414)],
    "CatchUnderarm": [*range(411, 414)],
    "TwoCatchUnderarm": [*range(411, 414), *range(435, 438)],
    "ReOrientation": [*range(387, 390), *range(411, 414)],
    # Pose and velocities of an object's root that stands fast.
    **{key: [*range(398, 411)] for key in ["DoorCloseInward", "DoorCloseOutward", "DoorOpenInward", "DoorOpenOutward"]},
    **{key: [*range(398, 411)] for key in ["Switch", "SwitchReachable"]},
    # Zeros at the end; in PushBlock the two goals before them.
    "BlockStack": [*range(424, 428)],
    "BottleCap": [*range(420, 422)],
    "PushBlock": [*range(417, 428)],
}
"""Observation entries that never change in the originals either."""

CONTINUE = """
import sys
from pathlib import Path
import torch
from safetensors.torch import load_file, save_file
from porse.tasks import TASKS, make_task
folder = Path(sys.argv[1])
for name in sorted(TASKS):
    task = make_task(name, 4, seed=99)
    task.load_state(load_file(folder / f"{name}-saved.safetensors"))
    generator = torch.Generator().manual_seed(5)
    for _ in range(50):
        task.step(torch.rand(4, task.NUM_ACTIONS, generator=generator) * 2 - 1)
        task.reset(task.terminated() | task.timed_out())
    save_file(task.state() | {"observations": task.observations()}, folder / f"{name}-continued.safetensors")
"""


def play(task: Task, steps: int, seed: int) -> None:
    """Steps a task with random actions, resetting as a trainer does."""
    generator = torch.Generator().manual_seed(seed)
    for _ in range(steps):
        task.step(torch.rand(task.num_envs, task.NUM_ACTIONS, generator=generator) * 2 - 1)
        task.reset(task.terminated() | task.timed_out())


@pytest.mark.parametrize("name", NAMES)
def test_shapes_types_and_finiteness(name: str) -> None:
    """Observations, rewards, flags and every variable have the declared shape and type, and no bad number."""
    task = make_task(name, ENVS, seed=1)
    play(task, 20, seed=2)
    assert name == task.NAME
    assert task.observations().shape == (ENVS, task.NUM_OBSERVATIONS)
    for tensor in (task.observations(), task.sparse_reward(), task.human_reward()):
        assert tensor.dtype == torch.float32
        assert bool(tensor.isfinite().all())
    assert task.sparse_reward().shape == task.human_reward().shape == (ENVS,)
    for flag in (task.terminated(), task.timed_out()):
        assert flag.dtype == torch.bool
        assert flag.shape == (ENVS,)
    assert isinstance(task.fitness(), float)
    values = task.variables()
    assert list(values) == [variable.name for variable in task.VARIABLES]
    for variable in task.VARIABLES:
        value = values[variable.name]
        if variable.kind == "tensor":
            assert isinstance(value, torch.Tensor)
            assert value.shape == (ENVS, *variable.shape), variable.name
            assert value.dtype in (torch.float32, torch.int64), variable.name
            assert bool(value.isfinite().all()), variable.name
        else:
            assert type(value).__name__ == variable.kind, variable.name


@pytest.mark.parametrize("name", NAMES)
def test_a_task_says_how_an_episode_starts_and_ends_and_what_fitness_measures(name: str) -> None:
    """Prompts complete each to a sentence, so none is a sentence by itself."""
    task = TASKS[name]
    for said in (task.STARTS, task.ENDS, task.FITNESS):
        assert said, said
        assert not said.endswith("."), said
        assert not said[0].isupper(), said
    assert task.ENDS == "never" or task.ENDS.startswith("as soon as ")
    assert (task.ENDS == "never") == (name in {"Switch", "SwitchReachable"})
    assert len({task.STARTS, task.ENDS, task.FITNESS}) == 3


LIMITS: dict[str, tuple[str, ...]] = {
    "Quadcopter": ("TOO_FAR", "TOO_LOW"),
    "FrankaCabinet": ("OPEN",),
    "Anymal": ("TOUCHED",),
    "Humanoid": ("FALLEN",),
    "BottleCap": ("DROPPED", "CAP_LOST", "BOTTLE_LOST"),
    "Kettle": ("DROPPED",),
    "LiftUnderarm": ("DROPPED",),
    "SwingCup": ("DROPPED",),
}
"""Constants of a task's module that end its episodes; other tasks have class attributes, DROPPED or LOST."""


@pytest.mark.parametrize("name", [name for name in NAMES if TASKS[name].ENDS != "never"])
def test_the_limits_that_end_an_episode_stand_in_its_words(name: str) -> None:
    """The numbers of the code are those of the prompt, so that neither changes alone."""
    task = TASKS[name]
    module = sys.modules[task.__module__]
    limits = [getattr(module, constant) for constant in LIMITS.get(name, ())]
    limits += [value for key in ("DROPPED", "LOST") if (value := getattr(task, key, None)) is not None]
    assert limits
    words = re.findall(r"[0-9.]+", task.ENDS)
    assert [limit for limit in limits if f"{limit:g}" not in words] == []


SOLVED: dict[str, tuple[float, str]] = {
    # What each task's success compares with, as the code has it, and the words for it.
    "FrankaCabinet": (0.39, "more than 0.39 m"),
    "Over": (0.03, "within 3 cm"),
    "CatchUnderarm": (0.03, "within 3 cm"),
    "CatchAbreast": (0.03, "within 3 cm"),
    "CatchOver2Underarm": (0.03, "within 3 cm"),
    "TwoCatchUnderarm": (0.06, "less than 6 cm"),
    "DoorCloseInward": (0.5, "less than 0.5 m apart"),
    "DoorCloseOutward": (0.5, "less than 0.5 m apart"),
    "DoorOpenInward": (0.5, "more than 0.5 m apart"),
    "DoorOpenOutward": (0.5, "more than 0.5 m apart"),
    "Scissors": (-0.3, "beyond -0.3 rad"),
    "SwingCup": (0.785, "within 0.785 rad"),
    "Switch": (1.35, "less than 1.35 m"),
    "SwitchReachable": (0.693, "at 0.693 m or lower"),
    "Kettle": (0.05, "within 5 cm"),
    "LiftUnderarm": (0.05, "within 5 cm"),
    "Pen": (0.3, "more than 0.3 m apart"),
    "BottleCap": (0.03, "more than 3 cm"),
    "ReOrientation": (0.1, "within 0.1 rad"),
    "GraspAndPlace": (0.2, "within 20 cm"),
    "PushBlock": (0.1, "within 10 cm"),
    "BlockStack": (0.07, "within 7 cm"),
}


@pytest.mark.parametrize("name", NAMES)
def test_the_words_for_fitness_hold_what_success_compares_with(name: str) -> None:
    if name not in SOLVED:
        # A quantity and not a share of episodes.
        assert name in {"Quadcopter", "Anymal", "Humanoid"}
        assert "share" not in TASKS[name].FITNESS
        return
    constant, words = SOLVED[name]
    assert words in TASKS[name].FITNESS
    named = {"NEAR", "OPEN", "ALIGNED", "LOW", "POURING", "TOLERANCE", "HALF_OPEN"}
    modules = [sys.modules[kind.__module__] for kind in TASKS[name].__mro__ if kind.__module__.startswith("porse.")]
    found = [getattr(module, key) for module in modules for key in named if hasattr(module, key)]
    # Switch compares 1.4 less the sum of two heights with 0.05.
    assert (
        round(1.4 - sys.modules["porse.tasks.switch.task"].PRESSED, 6) if name == "Switch" else constant
    ) == constant
    assert name == "Switch" or constant in found


@pytest.mark.parametrize("name", NAMES)
def test_the_same_seed_gives_the_same_trajectory_at_any_thread_count(name: str) -> None:
    """One thread and two: the same bits after 30 steps; another seed: other starts."""
    one, two, other = (make_task(name, ENVS, seed=seed, threads=threads) for seed, threads in ((7, 1), (7, 2), (8, 1)))
    assert torch.equal(one.state()["physics"], other.state()["physics"]) is (name in FIXED_STARTS)
    play(one, 30, seed=3)
    play(two, 30, seed=3)
    for key, value in one.state().items():
        assert torch.equal(value, two.state()[key]), key
    assert torch.equal(one.observations(), two.observations())


@pytest.fixture
def said() -> Iterator[list[str]]:
    """Returns a list that MuJoCo's warnings are written to."""
    before, found = mujoco.get_mju_user_warning(), []
    mujoco.set_mju_user_warning(found.append)
    yield found
    mujoco.set_mju_user_warning(before)


@pytest.mark.parametrize("name", NAMES)
def test_a_thousand_random_steps_give_no_warning_and_change_every_observation(name: str, said: list[str]) -> None:
    """But for the entries that are constant in the originals. Warnings of Python fail every test.

    Everything is nudged now and then: random actions do not bring a dragged hand to a block or a door.
    """
    task = make_task(name, ENVS, seed=6)
    low = high = task.observations()
    generator = torch.Generator().manual_seed(7)
    for step in range(50):
        task._physics.qvel += 0.05 * torch.randn(task._physics.qvel.shape, generator=generator, dtype=torch.float64)
        play(task, 20, seed=step)
        seen = task.observations()
        low, high = torch.minimum(low, seen), torch.maximum(high, seen)
    assert said == []
    assert task.blown_up == 0
    still = low.min(dim=0).values == high.max(dim=0).values
    assert still.nonzero().flatten().tolist() == CONSTANT.get(name, [])


def test_a_bad_state_is_a_warning(said: list[str]) -> None:
    """What the test above would see."""
    task = make_task("Over", ENVS, seed=1)
    task._physics.qvel[2, 0] = float("nan")
    task.step(torch.zeros(ENVS, task.NUM_ACTIONS))
    assert len(said) == 1
    assert "unstable" in said[0]


@pytest.mark.parametrize("name", NAMES)
def test_plain_values_stay_what_they_are(name: str) -> None:
    """So that a result of a generated function which was looked at once need not be looked at again."""
    task = make_task(name, ENVS, seed=2)
    plain = [variable.name for variable in task.VARIABLES if variable.kind != "tensor"]
    before = [task.variables()[key] for key in plain]
    play(task, 30, seed=2)
    task.reset(torch.ones(ENVS, dtype=torch.bool))
    assert "num_envs" in plain
    assert [task.variables()[key] for key in plain] == before


@pytest.mark.parametrize("name", NAMES)
def test_starts_are_spread_unless_the_original_has_one(name: str) -> None:
    """Among 16 environments no two start alike, or all do; and so do episodes that follow one another."""
    task = make_task(name, 16, seed=9)
    first = task.state()["physics"]
    task.reset(torch.ones(16, dtype=torch.bool))
    starts = torch.cat([first, task.state()["physics"]])
    assert len(torch.unique(starts, dim=0)) == (1 if name in FIXED_STARTS else 32)


@pytest.fixture(scope="module")
def continued(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns a folder with a state of every task after 10 steps, and where a new process took it in 50 more."""
    folder = tmp_path_factory.mktemp("states")
    for name in NAMES:
        task = make_task(name, ENVS, seed=4)
        play(task, 10, seed=4)
        save_file(task.state(), folder / f"{name}-saved.safetensors")
    subprocess.run([sys.executable, "-c", CONTINUE, str(folder)], check=True, cwd=Path(__file__).parent.parent)
    return folder


@pytest.mark.parametrize("name", NAMES)
def test_a_state_continues_exactly_in_a_new_process(name: str, continued: Path) -> None:
    """Fifty steps after a save: this process, which did not stop, and the new one end with the same bits."""
    task = make_task(name, ENVS, seed=4)
    play(task, 10, seed=4)
    play(task, 50, seed=5)
    found = load_file(continued / f"{name}-continued.safetensors")
    for key, value in (task.state() | {"observations": task.observations()}).items():
        assert torch.equal(value, found[key]), key


@pytest.mark.parametrize("name", NAMES)
def test_a_state_of_another_size_is_refused(name: str) -> None:
    """The error names the entry that differs, and nothing is changed."""
    task, other = make_task(name, 2, seed=1), make_task(name, 3, seed=1)
    before = task.state()
    with pytest.raises(TaskError, match=f"{name} with 2 environments"):
        task.load_state(other.state())
    assert all(torch.equal(value, before[key]) for key, value in task.state().items())


@pytest.mark.parametrize("name", NAMES)
def test_returned_tensors_are_fresh_memory(name: str) -> None:
    """No observation or variable shares memory with another call's, and writing into one changes nothing."""
    task = make_task(name, ENVS, seed=1)
    play(task, 4, seed=1)
    first, second = task.observations(), task.observations()
    assert first.data_ptr() != second.data_ptr()
    for value in task.variables().values():
        if isinstance(value, torch.Tensor):
            value.fill_(3)
    assert torch.equal(task.observations(), second)
    assert task.progress.tolist() != [3] * ENVS


@pytest.mark.parametrize("name", NAMES)
def test_a_reset_touches_only_its_environments(name: str) -> None:
    """The others keep state and observation bit for bit; the reset one starts anew."""
    task = make_task(name, ENVS, seed=1)
    play(task, 5, seed=1)
    state, observations = task.state(), task.observations()
    task.reset(torch.tensor([False, True, False, False]))
    kept = [0, 2, 3]
    assert torch.equal(task.state()["physics"][kept], state["physics"][kept])
    assert torch.equal(task.observations()[kept], observations[kept])
    assert not torch.equal(task.state()["physics"][1], state["physics"][1])
    assert int(task.progress[1]) == 0
    drawn = task.state()["generator"]
    task.reset(torch.zeros(ENVS, dtype=torch.bool))
    assert torch.equal(task.state()["generator"], drawn)


@pytest.mark.parametrize("name", NAMES)
def test_a_blown_up_simulation_is_started_again_and_counted(name: str) -> None:
    """NaN in one environment: it alone ends, every number stays finite, and the count rises by one."""
    task = make_task(name, ENVS, seed=1)
    play(task, 2, seed=1)
    task._physics.qvel[2, 0] = float("nan")
    task.step(torch.zeros(ENVS, task.NUM_ACTIONS))
    assert task.blown_up == 1
    assert bool(task.terminated()[2])
    assert bool(task.human_reward().isfinite().all())
    assert bool(task.observations().isfinite().all())
    task.reset(task.terminated())
    assert not task.terminated()[2]
    play(task, 5, seed=1)
    assert task.blown_up == 1


@pytest.mark.parametrize("name", NAMES)
def test_the_time_limit_ends_an_episode(name: str) -> None:
    """One step before the limit: not yet; at the limit: timed out."""
    task = make_task(name, ENVS, seed=1)
    task.progress[:] = task.TIME_LIMIT - 2
    task.step(torch.zeros(ENVS, task.NUM_ACTIONS))
    assert not task.timed_out().any()
    task.step(torch.zeros(ENVS, task.NUM_ACTIONS))
    assert bool(task.timed_out().all())


@pytest.mark.parametrize("name", NAMES)
def test_the_source_that_prompts_show_names_exactly_the_variables(name: str) -> None:
    """`self.<name>` in the text and the names offered are the same set."""
    source = TASKS[name].observation_source()
    assert set(re.findall(r"self\.(\w+)", source)) == {variable.name for variable in TASKS[name].VARIABLES}
    assert "def compute_observations(self)" in source


@pytest.mark.parametrize("name", NAMES)
def test_every_object_of_the_scene_is_named(name: str) -> None:
    """Bodies, joints, geoms, sites, actuators and sensors all have names."""
    model = TASKS[name].scene().compile()
    for kind in ("body", "joint", "geom", "site", "actuator", "sensor", "tendon"):
        count = getattr(model, {"body": "nbody", "joint": "njnt", "actuator": "nu"}.get(kind, f"n{kind}"))
        assert all(getattr(model, kind)(i).name for i in range(count)), kind


def test_an_unknown_task_is_answered_with_the_nearest_names() -> None:
    """The error names what was asked for and what there is."""
    with pytest.raises(TaskError, match=r"'Quadcoptr'.*Quadcopter"):
        make_task("Quadcoptr", 1, seed=0)


def test_wrong_sizes_are_refused() -> None:
    """No environments, and actions of another shape."""
    with pytest.raises(TaskError, match="num_envs=0"):
        make_task("Quadcopter", 0, seed=0)
    task = make_task("Quadcopter", 2, seed=0)
    with pytest.raises(TaskError, match=r"\(2, 12\).*\(2, 11\)"):
        task.step(torch.zeros(2, 11))


@pytest.mark.parametrize("name", NAMES)
def test_a_reset_leaves_no_force_action_or_control_of_the_episode_before(name: str) -> None:
    """Pushed to the limits, then reset: no push and no action is left, its controls those of a start; others keep theirs."""
    task = make_task(name, ENVS, seed=1)
    push = torch.ones(ENVS, task.NUM_ACTIONS)
    for _ in range(3):
        task.step(push)
    pushed, controls = task._physics.force.clone(), task._physics.ctrl.clone()
    task.reset(torch.tensor([True, False, True, False]))
    started = make_task(name, ENVS, seed=1)
    assert torch.equal(task._physics.force[[0, 2]], at_rest(task).expand(2, -1, -1))
    assert not task.actions[[0, 2]].any()
    assert torch.equal(task._physics.force[[1, 3]], pushed[[1, 3]])
    assert torch.equal(task._physics.ctrl[[1, 3]], controls[[1, 3]])
    assert bool((task.actions[[1, 3]] == 1.0).all())
    if name in FIXED_STARTS:
        assert torch.equal(task.state()["physics"][[0, 2]], started.state()["physics"][[0, 2]])


@pytest.mark.parametrize("name", NAMES)
def test_a_force_acts_in_its_own_step_only(name: str) -> None:
    """After a step of zeros nothing of the push before is left in the outer forces."""
    task = make_task(name, ENVS, seed=1)
    task.step(torch.ones(ENVS, task.NUM_ACTIONS))
    task.step(torch.zeros(ENVS, task.NUM_ACTIONS))
    assert torch.equal(task._physics.force, at_rest(task).expand(ENVS, -1, -1))


@pytest.mark.parametrize("name", NAMES)
def test_actions_beyond_their_bounds_are_the_bounds(name: str) -> None:
    """Three steps of 7 and of -7 leave the state that three of 1 and of -1 leave."""
    far, near = make_task(name, ENVS, seed=1), make_task(name, ENVS, seed=1)
    signs = torch.ones(ENVS, far.NUM_ACTIONS)
    signs[:, ::2] = -1.0
    for _ in range(3):
        far.step(7.0 * signs)
        near.step(signs)
    for key, value in far.state().items():
        assert torch.equal(value, near.state()[key]), key


LOOSEST = {"Humanoid": 0.2}
"""How far (rad or m) hard play turns joints beyond their ranges, where more than LOOSE. Measured: 0.13 at a knee."""
LOOSE = 0.06
"""The same of every other task. Measured: 0.04 at a hip of the quadruped, 0.035 at a thumb."""


@pytest.mark.parametrize("name", NAMES)
def test_limits_of_joints_and_forces_hold(name: str) -> None:
    """Sixty steps of actions at their bounds: joints stay in their ranges, drives below their force limits."""
    task = make_task(name, ENVS, seed=2)
    model, generator = task._physics.model, torch.Generator().manual_seed(11)
    limited = [joint for joint in range(model.njnt) if model.jnt_limited[joint]]
    places = torch.tensor([int(model.jnt_qposadr[joint]) for joint in limited], dtype=torch.int64)
    ranges = torch.from_numpy(model.jnt_range[limited].copy())
    data = mujoco.MjData(model)
    physics = task._physics
    assert isinstance(physics, CpuPhysics)
    actions = torch.zeros(ENVS, task.NUM_ACTIONS)
    for step in range(60):
        if step % 3 == 0:
            actions = torch.sign(torch.rand(ENVS, task.NUM_ACTIONS, generator=generator) - 0.5)
        task.step(actions)
        angles = physics.qpos[:, places]
        beyond = torch.maximum(ranges[:, 0] - angles, angles - ranges[:, 1])
        assert not (beyond > LOOSEST.get(name, LOOSE)).any(), step
        physics._batch.get_data(0, data)
        mujoco.mj_forward(model, data)
        bounded = model.actuator_forcelimited.astype(bool)
        assert (abs(data.actuator_force[bounded]) <= model.actuator_forcerange[bounded, 1] * (1 + 1e-9)).all(), step
        task.reset(task.terminated() | task.timed_out())


DRIVEN_WHOLLY = ["FrankaCabinet", "Anymal", "Over", "DoorOpenInward"]


@pytest.mark.parametrize("name", DRIVEN_WHOLLY)
def test_no_damping_stands_beside_a_drive_that_can_reach_its_limit(name: str) -> None:
    """Driven joints have none of their own, but for the Panda's fingers, whose highest lead times stiffness is the limit."""
    model = TASKS[name].scene().compile()
    for actuator in range(model.nu):
        joint = int(model.actuator_trnid[actuator, 0])
        damping = float(model.dof_damping[model.jnt_dofadr[joint]])
        if model.joint(joint).name.startswith("panda_finger"):
            lead = damping * FINGER.fastest / model.actuator_gainprm[actuator, 0]
            assert lead * model.actuator_gainprm[actuator, 0] <= model.actuator_forcerange[actuator, 1]
        else:
            assert damping == 0.0
            assert model.actuator_biasprm[actuator, 2] < 0.0
