"""The two-hand tasks: start distances, success by construction and the near miss, and rewards by pencil.

The start distances are those computed from the original assets, so they hold the hands' base poses and the handles.
"""

import math
from collections.abc import Callable
from typing import cast

import mujoco
import pytest
import torch

from porse.sim.physics import CpuPhysics
from porse.tasks import make_task
from porse.tasks.bottle_cap import BottleCap
from porse.tasks.hands.doors import DoorTask
from porse.tasks.hands.free_hands import FreeHandTask
from porse.tasks.hands.switches import LIMIT, SwitchTask
from porse.tasks.hands.two_hands import TwoHandTask
from porse.tasks.lift_underarm import LiftUnderarm
from porse.tasks.push_block import PushBlock
from porse.tasks.re_orientation import ReOrientation
from porse.tasks.success import SuccessTask

Setup = Callable[[TwoHandTask, int, bool], None]


def look(task: TwoHandTask) -> None:
    """Measures the scene as it is, without a step."""
    everyone = torch.arange(task.num_envs)
    task._physics.refresh(everyone)
    task._measure_started(everyone)


def set_joint(task: TwoHandTask, env: int, joint: str, *values: float) -> None:
    """Writes a joint's position in one environment; a free joint may get its position only."""
    start = int(task._physics.model.joint(joint).qposadr[0])
    task._physics.qpos[env, start : start + len(values)] = torch.tensor(values, dtype=torch.float64)


def free_hands(name: str, num_envs: int = 1) -> FreeHandTask:
    """Returns a task whose hands move as wholes."""
    return cast(FreeHandTask, make_task(name, num_envs, seed=0))


# Start distances: sums over the five fingertips.

STARTS = {
    "DoorCloseInward": ("door_right_handle", "door_left_handle", 0.64, 0.77),
    "DoorCloseOutward": ("door_right_handle", "door_left_handle", 2.65, 2.65),
    "DoorOpenInward": ("door_right_handle", "door_left_handle", 1.05, 1.17),
    "DoorOpenOutward": ("door_right_handle", "door_left_handle", 1.01, 1.09),
    "Switch": ("switch_right_handle", "switch_left_handle", 0.72, 0.72),
    "Kettle": ("kettle_handle", "bucket_handle", 0.83, 1.15),
    "BlockStack": ("block_right_handle", "block_left_handle", 0.54, 0.54),
}


@pytest.mark.parametrize("name", sorted(STARTS))
def test_hands_start_as_far_from_their_handles_as_in_the_original(name: str) -> None:
    right, left, right_reach, left_reach = STARTS[name]
    task = free_hands(name)
    assert float(task.reach("right", getattr(task, f"{right}_pos"))) == pytest.approx(right_reach, abs=0.01)
    assert float(task.reach("left", getattr(task, f"{left}_pos"))) == pytest.approx(left_reach, abs=0.01)


@pytest.mark.parametrize(
    ("name", "lift", "right_reach", "left_reach"),
    [("Scissors", 0.007, 1.53, 1.26), ("Pen", 0.018, 1.25, 1.38), ("GraspAndPlace", 0.025, 1.18, 1.18),
     ("PushBlock", 0.025, 1.178, 1.178), ("SwingCup", 0.085, 1.45, 1.30)],
)  # fmt: skip
def test_objects_that_start_on_the_table_were_only_lifted(
    name: str, lift: float, right_reach: float, left_reach: float
) -> None:
    """Lowered again by as much as they are lifted out of the table, they are where the original starts them."""
    task = free_hands(name)
    handles = {
        "Scissors": ("scissors_right_handle", "scissors_left_handle"),
        "Pen": ("pen_right_handle", "pen_left_handle"),
        "SwingCup": ("cup_right_handle", "cup_left_handle"),
    }.get(name, ("block_right_handle", "block_left_handle"))
    down = torch.tensor([0.0, 0.0, lift])
    # The bucket of GraspAndPlace is lifted by 5.4 cm, its cube by 2.5 cm.
    more = torch.tensor([0.0, 0.0, 0.029]) if name == "GraspAndPlace" else torch.zeros(3)
    right = getattr(task, f"{handles[0]}_pos") - down - more
    left = getattr(task, f"{handles[1]}_pos") - down
    assert float(task.reach("right", right)) == pytest.approx(right_reach, abs=0.01)
    assert float(task.reach("left", left)) == pytest.approx(left_reach, abs=0.01)


