"""The model-free generator: what it draws is accepted on every task, changes on real states, and follows from its seed."""

import json
import math
import re

import pytest
import torch

from code_cases import compile_mapping, compile_reward
from porse.errors import TaskError
from porse.functions.read.confine import Limits
from porse.functions.read.sandbox import Sandbox
from porse.functions.read.states import packed
from porse.generation.grammar import mapping_text, reward_text, spliced_mapping_text, values_text
from porse.generation.grammar_rules import measures, role
from porse.generation.states import probe_states
from porse.generation.values import parse_values
from porse.tasks import TASKS
from porse.variables import Variable

FUNCTIONS = {reward_text: "reward", mapping_text: "mapping", spliced_mapping_text: "mapping"}
SEEDS = range(40)

BALL = Variable("ball_pos", "tensor", (3,), "m", "world", "position of the ball")
GOAL = Variable("goal_pos", "tensor", (3,), "m", "world", "where the ball must go")
OWN = Variable("goal_pos", "tensor", (3,), "m", "world", "position of the goal (the ball's own place)")
HAND = Variable("right_hand_pos", "tensor", (3,), "m", "world", "position of the palm")
ACTIONS = Variable("actions", "tensor", (2,), "1", "-", "the last actions")
SEEN = Variable("obs_buf", "tensor", (2,), "1", "-", "the observations")
PLACE = Variable("root_positions", "tensor", (3,), "m", "world", "position of the chassis")
TARGET = Variable("target_positions", "tensor", (3,), "m", "world", "the position to reach")

PENCIL = """This reward weighs root to target, root height, action penalty.

```python
def compute_reward(root_positions: torch.Tensor, target_positions: torch.Tensor, actions: torch.Tensor) -> Tuple[torch.Tensor, Dict[str, torch.Tensor]]:
    root_to_target_temp: float = 0.46
    root_to_target = torch.norm(root_positions - target_positions, dim=-1)
    root_to_target_reward = torch.exp(-root_to_target / root_to_target_temp)
    root_height = root_positions[:, 2]
    root_height_reward = root_height
    action_penalty = -torch.norm(actions, dim=-1)
    total_reward = 0.64 * root_to_target_reward + 0.74 * root_height_reward + 0.017 * action_penalty
    return total_reward, {"root_to_target_reward": root_to_target_reward, "root_height_reward": root_height_reward, "action_penalty": action_penalty}
```
"""


@pytest.fixture(scope="module")
def sandbox():
    with Sandbox(Limits()) as running:
        yield running


def source(text):
    return re.search(r"```python\n(.*)\n```", text, re.DOTALL)[1]


def outputs(kind, code, variables, states):
    """Returns the total reward, or every progress variable, on real states."""
    if kind == "reward":
        return {"total": compile_reward(code, variables, portable=False)(states)[0]}
    progress, _, names = compile_mapping(code, variables, portable=False)(states)
    return dict(zip(names, progress, strict=True))


def refused(sandbox, folder, params, task, seeds, envs, steps):
    """Returns how many functions were tried, and those that were refused or do not change on real states."""
    variables = TASKS[task].VARIABLES
    states = probe_states(task, envs, steps, params.seed)
    sandbox.prepare(packed(states))
    tried, bad = 0, []
    for write, kind in FUNCTIONS.items():
        for seed in seeds:
            tried += 1
            verdict, code = sandbox.judge(write(variables, seed), kind)
            if not verdict.passed:
                bad.append((task, write.__name__, seed, verdict))
                continue
            found = outputs(kind, code, variables, states)
            bad += [(task, write.__name__, seed, name) for name, x in found.items() if bool((x == x[0]).all())]
    return tried, bad


def test_what_is_drawn_is_accepted_and_changes_on_every_task(sandbox, params, tmp_path):
    found = [refused(sandbox, tmp_path, params, task, (0, 1), 16, 8) for task in TASKS]
    assert sum(tried for tried, _ in found) == len(TASKS) * len(FUNCTIONS) * 2
    assert [each for _, bad in found for each in bad] == []


