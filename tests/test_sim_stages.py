"""Fields that a step is followed by have the bits of MuJoCo's own second pass, in every task and in a model of all kinds."""

import mujoco
import numpy as np
import pytest
import torch
from mujoco.batch import Batch

from porse.sim import skeleton
from porse.sim.physics import CpuPhysics
from porse.sim.springs import JointSprings
from porse.sim.stages import LEFT, PASSIVE, second_pass
from porse.tasks import TASKS, make_task

WHOLE = mujoco.mjtStage.mjSTAGE_VEL.value

ALL_KINDS = """
<mujoco>
  <option timestep="0.01" integrator="implicitfast"/>
  <worldbody>
    <geom type="plane" size="3 3 0.1"/>
    <body name="goal" mocap="true" pos="0.3 0.2 0.1" quat="1 2 3 4"/>
    <body name="ball" pos="0 0 0.09"><freejoint/><geom size="0.1" mass="2"/></body>
    <body pos="0.5 0 0.6" euler="20 30 40">
      <joint type="slide" axis="1 2 0" stiffness="30" springref="0.05" damping="2" limited="true" range="-0.01 0.01"/>
      <joint type="hinge" axis="0 1 1" pos="0.02 0 0.01" stiffness="4" damping="0.3" frictionloss="0.1" ref="10"/>
      <inertial pos="0.01 0.02 0.03" mass="0.7" diaginertia="0.01 0.02 0.015" euler="10 20 30"/>
      <geom type="box" size="0.05 0.06 0.07"/>
      <body pos="0.1 0 0">
        <joint type="ball" damping="0.2"/><geom type="capsule" size="0.02 0.1" pos="0 0 0.1" euler="0 40 0"/>
        <body pos="0 0 0.2" euler="0 0 50"><geom size="0.03"/><site name="tip"/></body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="turn"/></actuator>
  <sensor><force site="tip"/><touch site="tip"/></sensor>
</mujoco>
""".replace('type="hinge"', 'name="turn" type="hinge"')


def equal_to_the_whole_pass(model: mujoco.MjModel, physics: CpuPhysics, steps: int) -> int:
    """Steps simulations with random controls, and compares every field in each step; returns the number of contacts."""
    generator, touching = np.random.default_rng(5), 0
    whole = Batch(model, physics.num_envs, 1)
    contacts = whole.bind("ncon")
    expected = {name: whole.bind(name) for name in physics._fields}
    for step in range(steps):
        physics.ctrl[:] = torch.from_numpy(generator.uniform(-1.0, 1.0, tuple(physics.ctrl.shape)))
        whole.state[:] = physics.state().numpy()
        whole.step(stage=WHOLE)
        physics.advance(1)
        touching += int(contacts.sum())
        for name, values in expected.items():
            assert physics._fields[name].tobytes() == values.tobytes(), (name, step)
    return touching


def least_fields(model: mujoco.MjModel) -> tuple[str, ...]:
    """Returns all fields for which no whole pass is needed."""
    return (*sorted(LEFT), *sorted(skeleton.FIELDS), *([PASSIVE] if JointSprings.of(model) else []))


@pytest.mark.parametrize("name", TASKS)
def test_no_task_needs_a_whole_pass_and_all_its_fields_have_the_same_bits(name: str) -> None:
    """Of its own fields none asks for the whole pass, and every field that need not ask is equal, in states it comes to."""
    task = make_task(name, 3, seed=2)
    model = task._physics.model
    assert not second_pass(model, task.FIELDS).is_whole
    physics = CpuPhysics(model, 3, 1, tuple({*least_fields(model), *task.FIELDS}))
    assert physics._stage != WHOLE
    generator = torch.Generator().manual_seed(1)
    for _ in range(4):
        task.step(2.0 * torch.rand(3, task.NUM_ACTIONS, generator=generator) - 1.0)
        physics.load_state(task._physics.state())
        equal_to_the_whole_pass(model, physics, 2)


