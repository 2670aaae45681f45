"""What every task means: resets, forces and bounds as properties over all of them; ends and rewards by pencil.

Rewards are computed from measurements that are written here, not from the physics, so that every number is exact. Hands
are near or far in turn: a condition on both hands that would be content with one is found.
"""

import functools
import math

import pytest
import torch

from porse.tasks import TASKS, make_task
from porse.tasks.hands import shadow
from porse.tasks.hands.doors import OpeningTask
from porse.tasks.hands.free_hands import FreeHandTask
from porse.tasks.hands.two_hands import TwoHandTask
from porse.tasks.humanoid.task import GEARS
from porse.tasks.success import SuccessTask
from task_cases import at_rest

NAMES = sorted(TASKS)
FREE = [name for name in NAMES if issubclass(TASKS[name], FreeHandTask)]
ENVS = 3


@functools.cache
def begun(name):
    """One task of three environments for all tests here, and its state at the start."""
    task = make_task(name, ENVS, seed=3)
    return task, task.state()


@pytest.fixture
def fresh(name):
    """The task as it began, whatever an earlier test wrote into it."""
    task, start = begun(name)
    task.load_state(start)
    return task


def each(*names):
    return pytest.mark.parametrize("name", names)


def random_actions(task, seed, size=1.0):
    generator = torch.Generator().manual_seed(seed)
    return size * (2.0 * torch.rand(ENVS, task.NUM_ACTIONS, generator=generator) - 1.0)


# Every task.

LENGTHS = {
    # control steps of an episode and of its time limit, seconds of a control step, physics steps in it
    "Quadcopter": (500, 499, 0.01, 2), "FrankaCabinet": (500, 499, 0.0166, 2), "Anymal": (2500, 2499, 0.02, 8),
    "Humanoid": (1000, 999, 0.0166, 8),
    **{name: (75, 75, 0.01667, 2) for name in ("Over", "CatchUnderarm", "CatchOver2Underarm", "TwoCatchUnderarm")},
    **{name: (125, 125, 0.01667, 2) for name in ("Switch", "SwitchReachable", "Kettle", "Pen", "BottleCap", "PushBlock")},
    **{name: (150, 150, 0.01667, 2) for name in ("CatchAbreast", "Scissors", "SwingCup")},
    **{name: (250, 250, 0.01667, 2) for name in NAMES if name.startswith("Door")}, "BlockStack": (250, 250, 0.01667, 2),
    **{name: (500, 500, 0.01667, 2) for name in ("LiftUnderarm", "GraspAndPlace")},
    "ReOrientation": (600, 600, 0.01667, 2),
}  # fmt: skip


@each(*NAMES)
def test_episodes_and_steps_are_as_long_as_the_originals(name, fresh):
    kind = TASKS[name]
    assert LENGTHS[name] == (kind.EPISODE_LENGTH, kind.TIME_LIMIT, kind.CONTROL_DT, kind.SUBSTEPS)
    assert fresh._physics.model.opt.timestep == pytest.approx(kind.CONTROL_DT / kind.SUBSTEPS)


@each(*NAMES)
def test_a_reset_clears_what_belongs_to_the_episode_and_leaves_the_others(name, fresh):
    for seed in (1, 2, 3):
        fresh.step(random_actions(fresh, seed))
    if isinstance(fresh, SuccessTask):
        fresh.successes = torch.tensor([1.0, 2.0, 3.0])
    forces = [n for n in ("dof_force_tensor", "vec_sensor_tensor", "torques", "_touch") if hasattr(fresh, n)]
    fresh._diverged = torch.tensor([False, True, False])
    if name == "ReOrientation":
        forces.append("_hit")
        fresh._hit = torch.tensor([False, True, True])
    before = {n: getattr(fresh, n).clone() for n in ("actions", "progress", *forces)}
    assert all(bool(value[1].any()) for n, value in before.items() if n != "_touch"), "nothing to clear"
    fresh.reset(torch.tensor([False, True, False]))
    for n, value in before.items():
        after = getattr(fresh, n)
        assert not after[1].any(), n
        assert torch.equal(after[[0, 2]], value[[0, 2]]), n
    assert torch.equal(fresh._physics.force[1], at_rest(fresh))
    assert not fresh.terminated()[1]
    if name == "Humanoid":
        # the way back to the start is no progress
        assert float(fresh.sparse_reward()[1]) == 0.0
    if isinstance(fresh, SuccessTask):
        assert fresh.successes.tolist() == [1.0, 0.0, 3.0]


@each(*NAMES)
def test_actions_beyond_their_bounds_are_actions_at_them(name, fresh):
    actions = random_actions(fresh, 4, size=3.0)
    state = fresh.state()
    fresh.step(actions)
    far = fresh.state()
    assert float(far["actions"].abs().max()) == 1.0
    fresh.load_state(state)
    fresh.step(actions.clamp(-1.0, 1.0))
    for key, value in fresh.state().items():
        assert torch.equal(value, far[key]), key


@each(*NAMES)
def test_observations_are_held_at_the_suites_bound_and_variables_are_not(name, fresh, monkeypatch):
    wide = torch.full((ENVS, fresh.NUM_OBSERVATIONS), -7.0)
    wide[0] = 7.0
    monkeypatch.setattr(fresh, "compute_observations", lambda: wide)
    bound = 5.0 if fresh.FAMILY == "isaac" else 7.0
    assert fresh.observations()[:, 0].tolist() == [bound, -bound, -bound]
    assert fresh.variables()["obs_buf"][:, 0].tolist() == [7.0, -7.0, -7.0]