@pytest.mark.slow
@pytest.mark.parametrize("task", TASKS)
def test_all_that_is_drawn_is_accepted_and_changes(sandbox, params, tmp_path, task):
    envs, steps = params.validate.probe_envs, params.validate.probe_steps
    tried, bad = refused(sandbox, tmp_path, params, task, SEEDS, envs, steps)
    assert tried == 3 * len(SEEDS)
    assert bad == []


@pytest.mark.parametrize("write", FUNCTIONS)
def test_the_same_seed_gives_the_same_text_and_another_seed_another(write):
    variables = TASKS["Over"].VARIABLES
    texts = [write(variables, seed) for seed in SEEDS]
    assert texts == [write(variables, seed) for seed in SEEDS]
    # A mapping has no temperatures and weights, so that two seeds may say the same.
    assert len(set(texts)) == len(SEEDS) or (write is mapping_text and len(set(texts)) > len(SEEDS) / 2)


@pytest.mark.parametrize("task", TASKS)
def test_functions_have_as_many_parts_as_they_should(task):
    variables = TASKS[task].VARIABLES
    for write, parts in ((reward_text, {2, 3, 4}), (mapping_text, {1, 2, 3}), (spliced_mapping_text, {2, 3})):
        lists = [source(write(variables, seed)).splitlines()[-1] for seed in SEEDS]
        quoted = [re.findall(r'"(\w+)"', line) for line in lists]
        assert {len(names) for names in quoted} == parts, write
        assert all(len(set(names)) == len(names) for names in quoted), write


@pytest.mark.parametrize("task", TASKS)
def test_measures_have_names_of_their_own_and_never_read_only_what_stands_still(task):
    variables = {variable.name: variable for variable in TASKS[task].VARIABLES}
    known = measures(TASKS[task].VARIABLES)
    names = [measure.name for measure in known]
    assert len(set(names)) == len(names)
    assert not set(names) & set(variables)
    for measure in known:
        roles = {role(variables[name]) for name in measure.reads}
        assert roles & {"robot", "object"}, measure
        # Without the robot in it, only what is no position or rotation of an object is taken to move by itself.
        assert measure.rests or "robot" in roles or measure.name in ("potentials_gain", "up_vec_z", "heading_vec_x")


def test_the_likeliest_measure_is_the_distance_to_the_goal():
    likeliest = {task: max(measures(TASKS[task].VARIABLES), key=lambda m: m.weight).name for task in TASKS}
    assert likeliest["Quadcopter"] == "root_to_target_root"
    assert likeliest["Over"] == "object_to_goal"
    assert likeliest["Humanoid"] == "potentials_gain"
    assert likeliest["Anymal"] == "commands_error"


def test_two_positions_make_a_distance_and_a_goal_at_its_own_place_makes_none():
    known = {measure.name: measure for measure in measures((BALL, GOAL, HAND))}
    assert known["ball_to_goal"].text == "torch.norm(ball_pos - goal_pos, dim=-1)"
    # Of the three pairs, 6 parts go to object and goal, 4 to hand and object, half a part to hand and goal.
    assert known["ball_to_goal"].weight == 6.0
    assert known["right_hand_to_ball"].weight == 4.0
    assert known["right_hand_to_goal"].weight == 0.5
    assert [m.name for m in measures((BALL, OWN, HAND)) if "goal" in m.name] == []


def test_hands_go_to_handles_of_their_own_side_three_times_as_often():
    handles = [Variable(f"door_{side}_handle_pos", "tensor", (3,), "m", "world", side) for side in ("left", "right")]
    known = {measure.name: measure.weight for measure in measures((HAND, *handles))}
    # 4 parts are shared 3 to 1.
    assert known["right_hand_to_door_right_handle"] == 3.0
    assert known["right_hand_to_door_left_handle"] == 1.0