@pytest.mark.parametrize("threads", [1, 3])
def test_all_kinds_of_joints_have_the_same_bits(threads: int) -> None:
    """Free, ball, slide and hinge, with springs, stops and friction, on the ground and beside a body that a task moves."""
    model = mujoco.MjModel.from_xml_string(ALL_KINDS)
    physics = CpuPhysics(model, 4, threads, (*least_fields(model), "sensordata"))
    assert PASSIVE in physics._fields
    physics.qvel[:] = torch.randn(4, model.nv, generator=torch.Generator().manual_seed(4)).double()
    physics.mocap_pos[:, 0, 0] = torch.tensor([0.1, 0.4, 0.7, 1.1]).double()
    assert equal_to_the_whole_pass(model, physics, 30) > 30


def test_a_refreshed_simulation_is_current_and_the_others_stay() -> None:
    """At 0.75 m, at 2 m/s, a spring of 8 N/m that is loose at 0.5 m and a damper of 3 N s/m give -2 - 6 = -8 N."""
    model = mujoco.MjModel.from_xml_string(SPRING)
    physics = CpuPhysics(model, 3, 1, ("xpos", PASSIVE))
    physics.qpos[:, 0], physics.qvel[:, 0] = 0.75, 2.0
    physics.refresh(torch.tensor([0, 2]))
    assert physics.read(PASSIVE)[:, 0].tolist() == [-8.0, 0.0, -8.0]
    assert physics.read("xpos")[:, 1, 0].tolist() == [0.75, 0.0, 0.75]
    assert JointSprings(model).forces(np.array([[0.25]]), np.array([[-1.0]])).tolist() == [[2.0 + 3.0]]


SPRING = """
<mujoco>
  <worldbody>
    <body name="sled"><joint name="rail" type="slide" axis="1 0 0" stiffness="8" springref="0.5" damping="3"/>
    <geom size="0.1" mass="2"/><site name="sled"/></body>
  </worldbody>
  {rest}
</mujoco>
"""
FLUID = '<option density="1.2"/>'
TENDON = '<tendon><fixed stiffness="5"><joint joint="rail" coef="1"/></fixed></tendon>'
PLACE = '<sensor><force site="sled"/><framepos objtype="site" objname="sled"/></sensor>'
FORCE = '<sensor><force site="sled"/></sensor>'


@pytest.mark.parametrize(
    ("rest", "old", "new", "field", "is_whole"),
    [
        ("", "", "", PASSIVE, False),
        ("", "", "", "qfrc_bias", True),
        ("", "", "", "geom_xpos", True),
        (FORCE, "", "", "sensordata", False),
        (PLACE, "", "", "sensordata", True),
        (FLUID, "", "", PASSIVE, True),
        (TENDON, "", "", PASSIVE, True),
        (TENDON, "", "", "xpos", False),
        ("", "<body ", '<body gravcomp="0.5" ', PASSIVE, True),
        ("", 'type="slide" axis="1 0 0"', 'type="ball"', PASSIVE, True),
        ('<option><flag spring="disable"/></option>', "", "", PASSIVE, True),
        ('<option><flag damper="disable"/></option>', "", "", PASSIVE, True),
    ],
)
def test_what_is_not_known_to_be_equal_gets_the_whole_pass(
    rest: str, old: str, new: str, field: str, is_whole: bool
) -> None:
    """A field is current after a step in any case: equal to that of `mj_step1` in the state that the step led to."""
    model = mujoco.MjModel.from_xml_string(SPRING.format(rest=rest).replace(old, new))
    assert second_pass(model, (field, "xpos")).is_whole == is_whole
    physics = CpuPhysics(model, 1, 1, (field, "xpos"))
    physics.qvel[:] = 0.4
    data = mujoco.MjData(model)
    for _ in range(3):
        # A sensor of forces, and only it, is of the step itself.
        data.qpos[:], data.qvel[:] = physics.qpos[0].numpy(), physics.qvel[0].numpy()
        mujoco.mj_step(model, data)
        mujoco.mj_step1(model, data)
        physics.advance(1)
        assert physics._fields[field][0].tobytes() == getattr(data, field).tobytes()
        assert physics._fields["xpos"][0].tobytes() == data.xpos.tobytes()