@each(*NAMES)
def test_fitness_is_of_the_sparse_reward_and_the_human_reward_is_another(name, fresh, monkeypatch):
    fresh.step(random_actions(fresh, 5))
    assert not bool((fresh.human_reward() == fresh.sparse_reward()).any())
    if not isinstance(fresh, SuccessTask):
        assert fresh.fitness() == pytest.approx(float(fresh.sparse_reward().mean()), abs=1e-6)
        return
    monkeypatch.setattr(fresh, "succeeded", lambda: torch.tensor([True, False, True]))
    if name != "PushBlock":
        assert fresh.sparse_reward().tolist() == [1.0, 0.0, 1.0]


@each(*NAMES)
def test_an_episode_ends_by_its_rule_or_by_the_limit(name, fresh, monkeypatch):
    monkeypatch.setattr(fresh, "failed", lambda: torch.tensor([True, False, False]))
    fresh._diverged = torch.tensor([False, False, True])
    assert fresh.terminated().tolist() == [True, False, True]
    fresh.progress[:] = torch.tensor([fresh.TIME_LIMIT - 1, fresh.TIME_LIMIT, fresh.TIME_LIMIT + 1])
    assert fresh.timed_out().tolist() == [False, True, True]


# The statistic of tasks that are solved or not.

OWN_LAST = {
    "DoorCloseInward", "CatchUnderarm", "CatchAbreast", "CatchOver2Underarm", "BlockStack", "BottleCap", "Pen",
}  # fmt: skip
"""Tasks in which an environment counts as its own last outcome until its next one; the originals differ in it."""

COUNTED = [
    name for name in NAMES if issubclass(TASKS[name], SuccessTask) and name not in ("ReOrientation", "PushBlock")
]


@each(*COUNTED)
def test_success_latches_and_counts_when_its_episode_ends(name, fresh, monkeypatch):
    fresh.outcomes = torch.zeros(ENVS)
    ends, solved = torch.zeros(ENVS, dtype=torch.bool), torch.zeros(ENVS, dtype=torch.bool)
    monkeypatch.setattr(fresh, "succeeded", lambda: solved)
    monkeypatch.setattr(fresh, "failed", lambda: ends)
    solved[0] = True
    fresh._record()
    assert (fresh.successes.tolist(), fresh.fitness()) == ([1.0, 0.0, 0.0], 0.0)
    # The first is not solved any more, and ends: 1 of 3 outcomes.
    solved[0], ends[0] = False, True
    fresh._record()
    assert fresh.successes.tolist() == [1.0, 0.0, 0.0]
    assert fresh.fitness() == pytest.approx(1 / 3)
    # The second ends unsolved. Its own last outcome was 0, so (1 + 0 + 0) / 3; as the mean, (1/3 + 0 + 1/3) / 3.
    ends[0], ends[1] = False, True
    fresh._record()
    assert fresh.fitness() == pytest.approx(1 / 3 if name in OWN_LAST else 2 / 9)


@each("ReOrientation")
def test_hits_of_the_episodes_that_end_are_averaged_slowly(name, fresh, monkeypatch):
    ends, hit = torch.tensor([True, True, False]), torch.tensor([False, True, True])
    monkeypatch.setattr(fresh, "succeeded", lambda: hit)
    monkeypatch.setattr(fresh, "failed", lambda: ends)
    fresh.successes, fresh.outcomes = torch.tensor([2.0, 3.0, 8.0]), torch.zeros(ENVS)
    fresh._record()
    # 2 and 3 + 1 hits in the two that ended: 0.01 x 3
    assert fresh.successes.tolist() == [2.0, 4.0, 9.0]
    assert fresh.fitness() == pytest.approx(0.03)
    ends[:2], hit[:] = False, False
    fresh._record()
    assert fresh.fitness() == pytest.approx(0.03)
    # the third with its 9: 0.09 + 0.99 x 0.03
    ends[2] = True
    fresh._record()
    assert fresh.fitness() == pytest.approx(0.1197)


@each("PushBlock")
def test_a_half_stays_a_half(name, fresh, monkeypatch):
    credit = torch.tensor([0.5, 0.0, 1.0])
    monkeypatch.setattr(fresh, "credit", lambda: credit)
    fresh._count()
    credit[:] = torch.tensor([1.0, 0.5, 0.0])
    fresh._count()
    assert fresh.successes.tolist() == [0.5, 0.5, 1.0]


@each("PushBlock")
def test_push_block_pays_a_half_for_the_left_cube_alone(name, fresh):
    places = {"left": torch.tensor(LEFT_GOAL), "right": torch.tensor(RIGHT_GOAL)}
    fresh.left_goal_pos, fresh.right_goal_pos = places["left"].repeat(ENVS, 1), places["right"].repeat(ENVS, 1)
    # both there; left alone; right alone, by 9 and 11 cm
    near, far = torch.tensor([0.0, 0.09, 0.0]), torch.tensor([0.0, 0.11, 0.0])
    fresh.block_left_handle_pos = places["left"] + torch.stack((near, near, far))
    fresh.block_right_handle_pos = places["right"] + torch.stack((near, far, near))
    assert fresh.sparse_reward().tolist() == [1.0, 0.5, 0.0]
    assert fresh.succeeded().tolist() == [True, False, False]


# Forces on free hands.

