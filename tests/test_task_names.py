"""Every name that functions of the original environments read is offered, and is what its declaration says."""

import math
import re

import pytest
import torch

from code_cases import compile_mapping, compile_reward
from porse.sim import rotations
from porse.tasks import TASKS, make_task
from porse.tasks.hands.two_hands import TwoHandTask

ENVS = 5
HANDS = sorted(name for name, task in TASKS.items() if issubclass(task, TwoHandTask))
PAIRS = ["ReOrientation", "TwoCatchUnderarm"]
BLOCKS = ["BlockStack", "GraspAndPlace", "PushBlock"]
LIFTED = {
    **dict.fromkeys(("DoorCloseInward", "DoorCloseOutward", "DoorOpenInward"), 10.0),
    **dict.fromkeys(("Scissors", "Switch", "SwitchReachable", "Kettle", "Pen", "GraspAndPlace"), 10.0),
    "DoorOpenOutward": 5.0,
    "SwingCup": 1.0,
    "BottleCap": 1.0,
}
"""How far (m) the originals lift a goal above its object's start."""


def played(name, steps=3):
    """Returns a task after some steps of random actions, and its variables."""
    task = make_task(name, ENVS, seed=3)
    generator = torch.Generator().manual_seed(4)
    for _ in range(steps):
        task.step(torch.rand(ENVS, task.NUM_ACTIONS, generator=generator) * 2 - 1)
    return task, task.variables()


@pytest.mark.parametrize("name", HANDS)
def test_fingertip_handles_are_rows_of_the_body_states(name):
    _, values = played(name)
    assert values["fingertip_handles"] == (7, 11, 15, 20, 25)
    assert values["fingertip_another_handles"] == (33, 37, 41, 46, 51)
    for word in ("", "another_"):
        rows = values["rigid_body_states"][:, values[f"fingertip_{word}handles"]]
        assert torch.equal(rows, values[f"fingertip_{word}state"])
        assert torch.equal(rows[:, :, 0:3], values[f"fingertip_{word}pos"])


@pytest.mark.parametrize("name", HANDS)
def test_object_indices_are_columns_of_the_root_states(name):
    _, values = played(name)
    for word in ["object", *["object_another"] * (name in PAIRS)]:
        root = values["root_state_tensor"][:, values[f"{word}_indices"]]
        parts = [values[f"{word}_{part}"] for part in ("pos", "rot", "linvel", "angvel")]
        assert torch.equal(root, torch.cat(parts, dim=-1)), word
    assert ("object_another_indices" in values) == (name in PAIRS)


@pytest.mark.parametrize("name", BLOCKS)
def test_block_indices_are_the_column_of_the_left_cube(name):
    _, values = played(name)
    root = values["root_state_tensor"][:, values["block_indices"]]
    assert torch.equal(root[:, 0:3], values["block_left_handle_pos"])
    assert torch.equal(root[:, 3:7], values["block_left_handle_rot"])


def test_only_tasks_with_a_left_cube_offer_its_column():
    assert [name for name in HANDS if "block_indices" in {v.name for v in TASKS[name].VARIABLES}] == BLOCKS


@pytest.mark.parametrize("name", HANDS)
def test_goal_states_hold_the_goal_pose_and_no_velocity(name):
    _, values = played(name)
    for word in ["goal", *["goal_another"] * (name in PAIRS)]:
        states = values[f"{word}_states"]
        if name == "PushBlock":
            expected = torch.tensor([-0.2, 0.2, 0.625, 0.0, 0.0, 0.0, 1.0]).repeat(ENVS, 1)
        else:
            expected = torch.cat((values[f"{word}_pos"], values[f"{word}_rot"]), dim=-1)
        assert torch.equal(states[:, 0:7], expected)
        assert not states[:, 7:13].any()
    assert ("goal_another_states" in values) == (name in PAIRS)


@pytest.mark.parametrize("name", sorted(LIFTED))
def test_goals_are_lifted_as_in_the_original(name):
    task, values = played(name)
    start = torch.tensor(task.scene().body("object").pos, dtype=torch.float32)
    lifted = torch.tensor([0.0, 0.0, LIFTED[name]])
    torch.testing.assert_close(values["goal_pos"], (start + lifted).repeat(ENVS, 1), atol=1e-6, rtol=0.0)
    column = 2 + task.ACTORS.index("goal")
    assert torch.equal(values["root_state_tensor"][:, column], values["goal_states"])


@pytest.mark.parametrize("name", ["Kettle", "SwingCup", "DoorOpenOutward"])
def test_a_lifted_goal_says_so_where_prompts_print_it(name):
    meanings = {v.name: v.meaning for v in TASKS[name].VARIABLES}
    assert all("above" in meanings[f"goal_{part}"] for part in ("pose", "pos", "rot", "states"))


