"""Trainings on a device that works behind the processor: nothing looks at a number in a rollout, and nothing lies elsewhere.

Tensors on torch's device `meta` have shapes and no numbers: whoever looks at one gets an error, as does whoever mixes
them with tensors of the processor. So these rollouts need no GPU.
"""

import dataclasses

import pytest
import torch

from porse.errors import TaskError
from porse.exploration import Counts, ProgressSpace, SimHash, literal
from porse.functions.run.execute import Function
from porse.sim.devices import Device, make_physics
from porse.sim.physics import Capacity, Physics
from porse.sim.placement import placed, unplaced
from porse.tasks import TASKS, make_task
from porse.training.bonus import Ledger, MappingBonus, NoBonus, Price, SimHashBonus
from porse.training.goal import generated, human
from porse.training.ppo import build_ppo
from porse.training.reward import Reward
from porse.training.scale import NoScale, ReturnScale
from porse.training.vecenv import TaskEnv, observation_groups
from samples import MAPPING, REWARD, program

META = torch.device("meta")


class Blind(Physics):
    """Simulations of which nobody knows anything but their shapes."""

    asynchronous, real, device = True, torch.float32, META

    def __init__(self, model, num_envs):
        self.model, self.num_envs = model, num_envs
        sizes = {"qpos": (model.nq,), "qvel": (model.nv,), "ctrl": (model.nu,), "force": (model.nbody, 6)}
        sizes |= {"mocap_pos": (model.nmocap, 3), "mocap_quat": (model.nmocap, 4)}
        for name, size in sizes.items():
            setattr(self, name, torch.zeros(num_envs, *size, device=META))
        bodies = {"xpos": 3, "xquat": 4, "cvel": 6, "subtree_com": 3}
        self.fields = {name: (model.nbody, width) for name, width in bodies.items()}
        self.fields |= {name: (model.nv,) for name in ("qfrc_actuator", "qfrc_passive", "qfrc_constraint")}
        self.fields["sensordata"] = (model.nsensordata,)

    def advance(self, substeps):
        for bound in (self.kept, self.fastest):
            assert bound is None or bound.device == META
        return torch.zeros(self.num_envs, dtype=torch.bool, device=META)

    def restart(self, ids):
        self.qpos[ids] = torch.zeros(self.model.nq, device=META)

    def refresh(self, ids):
        assert ids.device == META

    def read(self, field, ids=None):
        values = torch.zeros(self.num_envs, *self.fields[field], device=META)
        return values if ids is None else values[ids]

    def state(self):
        return torch.cat((self.qpos, self.qvel), dim=1)

    def load_state(self, state):
        assert state.device == META


@pytest.fixture
def blind(monkeypatch):
    """Returns what makes a task on the device of shapes."""

    def physics(model, num_envs, threads, fields, device, capacity):
        if device.name == "cpu":
            return make_physics(model, num_envs, threads, fields, device, capacity)
        return Blind(model, num_envs)

    drawing = torch.Generator
    monkeypatch.setattr("porse.tasks.base.make_physics", physics)
    # There are no numbers to be drawn there.
    monkeypatch.setattr(torch, "Generator", lambda device="cpu": drawing("cpu"))
    return lambda name: make_task(name, 5, 0, device=Device("meta"))


@pytest.mark.parametrize("name", sorted(TASKS))
def test_a_rollout_looks_at_no_number_and_stays_on_its_device(blind, name):
    with placed(META) as mode, torch.inference_mode():
        task = blind(name)
        task.stagger(1)
        env = TaskEnv(task, Reward(human, NoBonus(), 0.0, 1.0, NoScale(), NoScale()))
        brought = []
        for _ in range(3):
            observations, ends, timed_out = env.step(torch.zeros(5, task.NUM_ACTIONS))
            brought.append(len(mode._kept))
        assert brought[1] == brought[2]  # nothing is copied to the device in every step
        assert observations.shape == (5, task.NUM_OBSERVATIONS)
        values = [observations, ends, timed_out, task.mean_fitness(), *task.present().values()]
        assert {value.device for value in values if isinstance(value, torch.Tensor)} == {META}


@pytest.mark.parametrize("name", ["Quadcopter", "ReOrientation"])
def test_where_nobody_asks_which_episodes_begin_the_others_are_as_they_were(name):
    task = make_task(name, 3, 0)
    for _ in range(2):
        task.step(torch.full((3, task.NUM_ACTIONS), 0.5))
    task._physics.asynchronous = True
    seen, before = task.observations(), task.state()
    task.reset(torch.tensor([False, True, False]))
    after = task.state()
    assert torch.equal(task.observations()[[0, 2]], seen[[0, 2]])
    assert not torch.equal(task.observations()[1], seen[1])
    assert task.progress.tolist() == [2, 0, 2]
    assert task.actions[:, 0].tolist() == [0.5, 0.0, 0.5]
    rows = [key for key, value in before.items() if value.shape[:1] == (3,)]
    assert {"physics", "progress", "actions"} < set(rows)
    assert all(torch.equal(after[key][[0, 2]], before[key][[0, 2]]) for key in rows)


