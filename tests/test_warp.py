"""MuJoCo Warp beside MuJoCo itself, on Warp's CPU device; and on a GPU where there is one."""

import dataclasses

import mujoco
import pytest
import torch
from click.testing import CliRunner

pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed: `make gpu`")
pytestmark = pytest.mark.filterwarnings("ignore")  # Warp warns where there is no driver, in its own words

from parity import AFTER, apart  # noqa: E402
from porse.checkpoint import write_checkpoint  # noqa: E402
from porse.errors import TaskError  # noqa: E402
from porse.report import gpu_speed  # noqa: E402
from porse.sim.devices import Device, make_physics  # noqa: E402
from porse.sim.physics import Capacity  # noqa: E402
from porse.sim.placement import placed  # noqa: E402
from porse.tasks import TASKS, make_task  # noqa: E402
from porse.training.bonus import NoBonus  # noqa: E402
from porse.training.goal import human  # noqa: E402
from porse.training.reward import Reward  # noqa: E402
from porse.training.scale import NoScale  # noqa: E402
from porse.training.trainer import Trainer, draw_policy  # noqa: E402

WARP = Device("warp-cpu")
BALLS = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <geom type="plane" size="1 1 0.1"/>
    <body name="a" pos="0 0 0.5"><freejoint/><geom size="0.1" mass="2"/></body>
    <body name="b" pos="0.5 0 0.5"><freejoint/><geom size="0.1" mass="1"/></body>
  </worldbody>
