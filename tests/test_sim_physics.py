"""The CPU back end: live views, one simulation's trouble stays its own, and a state is a whole state."""

from pathlib import Path

import mujoco
import pytest
import torch

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