@pytest.mark.parametrize("bonus", ["mapping", "simhash"])
def test_generated_functions_run_on_the_device_of_their_variables(blind, bonus):
    reward, mapping = program(REWARD), program(MAPPING)
    with placed(META) as mode, torch.inference_mode():
        task = blind("Quadcopter")
        ledger = Ledger(Counts(8, 5, each_episode=False), Price(literal, NoScale(), 1.0), 0)
        counted = Function(mapping, "mapping", portable=False)
        space = ProgressSpace(counted.rises, 8, "grid")
        paid = MappingBonus(counted, space, ledger) if bonus == "mapping" else SimHashBonus(SimHash(21, 3, 1), ledger)
        goal = generated(Function(reward, "reward", portable=False))
        env = TaskEnv(task, Reward(goal, paid, 1.0, 2.0, NoScale(), NoScale()))
        env.step(torch.zeros(5, 12))
        if bonus == "simhash":
            # Products on `meta` take any device's matrix, so this asks for the copy itself.
            drawn = paid.hashes.projection.data_ptr()
            assert any(source is not None and source.data_ptr() == drawn for source, _ in mode._kept.values())
        assert [value.device for value in (*env.reward._values, *env.reward._seen)] == [META, META]


@pytest.mark.parametrize("normalised", [False, True])
def test_ppo_rolls_out_on_the_device_of_its_observations(params, normalised):
    train = dataclasses.replace(
        params.train, num_envs=5, steps_per_epoch=2, minibatches=1, normalise_observations=normalised
    )
    with placed(META), torch.inference_mode():
        seen, none = torch.zeros(5, 3), torch.zeros(5, dtype=torch.bool)
        ppo = build_ppo(observation_groups(seen), 2, train)
        for _ in range(2):
            assert ppo.choose(seen).device == META
            ppo.follow(none, none)
        ppo.finish(seen)
    assert {value.device for value in (ppo.storage.returns, ppo.storage.advantages, ppo.storage.rewards)} == {META}
    assert {weight.device for weight in ppo.actor.parameters()} == {META}


def test_the_device_of_shapes_tells_who_looks_at_a_number_and_who_mixes_devices():
    shapes = torch.zeros(3, device=META)
    for look in (lambda: bool(shapes.any()), lambda: shapes[shapes > 0], lambda: (shapes > 0).nonzero(), shapes.tolist):
        with pytest.raises((RuntimeError, NotImplementedError)):
            look()
    with pytest.raises(RuntimeError, match=r"same device|expected device"):
        shapes + torch.zeros(3)


def test_what_is_brought_along_is_taken_to_the_device_once():
    constant = torch.tensor([1.0, 2.0])
    moved = []
    with placed(META) as mode:
        x = torch.zeros(3, 2)
        for _ in range(3):
            made = (
                x + constant,
                torch.where(x > 0, constant, x),
                x[:, [1, 0]],
                x[constant.long()[:1]],
                torch.tensor([1, 2]),
            )
            assert {value.device for value in made} == {META}
            moved.append(len(mode._kept))
        assert torch.tensor([1.0]).dtype == torch.float32
        assert torch.tensor([1]).dtype == torch.int64
    assert moved[0] == moved[2]
    assert torch.zeros(1).device.type == "cpu"


def test_what_a_module_makes_stays_on_the_processor():
    with placed(META):
        with unplaced():
            constant = torch.tensor([1.0])
            assert constant.device.type == torch.zeros(1).device.type == "cpu"
        assert torch.zeros(1).device == META


def test_on_the_processor_there_is_no_such_context():
    with placed(torch.device("cpu")) as mode:
        assert mode is None


def test_a_device_without_its_packages_is_refused(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(
        TaskError, match=r"expected MuJoCo Warp for device: warp-cpu, found no package warp; install it"
    ):
        make_physics(None, 1, 1, (), Device("warp-cpu"), Capacity(1, 1))


def test_returns_are_summed_up_on_a_device_as_on_the_processor():
    """Two steps of two environments at gamma 0.5; the second one's episode ends in the first step."""
    scale = ReturnScale(0.5, 2)
    stream, goes_on = torch.tensor([[1.0, 2.0], [4.0, 8.0]]).double(), torch.tensor([[1.0, 0.0], [1.0, 1.0]]).double()
    assert scale._returns_there(stream, goes_on).tolist() == [[1.0, 2.0], [4.5, 8.0]]
    assert scale._returns_there(stream, goes_on)[0].tolist() == [1.0 + 2.25, 2.0 + 4.0]
    processor = ReturnScale(0.5, 2)
    assert processor._returns(stream, goes_on == 0.0).tolist() == [[1.0, 2.0], [4.5, 8.0]]
    assert processor._returns(stream, goes_on == 0.0)[0].tolist() == [1.0 + 2.25, 2.0 + 4.0]


def test_visits_and_visited_cells_add_up_from_step_to_step():
    """Two steps: of three environments, two meet in cell 1, then all are in cell 0."""
    counts = Counts(3, 3, each_episode=False)
    visits = counts.count(torch.tensor([[1, 1, 2], [0, 0, 0]]), torch.zeros(2, 3, dtype=torch.bool))
    assert visits.own.tolist() == [[2, 2, 1], [3, 3, 3]]
    assert visits.mean.tolist() == [[1.5] * 3, [2.0] * 3]