PUSHES = {
    # N for a force of 1 and N m for a torque of 1: 0.01667 s times the original's scales, times 1e5 and 1e3
    **{name: (833.5, 8.335) for name in NAMES if name.startswith("Door")},
    **{name: (833.5, 1.667) for name in
       ("Scissors", "SwingCup", "Switch", "SwitchReachable", "Kettle", "Pen", "GraspAndPlace", "PushBlock")},
    "CatchUnderarm": (83.35, 8.335), "TwoCatchUnderarm": (83.35, 8.335), "CatchAbreast": (833.5, 16.67),
    "CatchOver2Underarm": (166.7, 33.34), "LiftUnderarm": (416.75, 16.67), "BottleCap": (166.7, 1.667),
    "BlockStack": (333.4, 0.3334),
}  # fmt: skip


@each(*FREE)
def test_a_push_is_so_many_newtons_at_the_forearm_of_its_hand(name, fresh):
    actions = torch.zeros(ENVS, 52)
    right, left = [0.5, -1.0, 0.25, -0.75, 0.1, 1.0], [-0.2, 0.3, 1.0, 0.6, -1.0, 0.4]
    actions[1, 0:6], actions[1, 26:32] = torch.tensor(right), torch.tensor(left)
    fresh.step(actions)
    model, force = fresh._physics.model, fresh._physics.force
    newtons, metres = PUSHES[name]
    for side, push in (("right", right), ("left", left)):
        found = force[1, model.body(f"{side}/forearm").id].tolist()
        # Of what a force does in a step of 0.008335 s, a link with a damping of 100 1/s keeps 1 - 0.8335.
        expected = [0.1665 * newtons * share for share in push[:3]] + [0.1665 * metres * share for share in push[3:]]
        assert found == pytest.approx(expected, rel=1e-5)
    # nothing else is pushed, nor in another environment: what is left are weights
    weights = at_rest(fresh).expand(ENVS, -1, -1)
    assert int((force != weights).sum()) == 12
    fresh.step(torch.zeros(ENVS, 52))
    assert torch.equal(force, weights)


@each(*[name for name in NAMES if issubclass(TASKS[name], TwoHandTask)])
def test_an_action_is_a_joint_target_between_the_limits_of_its_own_joint(name, fresh):
    width = fresh.NUM_ACTIONS // 2
    actions = torch.zeros(ENVS, fresh.NUM_ACTIONS)
    # of the last 20 of each hand: the right wrist's first joint at 0.5, the left thumb's last at -0.5
    actions[:, width - 20], actions[:, -1] = 0.5, -0.5
    fresh.step(actions)
    model, ctrl = fresh._physics.model, fresh._physics.ctrl[0]
    # -0.489 + 0.75 x 0.629; -1.571 + 0.25 x 1.571; a joint without an action in the middle, (0 + 1.571) / 2
    assert float(ctrl[model.actuator("right/A_WRJ1").id]) == pytest.approx(-0.01725, abs=1e-6)
    assert float(ctrl[model.actuator("left/A_THJ0").id]) == pytest.approx(-1.17825, abs=1e-6)
    assert float(ctrl[model.actuator("left/A_FFJ2").id]) == pytest.approx(0.7855, abs=1e-6)


# Starts of two-hand tasks.

NOISY = {"Over", "CatchUnderarm", "TwoCatchUnderarm", "ReOrientation"}
"""Tasks whose hands start with other joint angles in every episode."""


@each(*[name for name in NAMES if issubclass(TASKS[name], TwoHandTask)])
def test_both_hands_start_with_the_same_joints_and_are_told_to_stay_there(name, fresh):
    right, left = fresh.shadow_hand_dof_pos, fresh.shadow_hand_another_dof_pos
    assert torch.equal(right, left)
    lower, upper = torch.tensor(shadow.RANGES).unbind(dim=1)
    assert bool(((lower <= right) & (right <= upper)).all())
    assert bool((right[0] != right[1]).any()) is (name in NOISY)
    if name in NOISY:
        # 0.2 (lower + (upper - lower) u), u in [-1, 1): from 0.2 (2 lower - upper) to 0.2 upper
        assert bool((right <= 0.2 * upper + 1e-6).all())
        assert bool((right >= torch.maximum(0.2 * (2.0 * lower - upper), lower) - 1e-6).all())
    model, joints = fresh._physics.model, [shadow.JOINTS.index(joint) for joint in shadow.ACTUATED]
    for side in ("right", "left"):
        controls = [model.actuator(f"{side}/A_{joint}").id for joint in shadow.ACTUATED]
        torch.testing.assert_close(fresh._physics.ctrl[:, controls].float(), right[:, joints])


@each("TwoCatchUnderarm", "ReOrientation")
def test_two_objects_start_alike_turned_and_their_goals_alike_in_another_way(name, fresh):
    torch.testing.assert_close(fresh.object_rot, fresh.object_another_rot, atol=1e-6, rtol=0.0)
    torch.testing.assert_close(fresh.goal_rot, fresh.goal_another_rot, atol=1e-6, rtol=0.0)
    assert float((fresh.object_rot - fresh.goal_rot).abs().max(dim=1).values.min()) > 1e-3
    starts, goals = {
        "TwoCatchUnderarm": (((0.0, -0.39, 0.54), (0.0, -0.78, 0.54)), ((0.0, -0.79, 0.54), (0.0, -0.38, 0.54))),
        "ReOrientation": (((0.0, -0.39, 0.6), (0.0, -0.76, 0.6)), ((0.0, -0.39, 0.56), (0.0, -0.76, 0.56))),
    }[name]
    for word, start, goal in zip(("", "_another"), starts, goals, strict=True):
        off = (getattr(fresh, f"object{word}_pos") - torch.tensor(start)).abs()
        assert 0.001 < float(off.max()) <= 0.01 + 1e-6
        torch.testing.assert_close(getattr(fresh, f"goal{word}_pos"), torch.tensor(goal).expand(ENVS, 3))