def test_palms_of_lift_underarm_and_bottle_cap_start_where_the_originals_do() -> None:
    """0.139 m from the pot's handles before they are lifted by 1.6 cm; 0.16 m from the cap, 0.05 m from the bottle."""
    pot = cast(LiftUnderarm, make_task("LiftUnderarm", 1, seed=0))
    lowered = pot.pot_right_handle_pos - torch.tensor([0.0, 0.0, 0.016])
    assert float(torch.norm(lowered - pot.right_hand_pos)) == pytest.approx(0.139, abs=1e-3)
    bottle = cast(BottleCap, make_task("BottleCap", 1, seed=0))
    assert float(torch.norm(bottle.bottle_cap_pos - bottle.right_hand_pos)) == pytest.approx(0.16, abs=0.01)
    assert float(torch.norm(bottle.bottle_pos - bottle.left_hand_pos)) == pytest.approx(0.05, abs=0.01)


# Success by construction (good) and the near miss.


def caught(goal: tuple[float, float, float]) -> Setup:
    """Puts the egg 2.9 or 3.1 cm above its goal."""

    def setup(task: TwoHandTask, env: int, good: bool) -> None:
        set_joint(task, env, "object", goal[0], goal[1], goal[2] + (0.029 if good else 0.031))

    return setup


def hinges(good_angle: float, bad_angle: float) -> Setup:
    """Sets both panels of a door."""

    def setup(task: TwoHandTask, env: int, good: bool) -> None:
        for panel in ("link_1_hinge", "link_2_hinge"):
            set_joint(task, env, panel, good_angle if good else bad_angle)

    return setup


def joint(name: str, good_value: float, bad_value: float) -> Setup:
    """Sets one joint."""

    def setup(task: TwoHandTask, env: int, good: bool) -> None:
        set_joint(task, env, name, good_value if good else bad_value)

    return setup


def two_caught(task: TwoHandTask, env: int, good: bool) -> None:
    set_joint(task, env, "object", 0.0, -0.79, 0.57)
    set_joint(task, env, "object_another", 0.0, -0.38, 0.54 + (0.029 if good else 0.031))


def turned(task: TwoHandTask, env: int, good: bool) -> None:
    """Turns the second cube 0.098 or 0.102 rad about z from its goal."""
    angle = 0.098 if good else 0.102
    w, x, y, z = task._physics.mocap_quat[env, 1].tolist()
    c, s = math.cos(angle / 2), math.sin(angle / 2)
    place = (0.0, -0.76, 0.6)
    set_joint(task, env, "object_another", *place, c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)


def swung(task: TwoHandTask, env: int, good: bool) -> None:
    yaw = 1.5 * math.pi - (0.78 if good else 0.79)
    set_joint(task, env, "object", 0.0, 0.0, 0.685, math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))


def poured(task: TwoHandTask, env: int, good: bool) -> None:
    """Puts the bucket point (0.1 m below the bucket) 4.9 or 5.1 cm above the spout at (0, -0.2, 0.57)."""
    set_joint(task, env, "bucket", -0.0002, -0.2, 0.67 + (0.049 if good else 0.051))


def lifted(task: TwoHandTask, env: int, good: bool) -> None:
    set_joint(task, env, "object", 0.0, -0.6, 0.85 - (0.049 if good else 0.051))


def placed(task: TwoHandTask, env: int, good: bool) -> None:
    set_joint(task, env, "block", 0.0, 0.2 - (0.199 if good else 0.201), 0.654)


def pushed(task: TwoHandTask, env: int, good: bool) -> None:
    set_joint(task, env, "block", -0.2, -0.2 + 0.099, 0.625)
    set_joint(task, env, "object", -0.2, 0.2 - (0.099 if good else 0.101), 0.625)