def test_a_reward_that_is_drawn_is_what_a_pencil_says():
    variables = (PLACE, TARGET, ACTIONS)
    text = reward_text(variables, 3)
    assert text == PENCIL
    states = {
        "root_positions": torch.tensor([[0.276, 0.368, 1.0], [0.0, 0.0, 2.0]]),
        "target_positions": torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, 2.0]]),
        "actions": torch.tensor([[0.6, 0.8], [0.0, 0.0]]),
    }
    total, components = compile_reward(source(text), variables, portable=True)(states)
    # Distances 0.46, which is the temperature, and 0; heights 1 and 2; norms of the actions 1 and 0.
    assert components["root_to_target_reward"].tolist() == pytest.approx([0.367879, 1.0], abs=1e-6)
    assert components["root_height_reward"].tolist() == [1.0, 2.0]
    assert components["action_penalty"].tolist() == pytest.approx([-1.0, 0.0])
    # 0.64 x 0.367879 + 0.74 x 1 - 0.017 x 1, and 0.64 x 1 + 0.74 x 2
    assert total.tolist() == pytest.approx([0.958443, 2.12], abs=1e-6)


def test_what_may_be_negative_never_stands_in_an_exponential():
    for task in TASKS:
        signed = {measure.name for measure in measures(TASKS[task].VARIABLES) if measure.signed}
        texts = [reward_text(TASKS[task].VARIABLES, seed) for seed in SEEDS[:10]]
        found = {name for text in texts for name in re.findall(r"torch\.exp\(-(\w+) /", text)}
        assert not found & signed, task


def test_what_may_rest_comes_with_the_robots_distance_from_the_same_thing():
    resting = 0
    for seed in SEEDS:
        lines = source(mapping_text((BALL, GOAL, HAND), seed)).splitlines()[1:-1]
        for line in lines:
            resting += "ball_to_goal" in line
            if "ball_to_goal" in line:
                assert line == (
                    "    reach_and_ball_to_goal = torch.norm(ball_pos - goal_pos, dim=-1)"
                    " + 0.2 * torch.norm(right_hand_pos - ball_pos, dim=-1)"
                )
    assert resting > 0


def test_a_task_without_any_known_name_is_written_about_by_its_observations():
    plain = (SEEN, ACTIONS)
    assert {measure.text for measure in measures(plain)} == {"obs_buf[:, 0]", "obs_buf[:, 1]"}
    for write in FUNCTIONS:
        assert "obs_buf" in write(plain, 0)


@pytest.mark.parametrize("write", FUNCTIONS)
def test_without_a_tensor_there_is_nothing_to_write_about(write):
    with pytest.raises(TaskError, match="found num_envs; a task offers at least obs_buf and actions"):
        write((Variable("num_envs", "int", (), "1", "-", "number of environments"),), 0)


@pytest.mark.parametrize("varied", ["beta", "alpha"])
def test_values_are_read_lie_one_in_each_part_of_the_range_and_follow_from_the_seed(varied):
    top = 2.0 if varied == "beta" else 1.0
    for seed in SEEDS:
        text = values_text(varied, 5, 2.0, seed)
        values = parse_values(text, varied, 5, 2.0)
        # Five parts of the range, one value in each, in any order.
        assert sorted(int(5 * value / top) for value in values) == [0, 1, 2, 3, 4]
        assert text == values_text(varied, 5, 2.0, seed)
    assert len({values_text(varied, 5, 2.0, seed) for seed in SEEDS}) == len(SEEDS)


def test_weights_of_beta_add_up_to_the_scale():
    pairs = json.loads(re.search(r"\[.*\]", values_text("beta", 5, 2.0, 0))[0])
    assert all(math.isclose(pair["goal"] + pair["bonus"], 2.0, abs_tol=1e-6) for pair in pairs)