@each("Over")
def test_a_random_turn_is_about_x_after_one_about_y(name, fresh, monkeypatch):
    angles = torch.tensor([[0.6, -1.0]])
    monkeypatch.setattr(fresh, "_uniform", lambda low, high, *shape: angles)
    # (sin 0.3, 0, 0, cos 0.3) times (0, -sin 0.5, 0, cos 0.5)
    sx, cx, sy, cy = math.sin(0.3), math.cos(0.3), -math.sin(0.5), math.cos(0.5)
    assert fresh.random_rotations(1)[0].tolist() == pytest.approx([sx * cy, cx * sy, sx * sy, cx * cy], abs=1e-6)


# Rewards and ends of two-hand tasks, from measurements written here.

LEFT_GOAL, RIGHT_GOAL = (-0.2, -0.2, 0.625), (-0.2, 0.2, 0.625)
FINGERS = torch.tensor([0.1, 0.15, 0.2, 0.25, 0.3])
"""Shares of a reach that the fingers have."""


def reach(task, right, left, handles=()):
    """Puts the fingertips so far (m, sums over the fingers) from the handles, in each environment."""
    named = {handle.hand: handle.name for handle in task.HANDLES}
    handles = [getattr(task, f"{handle}_pos") for handle in handles or (named["right"], named["left"])]
    tips = torch.zeros(ENVS, 2, 5, 3)
    for side, (handle, wanted) in enumerate(zip(handles, (right, left), strict=True)):
        tips[:, side] = handle.unsqueeze(1)
        tips[:, side, :, 1] -= torch.tensor(wanted).unsqueeze(1) * FINGERS
    task._tips = tips


def place(task, **positions):
    """Writes measured positions, the same in every environment."""
    for variable, position in positions.items():
        setattr(task, variable, torch.tensor(position).repeat(ENVS, 1))


def doors(task):
    # 0.4 m apart along y: 2 x 0.4, or 1 - 0.8
    place(task, door_right_handle_pos=(0.1, 0.3, 0.8), door_left_handle_pos=(0.2, -0.1, 0.7))
    return 0.8 if isinstance(task, OpeningTask) else 0.2


def block_stack(task):
    # 2 cm above its place and 4 cm beside it: 2 (0.24 - 0.06)
    place(task, block_left_handle_pos=(0.0, 0.0, 0.695), block_right_handle_pos=(0.04, 0.0, 0.625))
    return 0.36


def kettle(task):
    # 0.2 m: 0.5 - 0.4
    place(task, kettle_spout_pos=(0.0, 0.1, 0.6), bucket_handle_pos=(0.0, -0.1, 0.6), kettle_handle_pos=(0.3, 0.0, 0.6))
    return 0.1


def pen(task):
    # 0.4 m: 2 - 0.8
    place(task, pen_right_handle_pos=(0.0, 0.3, 0.6), pen_left_handle_pos=(0.0, -0.1, 0.6))
    return 1.2


def scissors(task):
    # 0.2 rad above -0.59
    task.object_dof_pos = torch.full((ENVS, 1), -0.39)
    return 1.0


def swing_cup(task):
    # one radian: 1 / 1.1 - 1
    place(task, object_rot=(0.0, 0.0, 0.0, 1.0), goal_rot=(math.sin(0.5), 0.0, 0.0, math.cos(0.5)))
    return 1 / 1.1 - 1


def sum_of_reaches(constant):
    return lambda right, left: constant - right - left


def both_exponentials(right, left):
    return math.exp(-10 * right) + math.exp(-10 * left)


GATED = {
    # threshold, measurements and what they pay with both hands near, what is paid anyway
    "DoorCloseInward": (0.5, doors, sum_of_reaches(2.0)),
    "DoorCloseOutward": (0.5, doors, sum_of_reaches(6.0)),
    "DoorOpenInward": (0.5, doors, sum_of_reaches(2.0)),
    "DoorOpenOutward": (0.5, doors, sum_of_reaches(2.0)),
    # the stack term, 50 (0.05 - 0.02), is paid wherever the hands are
    "BlockStack": (0.5, block_stack, sum_of_reaches(1.5 + 1.5)),
    "Kettle": (0.7, kettle, sum_of_reaches(1.0)),
    "Pen": (0.75, pen, both_exponentials),
    "Scissors": (0.7, scissors, sum_of_reaches(2.0)),
    "SwingCup": (0.4, swing_cup, sum_of_reaches(0.0)),
}


@each(*sorted(GATED))
def test_what_is_paid_for_both_hands_is_not_paid_for_one(name, fresh):
    threshold, measure, base = GATED[name]
    paid = measure(fresh)
    # both just near enough; the right one too far; the left one too far
    right, left = [threshold - 0.01, threshold + 0.01, 0.1], [0.2, 0.05, threshold + 0.01]
    reach(fresh, right, left)
    expected = [base(*hands) + extra for *hands, extra in zip(right, left, (paid, 0.0, 0.0), strict=True)]
    assert fresh.human_reward().tolist() == pytest.approx(expected, abs=1e-5)