</mujoco>
"""
BOUNDS = {1: (1e-5, 1e-4), 10: (1e-3, 2e-3)}
"""Largest differences of positions (m, rad), and of velocities as a share of the fastest, by the number of control steps."""
TOUCHING = ("BlockStack", "BottleCap", "CatchOver2Underarm", "GraspAndPlace", "PushBlock")
"""Objects that touch what they lie on with a gap of about nothing, or an egg that hits fingers at once."""
BOUNDS_TOUCHING = {1: (1e-3, 1e-3), 10: (1e-2, 1e-2)}


def balls(capacity=Capacity(8, 32)):  # noqa: B008  a frozen value
    return make_physics(mujoco.MjModel.from_xml_string(BALLS), 3, 1, ("xpos", "qfrc_constraint"), WARP, capacity)


@pytest.mark.warp
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", sorted(TASKS))
def test_a_task_moves_as_it_does_on_the_processor(name):
    for steps, found in zip(AFTER, apart(name), strict=True):
        positions, velocities = (BOUNDS_TOUCHING if name in TOUCHING else BOUNDS)[steps]
        assert found.positions < positions
        assert found.velocities < velocities * max(1.0, found.fastest)


@pytest.mark.warp
def test_tensors_are_the_simulations_own_memory_and_a_state_is_a_whole_state():
    physics = balls()
    physics.qvel[1, 0] = 2.0
    assert not physics.advance(2).any()
    assert physics.qpos[:, 0].tolist() == [0.0, pytest.approx(0.04), 0.0]
    assert torch.equal(physics.read("xpos")[:, 1], physics.qpos[:, :3])
    state = physics.state()
    physics.advance(3)
    after = physics.state()
    physics.load_state(state)
    physics.advance(3)
    assert torch.equal(physics.state(), after)
    physics.restart(torch.tensor([1]))
    assert physics.qpos[1, :3].tolist() == [0.0, 0.0, 0.5]
    assert torch.equal(physics.state()[[0, 2]], after[[0, 2]])


@pytest.mark.warp
def test_a_simulation_that_blows_up_is_back_where_it_was_kept_and_the_others_go_on():
    physics = balls()
    physics.qpos[:, 2] = 3.0
    physics.keep_start()
    physics.qvel[0, 0], physics.qvel[2, 1] = float("nan"), 1e6
    assert physics.advance(1).tolist() == [True, False, True]
    assert physics.qpos[:, 2].tolist() == [3.0, pytest.approx(3.0 - 9.81e-4), 3.0]
    assert physics.state().isfinite().all()
    assert physics.read("xpos").isfinite().all()
    assert physics.read("qfrc_constraint").isfinite().all()
    assert not physics.advance(1).any()


@pytest.mark.warp
def test_drag_and_the_highest_speed_hold_at_the_beginning_of_each_step():
    physics = balls()
    physics.kept = torch.full((12,), 0.5)
    physics.fastest = torch.full((12,), 1.5)
    physics.qvel[:, 0] = torch.tensor([2.0, 4.0, -8.0])
    physics.advance(1)
    # halved, then bounded
    assert physics.qvel[:, 0].tolist() == [1.0, 1.5, -1.5]


@pytest.mark.warp
@pytest.mark.parametrize(
    ("capacity", "figure"), [(Capacity(8, 4), "rows above 4"), (Capacity(1, 32), "contacts above 1")]
)
def test_too_little_room_for_contacts_is_an_error_that_names_the_figure(capacity, figure):
    physics = balls(capacity)
    physics.qpos[:, [2, 9]] = 0.09
    physics.advance(1)
    with pytest.raises(TaskError, match=f"raise {figure} in the task's class"):
        physics.check()
    physics.check()


@pytest.mark.warp
def test_a_mask_starts_those_episodes_anew_and_no_others():
    task = make_task("Quadcopter", 3, 0, device=WARP)
    task.step(torch.ones(3, 12))
    before = task.observations()
    task.reset(torch.tensor([False, True, False]))
    after = task.observations()
    assert torch.equal(after[[0, 2]], before[[0, 2]])
    assert not torch.equal(after[1], before[1])
    assert task.progress.tolist() == [1, 0, 1]
    assert task.actions[:, 0].tolist() == [1.0, 0.0, 1.0]


def trained(device, path, params, until, start):
    """Returns the weights of a training of Quadcopter with the human reward."""
    with placed(device.torch):
        task = make_task("Quadcopter", params.num_envs, 5, device=device)
        trainer = Trainer(task, Reward(human, NoBonus(), 0.0, 1.0, NoScale(), NoScale()), params, 7)
        trainer.load(start)
        trainer.train(until, lambda *_: None, lambda _: None)
        trainer.save(path)
    return path.read_bytes()


def check_training(device, params, folder):
    train = dataclasses.replace(params.train, num_envs=4, steps_per_epoch=4, hidden=(8,), minibatches=2, passes=2)
    start, half = folder / "start.safetensors", folder / "half.safetensors"
    write_checkpoint(start, draw_policy(21, 12, train, 3))
    whole = trained(device, folder / "whole.safetensors", train, 4, start)
    assert trained(device, folder / "again.safetensors", train, 4, start) == whole
    trained(device, half, train, 2, start)
    assert trained(device, folder / "rest.safetensors", train, 4, half) == whole


@pytest.mark.warp
def test_a_training_goes_on_from_its_checkpoint_with_the_same_bits(params, tmp_path):
    check_training(WARP, params, tmp_path)


@pytest.mark.warp
def test_the_measuring_script_prints_a_row_for_each_task_and_size_and_says_what_is_missing(root):
    asked = ["--params", str(root / "params.yaml"), "--device", "warp-cpu", "--task", "Quadcopter", "--envs", "4"]
    asked += ["--seconds", "0.01"]
    lines = CliRunner().invoke(gpu_speed.main, asked, catch_exceptions=False).output.splitlines()
    name, envs, *figures = [cell.strip() for cell in lines[-1].strip("|").split("|")]
    assert (name, envs, len(figures)) == ("Quadcopter", "4", 4)
    assert float(figures[0].replace(",", "")) > 0.0
    none = CliRunner().invoke(gpu_speed.main, [*asked, "--minutes", "0"], catch_exceptions=False).output
    assert none.splitlines()[-1].startswith("1 rows did not begin within 0 minutes")


def gpu():
    if not torch.cuda.is_available():
        pytest.skip("there is no GPU that PyTorch can use")
    return Device("cuda:0")


@pytest.mark.gpu
@pytest.mark.timeout(3600)
def test_two_trainings_on_a_gpu_have_the_same_bits_however_they_are_split(params, tmp_path):
    check_training(gpu(), params, tmp_path)


@pytest.mark.gpu
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", ["Over", "LiftUnderarm", "Humanoid", "FrankaCabinet"])
def test_two_runs_on_a_gpu_have_the_same_bits(name):
    def run():
        device = gpu()
        with placed(device.torch), torch.inference_mode():
            task = make_task(name, 256, 0, device=device)
            generator = torch.Generator(device.torch).manual_seed(1)
            for _ in range(60):
                task.step(2.0 * torch.rand(256, task.NUM_ACTIONS, generator=generator) - 1.0)
                task.renew(task.terminated() | task.timed_out())
            task.check()
            return task.observations().cpu()

    assert torch.equal(run(), run())


@pytest.mark.gpu
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", ["Quadcopter", "Over"])
def test_a_rollout_on_a_gpu_makes_the_processor_wait_for_nothing(name):
    device = gpu()
    with placed(device.torch), torch.inference_mode():
        task = make_task(name, 16, 0, device=device)
        for round_ in range(3):
            torch.cuda.set_sync_debug_mode("error" if round_ else "default")
            try:
                task.step(2.0 * torch.rand(16, task.NUM_ACTIONS) - 1.0)
                task.human_reward(), task.mean_fitness()
                task.renew(task.terminated() | task.timed_out())
                task.observations()
            finally:
                torch.cuda.set_sync_debug_mode("default")