def stacked(task: TwoHandTask, env: int, good: bool) -> None:
    set_joint(task, env, "object", 0.0, 0.0, 0.625)
    set_joint(task, env, "block", 0.0, 0.0, 0.675 + (0.029 if good else 0.031))


def pressed(task: TwoHandTask, env: int, good: bool) -> None:
    for rocker in ("object_rocker", "other_rocker"):
        set_joint(task, env, rocker, 0.05 if good else 0.1)


SUCCESS: dict[str, Setup] = {
    "CatchUnderarm": caught((0.0, -0.79, 0.54)),
    "CatchAbreast": caught((-0.39, -1.15, 0.54)),
    "CatchOver2Underarm": caught((0.0, -0.4, 0.55)),
    "TwoCatchUnderarm": two_caught,
    "ReOrientation": turned,
    "DoorCloseInward": hinges(1.0, 1.02),
    "DoorCloseOutward": hinges(1.205, 1.225),
    "DoorOpenInward": hinges(1.02, 1.0),
    "DoorOpenOutward": hinges(1.225, 1.205),
    "Scissors": joint("scissors", -0.299, -0.301),
    "SwingCup": swung,
    "SwitchReachable": pressed,
    "Kettle": poured,
    "LiftUnderarm": lifted,
    "Pen": joint("cap", 0.132, 0.128),
    "BottleCap": joint("pull", 0.0285, 0.0275),
    "GraspAndPlace": placed,
    "BlockStack": stacked,
    "PushBlock": pushed,
}


@pytest.mark.parametrize("name", sorted(SUCCESS))
def test_success_is_seen_and_the_near_miss_is_not(name: str) -> None:
    """Environment 0 is put into success, environment 1 just beside it."""
    task = cast(TwoHandTask, make_task(name, 2, seed=0))
    assert not task.succeeded().any()
    SUCCESS[name](task, 0, True)
    SUCCESS[name](task, 1, False)
    look(task)
    assert task.succeeded().tolist() == [True, False]


def test_switch_cannot_be_solved_as_shipped() -> None:
    """Over the rockers' whole range the points are too high; only a point below the range would count."""
    task = cast(SwitchTask, make_task("Switch", 20, seed=0))
    for env in range(20):
        for rocker in ("object_rocker", "other_rocker"):
            set_joint(task, env, rocker, LIMIT * env / 19)
    look(task)
    assert not task.succeeded().any()
    heights = task.switch_right_handle_pos[:, 2]
    assert float(heights.min()) == pytest.approx(0.6917, abs=1e-4)
    assert float(heights.max()) == pytest.approx(0.7023, abs=1e-4)
    task.switch_right_handle_pos = task.switch_left_handle_pos = torch.full((20, 3), 0.674)
    assert bool(task.succeeded().all())


def test_a_rocker_can_be_pressed() -> None:
    """SwitchReachable: 3 N down on each tracked point, 2 cm beside the axis, for a second is a success."""
    task = cast(SwitchTask, make_task("SwitchReachable", 1, seed=0))
    model = task._physics.model
    for name in ("object_link_0", "other_link_0"):
        task._physics.force[0, model.body(name).id, 2] = -3.0
        task._physics.force[0, model.body(name).id, 4] = 3.0 * 0.02
    for _ in range(60):
        task.step(torch.zeros(1, 52))
    assert bool(task.succeeded())


def test_half_a_credit_of_push_block_latches() -> None:
    """Only the left cube there: 1/2, and it stays 1/2 when the right one arrives; both at once: 1."""
    task = cast(PushBlock, make_task("PushBlock", 2, seed=0))
    set_joint(task, 0, "block", -0.2, -0.2, 0.625)
    pushed(task, 1, True)
    look(task)
    assert task.sparse_reward().tolist() == [0.5, 1.0]
    task._count()
    pushed(task, 0, True)
    look(task)
    task._count()
    assert task.successes.tolist() == [0.5, 1.0]


