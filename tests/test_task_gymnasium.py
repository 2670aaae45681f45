"""The gymnasium front: spaces, seeds, ends of episodes, and gymnasium's own checks of what reset and step return."""

import ctypes.util
import os
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from porse.errors import TaskError
from porse.gymnasium_front import TaskSingleEnv, TaskVectorEnv, register_tasks
from porse.tasks import TASKS

NAMES = sorted(TASKS)


@pytest.mark.parametrize("name", NAMES)
def test_make_vec_gives_an_environment_that_keeps_its_spaces(name):
    register_tasks()
    env = gymnasium.make_vec(f"porse/{name}-v0", num_envs=3)
    try:
        observations, infos = env.reset(seed=5)
        assert env.observation_space.contains(observations)
        assert infos == {}
        env.action_space.seed(1)
        for _ in range(5):
            observations, rewards, terminated, truncated, _ = env.step(env.action_space.sample())
            assert env.observation_space.contains(observations)
            assert rewards.shape == terminated.shape == truncated.shape == (3,)
            assert rewards.dtype == np.float32
            assert terminated.dtype == truncated.dtype == np.bool_
        assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    finally:
        env.close()


@pytest.mark.filterwarnings("ignore:.*(minimum|maximum) value is -?infinity.*", "ignore:.*alternative render modes.*")
@pytest.mark.parametrize("name", NAMES)
def test_a_single_environment_passes_gymnasiums_own_checker(name):
    register_tasks()
    env = gymnasium.make(f"porse/{name}-v0")
    assert env.unwrapped.spec.id == f"porse/{name}-v0"
    check_env(env.unwrapped, skip_close_check=True, skip_render_check=True)
    env.close()


def test_a_single_environment_is_the_vector_one_with_one_row():
    single, vector = TaskSingleEnv("Quadcopter", "sparse"), TaskVectorEnv("Quadcopter", 1, "sparse")
    first, _ = single.reset(seed=4)
    firsts, _ = vector.reset(seed=4)
    assert np.array_equal(first, firsts[0])
    single.action_space.seed(2)
    for _ in range(5):
        action = single.action_space.sample()
        observation, reward, terminated, truncated, _ = single.step(action)
        observations, rewards, ends, cuts, _ = vector.step(action[None])
        assert np.array_equal(observation, observations[0])
        assert (reward, terminated, truncated) == (rewards[0], ends[0], cuts[0])


def test_a_seed_gives_the_same_episode_again():
    env = TaskVectorEnv("Quadcopter", 4)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(10)]
    runs = []
    for _ in range(2):
        first, _ = env.reset(seed=9)
        runs.append([first, *(env.step(action)[0] for action in actions)])
    assert all(np.array_equal(a, b) for a, b in zip(*runs, strict=True))
    other, _ = env.reset(seed=10)
    assert not np.array_equal(runs[0][0], other)


def test_ended_episodes_begin_anew_and_leave_their_last_observation():
    env = TaskVectorEnv("Quadcopter", 2)
    env.reset(seed=0)
    env._task.progress[0] = env._task.TIME_LIMIT - 1
    observations, _, terminated, truncated, infos = env.step(np.zeros((2, 12), np.float32))
    assert truncated.tolist() == [True, False]
    assert terminated.tolist() == [False, False]
    assert infos["_final_obs"].tolist() == [True, False]
    assert not np.array_equal(infos["final_obs"][0], observations[0])
    assert np.array_equal(infos["final_obs"][1], observations[1])


def test_returned_arrays_are_not_reused():
    env = TaskVectorEnv("Over", 2)
    first, _ = env.reset(seed=0)
    kept = first.copy()
    env.step(np.ones((2, 40), np.float32))
    assert np.array_equal(first, kept)


def test_an_unknown_reward_is_refused():
    for front in (TaskSingleEnv, TaskVectorEnv):
        with pytest.raises(TaskError, match="'dense'"):
            front("Quadcopter", reward="dense")