@each("BlockStack")
def test_a_stack_needs_both_cubes_in_their_places_and_the_upper_one_level(name, fresh):
    fresh.block_left_handle_pos = torch.tensor([[0.0, 0.0, 0.695], [0.0, 0.0, 0.675], [0.0, 0.08, 0.675]])
    fresh.block_right_handle_pos = torch.tensor([[0.0, 0.04, 0.625], [0.08, 0.0, 0.625], [0.0, 0.0, 0.625]])
    # 50 (0.05 - 0.02); the lower one 8 cm off; the upper one 8 cm off
    assert fresh.stacked().tolist() == pytest.approx([1.5, 0.0, 0.0], abs=1e-5)
    assert fresh.succeeded().tolist() == [True, False, False]


@each("Switch", "SwitchReachable")
def test_switches_pay_for_depth_wherever_the_hands_are(name, fresh):
    place(fresh, switch_right_handle_pos=(0.0, 0.2, 0.69), switch_left_handle_pos=(0.0, -0.2, 0.7))
    reach(fresh, [0.1, 0.8, 0.2], [0.3, 0.1, 2.0])
    # 1.4 - 1.39 = 0.01, fifty times
    assert fresh.human_reward().tolist() == pytest.approx([2.1, 1.6, 0.3], abs=1e-4)
    assert not fresh.failed().any()


@each("SwitchReachable")
def test_both_switches_must_be_low(name, fresh):
    heights = torch.tensor([[0.692, 0.692], [0.692, 0.694], [0.694, 0.692]])
    fresh.switch_right_handle_pos = torch.stack((torch.zeros(3), torch.zeros(3), heights[:, 0]), dim=1)
    fresh.switch_left_handle_pos = torch.stack((torch.zeros(3), torch.zeros(3), heights[:, 1]), dim=1)
    assert fresh.succeeded().tolist() == [True, False, False]


@each("GraspAndPlace")
def test_grasp_and_place_pays_twice_for_the_gap(name, fresh):
    place(fresh, block_right_handle_pos=(0.0, 0.15, 0.6), block_left_handle_pos=(0.0, 0.0, 0.6))
    reach(fresh, [0.05, 0.1, 0.2], [0.1, 0.02, 0.3])
    pairs = ((0.05, 0.1), (0.1, 0.02), (0.2, 0.3))
    expected = [both_exponentials(*pair) + 2 * math.exp(-1.5) for pair in pairs]
    assert fresh.human_reward().tolist() == pytest.approx(expected, abs=1e-5)


@each("PushBlock")
def test_push_block_pays_for_reaches_and_gaps(name, fresh):
    place(fresh, left_goal_pos=LEFT_GOAL, right_goal_pos=RIGHT_GOAL)
    place(fresh, block_left_handle_pos=(-0.1, -0.2, 0.625), block_right_handle_pos=(-0.2, 0.5, 0.625))
    reach(fresh, [0.2, 0.7, 0.3], [0.5, 0.1, 2.0])
    # 2.4 - reaches + 5 - 5 (0.1 + 0.3)
    assert fresh.human_reward().tolist() == pytest.approx([4.7, 4.6, 3.1], abs=1e-5)


@each("BottleCap")
def test_bottle_cap_pays_for_the_lift_with_the_right_hand_near(name, fresh):
    place(fresh, bottle_pos=(0.0, -0.6, 0.6), bottle_cap_pos=(0.0, -0.6, 0.7), bottle_cap_up=(0.0, -0.6, 0.62))
    place(fresh, left_hand_pos=(0.0, -0.5, 0.6))
    reach(fresh, [0.29, 0.31, 0.1], [9.0, 0.0, 9.0], handles=("bottle_cap", "bottle_cap"))
    # 2 - reach - 0.1, and 30 x 0.02
    assert fresh.human_reward().tolist() == pytest.approx([2.21, 1.59, 2.4], abs=1e-5)


@each("LiftUnderarm")
def test_lift_underarm_pays_for_height_with_both_palms_near(name, fresh):
    place(fresh, goal_pos=(0.0, -0.6, 0.85), object_pos=(0.0, -0.6, 0.665))
    place(fresh, pot_right_handle_pos=(0.0, -0.4, 0.7), pot_left_handle_pos=(0.0, -0.8, 0.7))
    away = torch.tensor([[0.07, 0.05], [0.09, 0.02], [0.03, 0.09]])
    fresh.right_hand_pos, fresh.left_hand_pos = fresh.pot_right_handle_pos.clone(), fresh.pot_left_handle_pos.clone()
    fresh.right_hand_pos[:, 0] += away[:, 0]
    fresh.left_hand_pos[:, 0] -= away[:, 1]
    # 0.2 - palms, and 3 (0.385 - 0.185)
    assert fresh.human_reward().tolist() == pytest.approx([0.68, 0.09, 0.08], abs=1e-5)


ONE_RADIAN = (math.sin(0.5), 0.0, 0.0, math.cos(0.5))
HALF_A_RADIAN = (0.0, math.sin(0.25), 0.0, math.cos(0.25))
LEVEL = (0.0, 0.0, 0.0, 1.0)


@each("Over", "CatchUnderarm", "CatchAbreast", "CatchOver2Underarm")
def test_catching_pays_for_place_and_turn(name, fresh):
    place(fresh, goal_pos=(0.0, 0.0, 0.5), object_pos=(0.02, 0.0, 0.5), goal_rot=LEVEL, object_rot=ONE_RADIAN)
    # 2 cm times 50, or times 20 in CatchOver2Underarm, and one radian
    scaled = 0.4 if name == "CatchOver2Underarm" else 1.0
    assert fresh.human_reward().tolist() == pytest.approx([math.exp(-0.2 * (scaled + 1.0))] * ENVS, abs=1e-5)