def test_hits_of_re_orientation_are_counted_and_averaged() -> None:
    """Two hits in an episode: a new goal after each; C = 0.01 * 2 when it ends, and 0.99 of that after one without."""
    task = cast(ReOrientation, make_task("ReOrientation", 1, seed=0))
    for hits in (1, 2):
        before = task._physics.mocap_quat.clone()
        turned(task, 0, True)
        look(task)
        task._record()
        assert float(task.successes) == hits
        assert float(task.human_reward()) > 400.0
        task.step(torch.zeros(1, 40))
        assert not torch.equal(before, task._physics.mocap_quat)
        task._hit[:] = False
    task.successes[:] = 2.0
    task.progress[:] = task.TIME_LIMIT - 1
    task.step(torch.zeros(1, 40))
    assert task.fitness() == pytest.approx(0.02)
    task.reset(task.timed_out())
    task.progress[:] = task.TIME_LIMIT - 1
    task.step(torch.zeros(1, 40))
    assert task.fitness() == pytest.approx(0.0198)


def test_outcomes_are_kept_for_each_environment_or_as_a_mean() -> None:
    """Two environments, the first ends solved: the mean is 1/2 both ways. It starts again and ends unsolved.

    Per environment, outcomes (1, 0) become (0, 0): 0. With the mean, (1/2, 1/2) become (0, 1/2): 1/4.
    """
    for name, after in (("CatchUnderarm", 0.0), ("Scissors", 0.25)):
        task = cast(SuccessTask, make_task(name, 2, seed=0))
        task.successes = torch.tensor([1.0, 0.0])
        task.progress[0] = task.TIME_LIMIT
        task._record()
        assert task.fitness() == pytest.approx(0.5)
        task.successes[:] = 0.0
        task._record()
        assert task.fitness() == pytest.approx(after)


# Human rewards: fingertips put 1 cm beside their handles, so each reach is 5 * 0.01 = 0.05.


def near(name: str, right: str, left: str) -> FreeHandTask:
    """Returns a task whose fingertips are all 1 cm beside their handles."""
    task = free_hands(name)
    beside = torch.tensor([0.01, 0.0, 0.0])
    task._tips = torch.stack((getattr(task, f"{right}_pos"), getattr(task, f"{left}_pos")), dim=1).unsqueeze(2) + beside
    task._tips = task._tips.expand(-1, -1, 5, -1)
    return task


@pytest.mark.parametrize(
    ("name", "right", "left", "expected"),
    [
        ("DoorCloseInward", "door_right_handle", "door_left_handle", 2 - 0.1 + 1 - 2 * 0.926),
        ("DoorCloseOutward", "door_right_handle", "door_left_handle", 6 - 0.1 + 1 - 2 * 0.766),
        ("DoorOpenInward", "door_right_handle", "door_left_handle", 2 - 0.1 + 2 * 0.067),
        ("DoorOpenOutward", "door_right_handle", "door_left_handle", 2 - 0.1 + 2 * 0.067),
        ("Scissors", "scissors_right_handle", "scissors_left_handle", 2 - 0.1),
        ("SwingCup", "cup_right_handle", "cup_left_handle", -0.1 + 1 / (math.pi + 0.1) - 1),
        ("Switch", "switch_right_handle", "switch_left_handle", 2 - 0.1 + 50 * (1.4 - 2 * 0.6917)),
        ("Kettle", "kettle_handle", "bucket_handle", 1 - 0.1 + 0.5 - 2 * math.hypot(0.1, 0.17)),
        ("Pen", "pen_right_handle", "pen_left_handle", 5 * 0.17 - 0.8 + 2 * math.exp(-0.5)),
        ("BottleCap", "bottle_cap", "bottle_cap", 2 - 0.05 - 0.0485 + 30 * 0.01026),
        ("GraspAndPlace", "block_right_handle", "block_left_handle", 2 * math.exp(-0.5) + 2 * math.exp(-4.0105)),
        ("PushBlock", "block_right_handle", "block_left_handle", 2 * 1.15 + 5 - 5 * 0.4),
        ("BlockStack", "block_right_handle", "block_left_handle", 1.5 - 0.1 + 2 * (0.24 - 0.1118 - 0.1)),
    ],
)
def test_human_reward_at_the_start_with_the_hands_at_their_handles(
    name: str, right: str, left: str, expected: float
) -> None:
    assert float(near(name, right, left).human_reward()) == pytest.approx(expected, abs=6e-3)