def test_local_grasp_poses_are_the_grasp_poses_in_their_own_frames():
    task, values = played("FrankaCabinet")
    assert values["franka_local_grasp_pos"].tolist() == torch.tensor([[0.0, 0.04, 0.1654]]).repeat(ENVS, 1).tolist()
    turned = torch.tensor([0.0, 0.0, -math.sin(math.pi / 8), math.cos(math.pi / 8)])
    torch.testing.assert_close(values["franka_local_grasp_rot"], turned.repeat(ENVS, 1))
    assert values["drawer_local_grasp_pos"].tolist() == torch.tensor([[0.3, 0.01, 0.0]]).repeat(ENVS, 1).tolist()
    assert values["drawer_local_grasp_rot"].tolist() == [[0.0, 0.0, 0.0, 1.0]] * ENVS
    for word, body in (("franka", task.hand_handle), ("drawer", task.drawer_handle)):
        place, turn = values["rigid_body_states"][:, body, 0:3], values["rigid_body_states"][:, body, 3:7]
        found = place + rotations.rotate(turn, values[f"{word}_local_grasp_pos"])
        torch.testing.assert_close(found, values[f"{word}_grasp_pos"])
        found = rotations.multiply(turn, values[f"{word}_local_grasp_rot"])
        torch.testing.assert_close(found, values[f"{word}_grasp_rot"])


def test_basis_vectors_turn_into_the_heading_and_up_vectors():
    _, values = played("Humanoid", steps=20)
    turn = rotations.multiply(values["root_states"][:, 3:7], values["inv_start_rot"])
    assert float(values["up_vec"][:, 2].max()) < 1.0
    assert values["basis_vec0"].tolist() == [[1.0, 0.0, 0.0]] * ENVS
    assert values["basis_vec1"].tolist() == [[0.0, 0.0, 1.0]] * ENVS
    torch.testing.assert_close(rotations.rotate(turn, values["basis_vec0"]), values["heading_vec"])
    torch.testing.assert_close(rotations.rotate(turn, values["basis_vec1"]), values["up_vec"])


def test_humanoid_scales_are_what_observations_and_torques_are_multiplied_by():
    task, values = played("Humanoid", steps=9)
    seen, turn = values["obs_buf"], values["root_states"][:, 3:7]
    spin = rotations.rotate_inverse(turn, values["root_states"][:, 10:13])
    torch.testing.assert_close(seen[:, 4:7], values["angular_velocity_scale"] * spin)
    torch.testing.assert_close(seen[:, 33:54], values["dof_vel_scale"] * values["dof_vel"])
    torch.testing.assert_close(seen[:, 54:75], values["contact_force_scale"] * values["dof_force_tensor"])
    torch.testing.assert_close(seen[:, 75:87], values["contact_force_scale"] * values["vec_sensor_tensor"])
    torch.testing.assert_close(task._physics.ctrl.float(), values["power_scale"] * values["actions"])
    scales = ("angular_velocity_scale", "dof_vel_scale", "contact_force_scale", "power_scale")
    assert [values[name] for name in scales] == [0.25, 0.1, 0.01, 1.0]


MAPPING = """
def mapping_function(self):
    object_pos = self.root_state_tensor[self.object_indices, 0:3]
    goal_pos = self.goal_states[:, 0:3]
    tips = self.rigid_body_states[:, self.fingertip_handles][:, :, 0:3]
    others = self.rigid_body_states[:, self.fingertip_another_handles][:, :, 0:3]
    reach = torch.norm(tips - object_pos.unsqueeze(1), dim=-1).mean(dim=-1)
    turn = quat_diff_rad(self.root_state_tensor[self.object_indices, 3:7], self.goal_states[:, 3:7])
    return [torch.norm(object_pos - goal_pos, dim=-1), reach + others[:, :, 2].sum(dim=-1), turn], [False, False, True], ["d", "r", "t"]
"""


@pytest.mark.parametrize("name", HANDS)
def test_a_mapping_written_for_the_original_reads_the_same_numbers(name):
    task, values = played(name)
    found, _, _ = compile_mapping(MAPPING, TASKS[name].VARIABLES, True, values)(values)
    body = values["rigid_body_states"][:, 52 + task.OBJECT_BODIES.index("object")]
    distance = torch.norm(body[:, 0:3] - values["goal_states"][:, 0:3], dim=-1)
    reach = torch.norm(values["fingertip_pos"] - body[:, None, 0:3], dim=-1).mean(dim=-1)
    reach = reach + values["fingertip_another_pos"][:, :, 2].sum(dim=-1)
    turn = rotations.rotation_distance(body[:, 3:7], values["goal_states"][:, 3:7])
    for part, expected in zip(found, (distance, reach, turn), strict=True):
        torch.testing.assert_close(part, expected, atol=1e-3, rtol=1e-4)


def test_a_column_of_the_root_states_is_read_in_every_form():
    _, values = played("BlockStack")
    source = """
def compute_reward(root_state_tensor, object_indices, block_indices):
    roots, place = root_state_tensor, block_indices
    whole = roots[place]
    columns = roots[:, place]
    height = roots[object_indices, 2]
    return height, {"whole": whole[:, 1], "columns": columns[:, 2]}
"""
    total, parts = compile_reward(source, TASKS["BlockStack"].VARIABLES, True, values)(values)
    assert torch.equal(total, values["object_pos"][:, 2])
    assert torch.equal(parts["whole"], values["block_pos"][:, 1])
    assert torch.equal(parts["columns"], values["block_pos"][:, 2])


@pytest.mark.parametrize("name", HANDS)
def test_prompts_say_what_handles_and_indices_are(name):
    source = TASKS[name].observation_source()
    assert re.search(r"self\.fingertip_handles: tuple of 5 ints, 1: rows of rigid_body_states", source)
    assert re.search(r"self\.object_indices: int, 1: column of the object in root_state_tensor", source)