@each("TwoCatchUnderarm")
def test_two_eggs_are_paid_for_one_by_one(name, fresh):
    place(fresh, goal_pos=(0.0, 0.0, 0.5), object_pos=(0.02, 0.0, 0.5), goal_rot=LEVEL, object_rot=ONE_RADIAN)
    place(fresh, goal_another_pos=(0.0, 1.0, 0.5), object_another_pos=(0.0, 1.0, 0.54))
    place(fresh, goal_another_rot=LEVEL, object_another_rot=HALF_A_RADIAN)
    # exp(-0.2 (1 + 1)) + exp(-0.2 (2 + 0.5))
    assert fresh.human_reward().tolist() == pytest.approx([math.exp(-0.4) + math.exp(-0.5)] * ENVS, abs=1e-5)
    # 2 + 4 cm are too far in sum
    assert not fresh.succeeded().any()
    place(fresh, object_another_pos=(0.0, 1.0, 0.539))
    assert bool(fresh.succeeded().all())


@each("ReOrientation")
def test_re_orientation_pays_for_both_cubes_and_hits_count_for_the_second(name, fresh):
    place(fresh, goal_pos=(0.0, 0.0, 0.5), object_pos=(0.02, 0.0, 0.5), goal_rot=LEVEL, object_rot=ONE_RADIAN)
    place(fresh, goal_another_pos=(0.0, 1.0, 0.5), object_another_pos=(0.0, 1.0, 0.54))
    place(fresh, goal_another_rot=LEVEL, object_another_rot=HALF_A_RADIAN)
    fresh._hit = torch.tensor([True, False, False])
    fresh.actions = torch.full((ENVS, 40), 0.5)
    # -10 x 0.06 + 1 / 1.1 + 1 / 0.6 - 0.0002 x 10
    base = -0.6 + 1 / 1.1 + 1 / 0.6 - 0.002
    assert fresh.human_reward().tolist() == pytest.approx([base + 500.0, base, base], abs=1e-3)
    place(fresh, object_rot=LEVEL)
    assert not fresh.succeeded().any()
    place(fresh, object_another_rot=LEVEL, object_rot=ONE_RADIAN)
    assert bool(fresh.succeeded().all())


@each(*[name for name in NAMES if name.startswith("Door")])
def test_a_door_is_open_where_its_handles_are_half_a_metre_apart(name, fresh):
    place(fresh, door_left_handle_pos=(0.9, -0.1, 0.7))
    fresh.door_right_handle_pos = torch.tensor([[0.0, 0.41, 0.7], [0.0, 0.39, 0.7], [0.0, -0.61, 0.7]])
    opens = name.startswith("DoorOpen")
    # 0.51 m, 0.49 m, and 0.51 m the other way round
    assert fresh.succeeded().tolist() == [opens, not opens, opens]


# Ends: each reason alone.

LOST = {
    "DoorCloseInward": 1.5, "DoorCloseOutward": 3.0, "DoorOpenInward": 1.5, "DoorOpenOutward": 1.5, "BlockStack": 0.75,
    "GraspAndPlace": 1.5, "Pen": 1.5, "PushBlock": 1.2, "Scissors": 1.75,
}  # fmt: skip


@each(*sorted(LOST))
def test_one_lost_hand_ends_the_episode(name, fresh):
    limit = LOST[name]
    reach(fresh, [limit - 0.01, limit + 0.01, 0.1], [limit - 0.01, 0.1, limit + 0.01])
    assert fresh.failed().tolist() == [False, True, True]


@pytest.mark.parametrize(
    ("name", "variable", "limit"),
    [
        ("Over", "object", 0.2), ("CatchUnderarm", "object", 0.1), ("CatchAbreast", "object", 0.2),
        ("CatchOver2Underarm", "object", 0.3), ("TwoCatchUnderarm", "object", 0.2),
        ("TwoCatchUnderarm", "object_another", 0.2), ("ReOrientation", "object", 0.2),
        ("ReOrientation", "object_another", 0.2), ("SwingCup", "object", 0.3), ("Kettle", "bucket_handle", 0.2),
        ("LiftUnderarm", "object", 0.3), ("BottleCap", "bottle_cap", 0.5),
    ],
)  # fmt: skip
def test_a_dropped_object_ends_the_episode(name, variable, limit, fresh):
    position = getattr(fresh, f"{variable}_pos").clone()
    # just above, just below, far above
    position[:, 2] = torch.tensor([limit + 0.001, limit - 0.001, limit + 0.3])
    setattr(fresh, f"{variable}_pos", position)
    if name == "BottleCap":
        # the palms follow, so that the height alone decides
        fresh.right_hand_pos, fresh.left_hand_pos = fresh.bottle_cap_pos.clone(), fresh.bottle_pos.clone()
    assert fresh.failed().tolist() == [False, True, False]


@each("BottleCap", "LiftUnderarm")
def test_one_palm_far_away_ends_the_episode(name, fresh):
    right, left, limits = {
        "BottleCap": ("bottle_cap_pos", "bottle_pos", (0.5, 0.2)),
        "LiftUnderarm": ("pot_right_handle_pos", "pot_left_handle_pos", (0.2, 0.2)),
    }[name]
    fresh.right_hand_pos, fresh.left_hand_pos = getattr(fresh, right).clone(), getattr(fresh, left).clone()
    fresh.right_hand_pos[:, 0] += torch.tensor([limits[0] - 0.001, limits[0] + 0.001, 0.0])
    fresh.left_hand_pos[:, 0] += torch.tensor([limits[1] - 0.001, 0.0, limits[1] + 0.001])
    assert fresh.failed().tolist() == [False, True, True]


