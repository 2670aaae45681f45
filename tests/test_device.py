"""Trainings on a device that works behind the processor: nothing looks at a number in a rollout, and nothing lies elsewhere.

Tensors on torch's device `meta` have shapes and no numbers: whoever looks at one gets an error, as does whoever mixes
them with tensors of the processor. So these rollouts need no GPU.
"""

import pytest
import torch

from porse.exploration import Counts
from porse.sim.devices import Device, make_physics
from porse.sim.physics import Physics
from porse.sim.placement import placed
from porse.tasks import TASKS, make_task
from porse.training.bonus import NoBonus
from porse.training.goal import human
from porse.training.reward import Reward
from porse.training.scale import NoScale
from porse.training.vecenv import TaskEnv

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
        return Blind(model, num_envs)

    drawing = torch.Generator
    monkeypatch.setattr("porse.tasks.base.make_physics", physics)
    # There are no numbers to be drawn there.
    monkeypatch.setattr(torch, "Generator", lambda device="cpu": drawing("cpu"))
    return lambda name: make_task(name, 5, 0, device=Device("meta"))


@pytest.mark.parametrize("name", sorted(TASKS))
def test_a_rollout_looks_at_no_number_and_stays_on_its_device(blind, name):
    with placed(META), torch.inference_mode():
        task = blind(name)
        task.stagger(1)
        env = TaskEnv(task, Reward(human, NoBonus(), 0.0, 1.0, NoScale(), NoScale()))
        for _ in range(2):
            observations, ends, timed_out = env.step(torch.zeros(5, task.NUM_ACTIONS))
        assert observations.shape == (5, task.NUM_OBSERVATIONS)
        values = [observations, ends, timed_out, task.mean_fitness(), *task.present().values()]
        assert {value.device for value in values if isinstance(value, torch.Tensor)} == {META}


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
    assert moved[1] == moved[0] + 1  # `long` makes another tensor in every round
    assert torch.zeros(1).device.type == "cpu"


def test_on_the_processor_there_is_no_such_context():
    with placed(torch.device("cpu")) as mode:
        assert mode is None


def test_a_device_without_its_packages_is_refused(monkeypatch):
    from porse.errors import TaskError
    from porse.sim.physics import Capacity

    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(
        TaskError, match=r"expected MuJoCo Warp for device: warp-cpu, found no package warp; install it"
    ):
        make_physics(None, 1, 1, (), Device("warp-cpu"), Capacity(1, 1))


def test_counts_are_the_same_with_whole_numbers_and_with_floats():
    """Twice the same cells: of three environments, two meet in cell 1, then all are in cell 0."""
    counts = Counts(3, 3, each_episode=False)
    visits = counts.count(torch.tensor([[1, 1, 2], [0, 0, 0]]), torch.zeros(2, 3, dtype=torch.bool))
    assert visits.own.tolist() == [[2, 2, 1], [3, 3, 3]]
    assert visits.mean.tolist() == [[1.5] * 3, [2.0] * 3]