def test_human_reward_far_from_the_handles_is_the_constant_minus_the_reaches() -> None:
    """DoorOpenInward at its start: 2 - 1.05 - 1.17."""
    assert float(free_hands("DoorOpenInward").human_reward()) == pytest.approx(-0.22, abs=0.01)


def test_human_reward_of_lift_underarm() -> None:
    """Palms 5 cm from the handles, pot 0.384 m from its goal: 0.2 - 0.1 + 3 (0.385 - 0.384)."""
    task = cast(LiftUnderarm, make_task("LiftUnderarm", 1, seed=0))
    beside = torch.tensor([0.05, 0.0, 0.0])
    task.right_hand_pos, task.left_hand_pos = task.pot_right_handle_pos + beside, task.pot_left_handle_pos + beside
    assert float(task.human_reward()) == pytest.approx(0.103, abs=1e-4)


# Hands and doors move as they should.


def test_a_push_moves_the_hand_at_the_speed_that_the_drag_allows() -> None:
    """An action of 1 is 833.5 N, 1.386 m/s in a physics step for 5.011 kg; of its velocity a hand keeps 1 - 0.8335.

    So v = 0.1665 (v + 1.386), 0.277 m/s along the pushed axis; the other hand stays.
    """
    task = free_hands("DoorOpenInward")
    actions = torch.zeros(1, 52)
    actions[0, 2] = 1.0
    for _ in range(30):
        task.step(actions)
    speeds = [float(task._physics.qvel[0, int(task._physics.model.joint(f"right/base_{a}").dofadr[0])]) for a in "xyz"]
    assert speeds == pytest.approx([0.0, 0.0, 0.277], abs=0.01)
    assert float(task.root_state_tensor[0, 1, 7:10].abs().max()) < 0.1


@pytest.mark.parametrize("name", ["DoorCloseInward", "DoorCloseOutward", "DoorOpenInward", "DoorOpenOutward"])
def test_a_door_left_alone_stays(name: str) -> None:
    """After a second without a push at the hands, the handles are as far apart as at the start, within 3 cm."""
    task = cast(DoorTask, make_task(name, 1, seed=0))
    start = float(task.separation())
    for _ in range(60):
        task.step(torch.zeros(1, 52))
    assert float(task.separation()) == pytest.approx(start, abs=0.03)


def test_the_bottle_rests_in_the_palm_for_a_while() -> None:
    """Half a second without a push at the hands, and the bottle is still there."""
    task = make_task("BottleCap", 1, seed=0)
    for _ in range(30):
        task.step(torch.zeros(1, 52))
        assert not task.terminated().any()


def test_forearms_that_are_pushed_together_with_full_force_do_not_enter_each_other() -> None:
    """Side by side, each pushed toward the other with 833 N, at up to 0.56 m/s: they end a little under 6 mm apart."""
    task = make_task("SwitchReachable", 1, seed=0)
    physics = task._physics
    assert isinstance(physics, CpuPhysics)
    forearms = {physics.model.geom(f"{side}/C_forearm").id for side in ("right", "left")}
    data = mujoco.MjData(physics.model)
    push = torch.zeros(1, 52)
    push[0, 1], push[0, 26 + 1] = -1.0, 1.0
    gaps: list[float] = []
    for _ in range(90):
        task.step(push)
        physics._batch.get_data(0, data)
        mujoco.mj_fwdPosition(physics.model, data)
        gaps += [float(c.dist) for c in data.contact if set(c.geom.tolist()) == forearms]
    assert min(gaps) > 0.0
    assert gaps[-1] == pytest.approx(0.006, abs=0.0005)