def test_the_infos_of_a_vector_environment_are_arrays_over_its_environments():
    env = TaskVectorEnv("Quadcopter", 3)
    env.reset(seed=0)
    env._task.progress[1] = env._task.TIME_LIMIT - 1
    *_, infos = env.step(np.zeros((3, 12), np.float32))
    assert infos["fitness"].shape == infos["_fitness"].shape == (3,)
    assert infos["_fitness"].all()
    assert infos["final_info"]["_fitness"].tolist() == infos["_final_info"].tolist() == [False, True, False]


def test_a_reset_mask_starts_the_environments_that_it_names_and_no_others():
    env = TaskVectorEnv("Quadcopter", 3)
    env.reset(seed=0)
    for _ in range(4):
        before, *_ = env.step(np.ones((3, 12), np.float32))
    after, _ = env.reset(options={"reset_mask": np.array([False, True, False])})
    assert [np.array_equal(before[i], after[i]) for i in range(3)] == [True, False, True]
    assert env._task.progress.tolist() == [4, 0, 4]


@pytest.mark.parametrize("mask", [[True, False], np.array([1, 0]), np.array([True]), np.array([False, False])], ids=str)
def test_a_reset_mask_that_is_none_is_refused(mask):
    with pytest.raises(TaskError, match=r"expected reset_mask to be a bool array \(2,\)"):
        TaskVectorEnv("Quadcopter", 2).reset(options={"reset_mask": mask})
    with pytest.raises(TaskError, match="expected no seed beside reset_mask"):
        TaskVectorEnv("Quadcopter", 2).reset(seed=1, options={"reset_mask": np.array([True, False])})


def test_an_unknown_render_mode_is_refused():
    with pytest.raises(TaskError, match="expected render_mode to be None or 'rgb_array', found 'human'"):
        TaskSingleEnv("Quadcopter", render_mode="human")
    assert TaskVectorEnv("Quadcopter", 2).render() is None


FILMED = """
import sys, gymnasium, numpy as np
from gymnasium.wrappers import RecordVideo, RenderCollection
from porse.gymnasium_front import register_tasks
register_tasks()
env = RenderCollection(gymnasium.make("porse/Quadcopter-v0", render_mode="rgb_array"))
env.reset(seed=1)
for _ in range(3):
    env.step(np.ones(12, np.float32))
frames = env.render()
assert len(frames) == 4, len(frames)
assert frames[0].shape == (360, 480, 3) and frames[0].dtype == np.uint8 and frames[0].std() > 1
assert not np.array_equal(frames[0], frames[3])
env.close()
vector = gymnasium.make_vec("porse/Quadcopter-v0", num_envs=2, render_mode="rgb_array")
vector.reset(seed=1)
one, other = vector.render()
assert one.shape == (360, 480, 3) and not np.array_equal(one, other)
vector.close()
try:
    import moviepy
except ImportError:
    sys.exit("no moviepy")
env = RecordVideo(gymnasium.make("porse/Quadcopter-v0", render_mode="rgb_array"), sys.argv[1], video_length=3)
env.reset(seed=1)
for _ in range(4):
    env.step(np.ones(12, np.float32))
env.close()
"""


@pytest.mark.skipif(
    not any(map(ctypes.util.find_library, ("EGL", "OSMesa"))),
    reason="needs EGL or OSMesa: install libegl1 or libosmesa6",
)
def test_gymnasium_films_a_task(tmp_path):
    """In a process of its own: the renderer is chosen before MuJoCo is imported."""
    back_end = "egl" if ctypes.util.find_library("EGL") else "osmesa"
    done = subprocess.run(
        [sys.executable, "-c", FILMED, tmp_path], env=os.environ | {"MUJOCO_GL": back_end}, capture_output=True, text=True,
    )  # fmt: skip
    if done.stderr.strip().endswith("no moviepy"):
        return
    assert done.returncode == 0, done.stderr
    [film] = tmp_path.glob("*.mp4")
    assert film.stat().st_size > 1000
