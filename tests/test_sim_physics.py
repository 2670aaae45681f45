"""The CPU back end: live views, one simulation's trouble stays its own, and a state is a whole state."""

from pathlib import Path

import mujoco
import pytest
import torch

from porse.errors import TaskError
from porse.sim.drag import kept_share
from porse.sim.drives import Drive
from porse.sim.physics import CpuPhysics

BALL = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body name="ball" pos="0 0 1"><freejoint name="ball"/><geom name="ball" size="0.1" mass="2"/></body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def physics() -> CpuPhysics:
    """Returns three falling balls."""
    return CpuPhysics(mujoco.MjModel.from_xml_string(BALL), 3, 1, ("xpos",))


def test_a_ball_falls_as_it_should(physics: CpuPhysics) -> None:
    """Two semi-implicit steps: v = -g 0.02, z = 1 - g 0.01^2 (1 + 2); the derived field agrees with the state."""
    assert not physics.advance(2).any()
    assert torch.allclose(physics.qvel[:, 2], torch.full((3,), -9.81 * 0.02, dtype=torch.float64))
    assert torch.allclose(physics.qpos[:, 2], torch.full((3,), 1 - 9.81 * 3e-4, dtype=torch.float64))
    assert torch.equal(physics.read("xpos")[:, 1], physics.qpos[:, :3].float())


def test_a_write_is_the_state(physics: CpuPhysics) -> None:
    """A written height holds at the next call; a force of m g on one ball keeps it where it is."""
    physics.qpos[1, 2] = 5.0
    physics.force[1, 1, 2] = 2 * 9.81
    physics.advance(1)
    assert float(physics.qpos[1, 2]) == pytest.approx(5.0)
    assert float(physics.qpos[0, 2]) < 1.0