@each("CatchAbreast", "CatchOver2Underarm")
def test_one_hand_that_strays_ends_the_episode(name, fresh):
    """By 10 cm: the palms of CatchAbreast from their places, the mounts of CatchOver2Underarm from theirs."""
    away = torch.tensor([[0.099, 0.099], [0.101, 0.0], [0.0, 0.101]])
    if name == "CatchAbreast":
        states = fresh.rigid_body_states.clone()
        for body, side, where in ((3, 0, (-0.3, -0.55, 0.5)), (26 + 3, 1, (-0.3, -1.15, 0.5))):
            states[:, body, :3] = torch.tensor(where)
            states[:, body, 1] += away[:, side]
        fresh.rigid_body_states = states
    else:
        roots = fresh.root_state_tensor.clone()
        for side, where in ((0, (0.0, 0.0, 0.5)), (1, (0.0, -0.8, 0.5))):
            roots[:, side, :3] = torch.tensor(where)
            roots[:, side, 1] += away[:, side]
        fresh.root_state_tensor = roots
    assert fresh.failed().tolist() == [False, True, True]


@each("Scissors")
def test_scissors_that_are_closed_further_by_both_hands_end_the_episode(name, fresh):
    # 5 (0.59 - 0.7) = -0.55 with both hands near, and 0 with one
    fresh.object_dof_pos = torch.tensor([[-0.7], [-0.68], [-0.7]])
    reach(fresh, [0.1, 0.1, 0.8], [0.2, 0.2, 0.1])
    assert fresh.failed().tolist() == [True, False, False]


@each("Quadcopter")
def test_a_quadcopter_ends_far_away_or_low_and_not_only_both(name, fresh):
    fresh.root_positions = torch.tensor([[2.9, 0.0, 1.0], [3.1, 0.0, 1.0], [0.0, 0.0, 0.29]])
    assert fresh.failed().tolist() == [False, True, True]


@each("Quadcopter")
def test_a_quadcopter_is_paid_for_upright_and_still_only_near_the_target(name, fresh):
    fresh.root_positions = torch.tensor([[0.0, 0.0, 1.0], [0.0, 2.0, 1.0], [0.0, 0.0, 1.0]])
    half = math.sqrt(0.5)
    # upside down, tilt 2; on its side, tilt 1; level
    fresh.root_quats = torch.tensor([[1.0, 0.0, 0.0, 0.0], [half, 0.0, 0.0, half], [0.0, 0.0, 0.0, 1.0]])
    fresh.root_angvels = torch.tensor([[9.0, 9.0, 3.0], [9.0, 9.0, 0.0], [9.0, 9.0, 2.0]])
    # 1 + (1/5 + 1/10); p = 1/5: 0.2 + 0.2 (1/2 + 1); 1 + (1 + 1/5)
    assert fresh.human_reward().tolist() == pytest.approx([1.3, 0.5, 2.2], abs=1e-5)


@each("Anymal")
def test_any_one_contact_ends_a_walk(name, fresh):
    fresh._touch = torch.tensor([[0.9] * 5, [0.0, 0.0, 0.0, 0.0, 1.1], [1.1, 0.0, 0.0, 0.0, 0.0]])
    assert fresh.failed().tolist() == [False, True, True]


@each("Anymal")
def test_anymals_two_errors_are_paid_for_by_their_own_weights(name, fresh):
    place(fresh, commands=(1.0, 0.5, 0.8))
    fresh.torques = torch.zeros(ENVS, 12)
    fresh.root_states = torch.tensor([0.0, 0.0, 0.6, 0.0, 0.0, 0.0, 1.0, 0.9, 0.3, 5.0, 7.0, 7.0, 0.4]).repeat(ENVS, 1)
    # 0.01 + 0.04 and 0.16
    assert fresh.sparse_reward().tolist() == pytest.approx([-0.21] * ENVS, abs=1e-5)
    paid = 0.02 * (math.exp(-0.2) + 0.5 * math.exp(-0.64))
    assert fresh.human_reward().tolist() == pytest.approx([paid] * ENVS, abs=1e-6)


@each("Humanoid")
def test_humanoids_progress_is_what_the_distance_lost_over_the_step(name, fresh):
    fresh.prev_potentials, fresh.potentials = torch.tensor([-10.0, -5.0, 1.0]), torch.tensor([-7.0, -6.0, 3.0])
    assert fresh.sparse_reward().tolist() == [3.0, -1.0, 2.0]
    assert fresh.fitness() == pytest.approx(4 / 3)


@each("Humanoid")
def test_a_humanoid_that_looks_aside_earns_less_and_one_that_leans_no_bonus(name, fresh, monkeypatch):
    seen = torch.zeros(ENVS, 108)
    # up and heading: 0.94 and 0.81; 0.92 and 0.81; 0.94 and 0.4
    seen[:, 10], seen[:, 11] = torch.tensor([0.94, 0.92, 0.94]), torch.tensor([0.81, 0.81, 0.4])
    monkeypatch.setattr(fresh, "compute_observations", lambda: seen)
    fresh.actions = torch.zeros(ENVS, 21)
    fresh.potentials = fresh.prev_potentials = torch.zeros(ENVS)
    # 2 + 0.1 + 0.5; without the 0.1; 2 + 0.1 + 0.5 x 0.4 / 0.8
    assert fresh.human_reward().tolist() == pytest.approx([2.6, 2.5, 2.35], abs=1e-5)


