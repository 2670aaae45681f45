"""Over: the scene, success by construction, the near miss, and the statistic of finished episodes."""

import math

import pytest
import torch

from porse.tasks.hands import shadow
from porse.tasks.over import Over


@pytest.fixture
def task() -> Over:
    """Returns two environments."""
    return Over(2, 0, 1)


def put_egg(task: Over, env: int, position: tuple[float, float, float]) -> None:
    """Puts the egg of one environment at a position, still, turned as its goal."""
    physics = task._physics
    start = int(physics.model.joint("object").qposadr[0])
    speed = int(physics.model.joint("object").dofadr[0])
    physics.qpos[env, start : start + 3] = torch.tensor(position, dtype=torch.float64)
    physics.qpos[env, start + 3 : start + 7] = physics.mocap_quat[env, 0]
    physics.qvel[env, speed : speed + 6] = 0.0


def look(task: Over) -> None:
    """Measures the scene as it is, without a step."""
    everyone = torch.arange(task.num_envs)
    task._physics.refresh(everyone)
    task._measure_started(everyone)


def test_the_egg_at_the_goal_is_a_success_and_just_outside_is_not(task: Over) -> None:
    """2.9 cm from the goal counts, 3.1 cm does not."""
    put_egg(task, 0, (0.0, -0.64, 0.54 + 0.029))
    put_egg(task, 1, (0.0, -0.64, 0.54 + 0.031))
    look(task)
    assert task.succeeded().tolist() == [True, False]
    assert task.sparse_reward().tolist() == [1.0, 0.0]


def test_human_reward_at_the_goal_and_beside_it(task: Over) -> None:
    """exp(0) = 1 in the goal pose; 10 cm off: exp(-0.2 * 50 * 0.1) = exp(-1)."""
    put_egg(task, 0, (0.0, -0.64, 0.54))
    put_egg(task, 1, (0.0, -0.64, 0.64))
    look(task)
    assert task.human_reward().tolist() == pytest.approx([1.0, math.exp(-1.0)], abs=1e-3)


def test_success_latches_and_is_counted_when_the_episode_ends(task: Over) -> None:
    """Environment 0 succeeds, then drops the egg: 1 where finished, the old mean 0 elsewhere, so 1/2."""
    put_egg(task, 0, (0.0, -0.64, 0.54))
    put_egg(task, 1, (0.0, 0.0, 5.0))
    task.step(torch.zeros(2, 40))
    assert task.successes.tolist() == [1.0, 0.0]
    assert task.fitness() == 0.0
    put_egg(task, 0, (0.0, -0.5, 0.1))
    task.step(torch.zeros(2, 40))
    assert task.terminated().tolist() == [True, False]
    assert task.fitness() == pytest.approx(0.5)
    task.reset(task.terminated())
    assert task.successes.tolist() == [0.0, 0.0]
    task.step(torch.zeros(2, 40))
    assert task.fitness() == pytest.approx(0.5)


def test_the_hands_are_the_originals(task: Over) -> None:
    """5.011 kg each; palm points 0.37 m from the mounts, toward each other, palms up, thumbs on opposite sides."""
    model = task._physics.model
    assert model.body("right/hand mount").subtreemass[0] == pytest.approx(5.011)
    task._physics.restart(torch.arange(2))
    look(task)
    right, left = task.rigid_body_states[0, 3], task.rigid_body_states[0, 29]
    assert right[:3].tolist() == pytest.approx([0.0, -0.29, 0.49], abs=1e-5)
    assert left[:3].tolist() == pytest.approx([0.0, -0.71, 0.49], abs=1e-5)
    assert task.fingertip_pos[0, 1].tolist() == pytest.approx([-0.011, -0.459, 0.49], abs=1e-5)
    assert task.fingertip_another_pos[0, 1].tolist() == pytest.approx([0.011, -0.541, 0.49], abs=1e-5)


def test_the_joint_table_is_the_models(task: Over) -> None:
    """Names and ranges in `shadow` are those of the compiled hands; so are the bodies, in order."""
    model = task._physics.model
    for side in ("right", "left"):
        for name, limits in zip(shadow.JOINTS, shadow.RANGES, strict=True):
            assert tuple(model.joint(f"{side}/{name}").range) == limits
        first = model.body(f"{side}/hand mount").id
        assert [model.body(first + i).name for i in range(26)] == [f"{side}/{name}" for name in shadow.BODIES]


def test_actions_are_absolute_joint_targets(task: Over) -> None:
    """-1 is a joint's lower limit, 1 its upper one, right hand first."""
    actions = torch.full((2, 40), -1.0)
    actions[:, 20] = 1.0
    task.step(actions)
    lower = [shadow.RANGES[shadow.JOINTS.index(joint)][0] for joint in shadow.ACTUATED]
    assert task._physics.ctrl[0, :20].tolist() == pytest.approx(lower)
    assert float(task._physics.ctrl[0, 20]) == pytest.approx(0.14)


def test_velocities_are_those_of_the_body_frames(task: Over) -> None:
    """The egg in free flight: its listed velocity is that of its joint."""
    put_egg(task, 0, (0.0, -0.5, 2.0))
    speed = int(task._physics.model.joint("object").dofadr[0])
    task._physics.qvel[0, speed : speed + 3] = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64)
    look(task)
    assert task.object_linvel[0].tolist() == pytest.approx([1.0, 2.0, 3.0], abs=1e-5)


def test_starts_are_spread_as_stated() -> None:
    """The egg within 1 cm of its place, random orientations, both hands with the same joints within their ranges."""
    task = Over(200, 3, 1)
    offset = task.object_pos - torch.tensor(Over.EGG_START)
    assert 0.009 < float(offset.abs().max()) <= 0.01 + 1e-6
    assert torch.equal(task.shadow_hand_dof_pos, task.shadow_hand_another_dof_pos)
    assert float(task.object_rot.std(dim=0).min()) > 0.1
    assert torch.allclose(task.goal_pos, torch.tensor(Over.GOAL).expand(200, 3))