def test_a_bad_simulation_is_reported_and_the_others_go_on(
    physics: CpuPhysics, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """NaN and a huge speed are both reported; nothing is printed and no file is written; a restart heals."""
    monkeypatch.chdir(tmp_path)
    physics.qvel[0, 0] = float("nan")
    physics.qvel[2, 1] = 1e6
    assert physics.advance(2).tolist() == [True, False, True]
    assert capfd.readouterr() == ("", "")
    assert list(tmp_path.iterdir()) == []
    physics.restart(torch.tensor([0, 2]))
    assert physics.advance(2).tolist() == [False, False, False]
    assert float(physics.qpos[0, 2]) == pytest.approx(1 - 9.81 * 3e-4)


def test_refresh_touches_only_its_simulations(physics: CpuPhysics) -> None:
    """The derived field of the others stays what it was."""
    physics.advance(1)
    before = physics.read("xpos")
    physics.qpos[:, 2] = 7.0
    physics.refresh(torch.tensor([1]))
    assert physics.read("xpos")[:, 1, 2].tolist() == [before[0, 1, 2], 7.0, before[2, 1, 2]]
    assert physics.read("xpos", torch.tensor([1])).shape == (1, 2, 3)


def test_a_state_is_a_copy_and_continues_exactly(physics: CpuPhysics) -> None:
    """Two continuations from one state are equal bit for bit."""
    physics.qvel[:, 3:] = torch.tensor([1.0, 2.0, 3.0])
    physics.advance(3)
    saved = physics.state()
    physics.advance(5)
    first = physics.state()
    assert not torch.equal(first, saved)
    physics.load_state(saved)
    physics.advance(5)
    assert torch.equal(physics.state(), first)


def test_a_dragged_ball_moves_as_the_formula_says(physics: CpuPhysics) -> None:
    """c = 30 and dt = 0.01 keep 0.7 of a velocity: 2 kg from 3 m/s under 8 N, v' = 0.7 (v + 0.04), is 2.128 then 1.5176.

    The other degrees of freedom keep all of theirs.
    """
    share = kept_share(30.0, 0.01)
    assert share == pytest.approx(0.7)
    physics.kept = torch.tensor([share, 1.0, 1.0, 1.0, 1.0, 1.0], dtype=torch.float64)
    physics.qvel[0, 0], physics.qvel[0, 1] = 3.0, 5.0
    physics.force[0, 1, 0] = share * 8.0
    physics.advance(1)
    assert float(physics.qvel[0, 0]) == pytest.approx(2.128)
    physics.advance(1)
    assert float(physics.qvel[0, 0]) == pytest.approx(1.5176)
    assert float(physics.qvel[0, 1]) == pytest.approx(5.0)


def test_several_dragged_steps_are_so_many_single_ones(physics: CpuPhysics) -> None:
    """Three steps at once and one after the other end alike, bit for bit, derived fields included."""
    physics.kept = torch.tensor([0.7, 0.9, 1.0, 0.5, 1.0, 1.0], dtype=torch.float64)
    physics.qvel[:] = torch.tensor([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], dtype=torch.float64)
    saved = physics.state()
    physics.advance(3)
    at_once, places = physics.state(), physics.read("xpos")
    physics.load_state(saved)
    for _ in range(3):
        physics.advance(1)
    assert torch.equal(physics.state(), at_once)
    assert torch.equal(physics.read("xpos"), places)


def test_a_step_begins_at_the_highest_speed_at_most(physics: CpuPhysics) -> None:
    """A bound of 2 m/s on x: -5 m/s is -2 after a step; on z gravity adds its 0.0981 m/s to the bound of 3."""
    physics.fastest = torch.tensor([2.0, torch.inf, 3.0, torch.inf, torch.inf, torch.inf], dtype=torch.float64)
    physics.qvel[0, :3] = torch.tensor([-5.0, 5.0, -4.0], dtype=torch.float64)
    physics.advance(1)
    assert physics.qvel[0, :3].tolist() == pytest.approx([-2.0, 5.0, -3.0981])


def test_several_bounded_steps_are_so_many_single_ones(physics: CpuPhysics) -> None:
    """A ball comes to the bound in the third of five steps, one is faster from the start, one is held; then that one blows up.

    Without a bound the first would be at 5 g 0.01 = 0.4905 m/s; it begins its last step at 0.25 m/s.
    """
    physics.fastest = torch.tensor([torch.inf, torch.inf, 0.25, torch.inf, torch.inf, torch.inf], dtype=torch.float64)
    physics.qvel[1, 2] = -3.0
    physics.force[2, 1, 2] = 2 * 9.81
    saved = physics.state()
    assert not physics.advance(5).any()
    at_once, places = physics.state(), physics.read("xpos")
    assert physics.qvel[:, 2].tolist() == pytest.approx([-0.25 - 0.0981, -0.25 - 0.0981, 0.0], abs=1e-12)
    physics.load_state(saved)
    for _ in range(5):
        physics.advance(1)
    assert torch.equal(physics.state(), at_once)
    assert torch.equal(physics.read("xpos"), places)
    physics.load_state(saved)
    physics.qvel[2, 0] = float("nan")
    assert physics.advance(5).tolist() == [False, False, True]
    assert torch.equal(physics.state()[:2], at_once[:2])


def test_the_same_drag_as_an_implicit_damping() -> None:
    """c = 100 at 1/120 s is c' = 600 there: (1 - 100/120) (v + F dt / m) = (v + F dt / m) / (1 + 600/120)."""
    dt = 1 / 120
    assert 100.0 / kept_share(100.0, dt) == pytest.approx(600.0)
    damped = BALL.replace('<freejoint name="ball"/>', f'<joint type="slide" axis="1 0 0" damping="{600.0 * 2}"/>')
    model = mujoco.MjModel.from_xml_string(damped.replace('timestep="0.01"', f'timestep="{dt}" gravity="0 0 0"'))
    data = mujoco.MjData(model)
    data.qvel[0], data.qfrc_applied[0] = 3.0, 800.0
    mujoco.mj_step(model, data)
    assert float(data.qvel[0]) == pytest.approx(kept_share(100.0, dt) * (3.0 + 800.0 * dt / 2))


def test_a_drag_that_turns_a_link_back_is_refused() -> None:
    with pytest.raises(TaskError, match=r"would keep -0\.2 "):
        kept_share(120.0, 0.01)


def test_explicit_gains_do_in_a_step_what_the_implicit_drive_does() -> None:
    """k = 400, d = 80, I = 0.1, dt = 0.01, from rest and 0.05 rad away: 0.1 v = 0.01 (400 (0.05 - 0.01 v) - 80 v).

    So v = 0.2 / 0.94; and the lead at which it turns at 2 rad/s is (80 / 400 + 0.01) 2.
    """
    drive = Drive(stiffness=400.0, damping=80.0, limit=12.0, fastest=2.0).explicit(0.1, 0.01)
    assert drive.stiffness * 0.05 * 0.01 / 0.1 == pytest.approx(0.2 / 0.94)
    assert drive.lead == pytest.approx(0.42)
    assert (drive.limit, drive.fastest) == (12.0, 2.0)