@each("Humanoid")
def test_braking_costs_a_humanoid_what_pushing_costs(name, fresh, monkeypatch):
    seen = torch.zeros(ENVS, 108)
    seen[:, 10], seen[:, 11] = 1.0, 1.0
    # a tenth of 20 rad/s, forward, backward, and none
    seen[:, 33] = torch.tensor([2.0, -2.0, 0.0])
    monkeypatch.setattr(fresh, "compute_observations", lambda: seen)
    fresh.actions = torch.zeros(ENVS, 21).index_fill(1, torch.tensor([0]), -1.0)
    fresh.potentials = fresh.prev_potentials = torch.zeros(ENVS)
    power = 0.05 * 2.0 * GEARS[0] / 135.0
    assert fresh.human_reward().tolist() == pytest.approx([2.59 - power, 2.59 - power, 2.59], abs=1e-5)


@each("Quadcopter")
def test_a_spin_is_held_at_two_turns_a_second_in_its_own_direction(name, fresh):
    spins = [[30.0, -40.0, 0.0], [1.0, 2.0, -2.0], [0.0, 0.0, 20.0]]
    fresh._physics.qvel[:, 3:6] = torch.tensor(spins, dtype=torch.float64)
    fresh.actions = torch.zeros(ENVS, 12)
    fresh._act()
    bound = 4.0 * math.pi
    expected = [[0.6 * bound, -0.8 * bound, 0.0], [1.0, 2.0, -2.0], [0.0, 0.0, bound]]
    for found, wanted in zip(fresh._physics.qvel[:, 3:6].tolist(), expected, strict=True):
        assert found == pytest.approx(wanted, abs=1e-6)


@each("Quadcopter")
def test_every_simulation_that_blows_up_is_counted(name, fresh):
    fresh._physics.qvel[:2, 0] = float("nan")
    fresh.step(torch.zeros(ENVS, 12))
    assert fresh.blown_up == 2
    assert fresh.terminated().tolist() == [True, True, False]


@each("Pen", "Humanoid", "Anymal")
def test_joint_torques_are_the_sum_of_what_acts_on_a_joint(name, fresh, monkeypatch):
    real, acting = fresh._physics.read, {"qfrc_actuator": 1.0, "qfrc_passive": 2.0, "qfrc_constraint": 4.0}

    def read(field, ids=None):
        value = real(field, ids)
        return torch.full_like(value, acting[field]) if field in acting else value

    monkeypatch.setattr(fresh._physics, "read", read)
    fresh._measure()
    torques = fresh.torques if name == "Anymal" else fresh.dof_force_tensor
    # what holds a joint at its limits is no torque of the quadruped's drives
    assert set(torques.flatten().tolist()) == {3.0 if name == "Anymal" else 7.0}


@each("Pen", "Over")
def test_each_hand_is_told_by_its_own_joints(name, fresh):
    model, joint = fresh._physics.model, shadow.JOINTS.index("FFJ3")
    for side, angle in (("right", 0.1), ("left", -0.2)):
        fresh._physics.qpos[:, int(model.joint(f"{side}/FFJ3").qposadr[0])] = angle
        fresh._physics.qvel[:, int(model.joint(f"{side}/FFJ3").dofadr[0])] = 10.0 * angle
    fresh._name_all()
    assert fresh.shadow_hand_dof_pos[:, joint].tolist() == pytest.approx([0.1] * ENVS)
    assert fresh.shadow_hand_another_dof_pos[:, joint].tolist() == pytest.approx([-0.2] * ENVS)
    assert fresh.shadow_hand_dof_vel[:, joint].tolist() == pytest.approx([1.0] * ENVS)
    assert fresh.shadow_hand_another_dof_vel[:, joint].tolist() == pytest.approx([-2.0] * ENVS)


@each("FrankaCabinet")
def test_a_cabinet_pays_by_how_far_it_is_open_and_for_fingers_around_the_handle(name, fresh):
    handle = (0.3, 0.0, 0.7)
    place(fresh, drawer_grasp_pos=handle, franka_grasp_pos=(0.3, 0.0, 0.8))
    place(fresh, drawer_grasp_rot=LEVEL, franka_grasp_rot=(-0.5, 0.5, 0.5, -0.5))
    fresh.actions = torch.zeros(ENVS, 9)
    fresh.cabinet_dof_pos = torch.tensor([[9.0, 9.0, 9.0, 0.4], [9.0, 9.0, 9.0, 0.1], [0.0, 0.0, 0.0, 0.0]])
    # 3 cm above and 1 cm below; 3 and 2 cm above: not around it; left below and right above: neither
    fresh.franka_lfinger_pos = torch.tensor([[0.3, 0.0, 0.73], [0.3, 0.0, 0.73], [0.3, 0.0, 0.69]])
    fresh.franka_rfinger_pos = torch.tensor([[0.3, 0.0, 0.69], [0.3, 0.0, 0.72], [0.3, 0.0, 0.73]])
    # near: d = 0.1, 1 / 1.01 squared, twice; aligned: half of 1
    base = 2 / 1.01**2 + 0.5
    # 0.25 x 0.5 + 7.5 (0.4 x 0.5 + 0.4) + 5 (0.08 - 0.04) + 0.5 + 0.5 + 2 x 0.5; 7.5 x 0.1 + 0.5; nothing more
    expected = [base + 0.125 + 4.5 + 0.2 + 2.0, base + 0.75 + 0.5, base]
    assert fresh.human_reward().tolist() == pytest.approx(expected, abs=1e-5)
    assert fresh.succeeded().tolist() == [True, False, False]
