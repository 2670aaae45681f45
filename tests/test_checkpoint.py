"""Checkpoints that are odd, hostile, or cannot be written end in one paragraph."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save

from porse.checkpoint import Checkpoint, check_networks, policy_checkpoint, read_checkpoint, write_checkpoint
from porse.errors import CheckpointError
from porse.training.candidate import train_candidate
from porse.training.job import Job
from porse.training.start import random_policy
from samples import MAPPING, REWARD, program

GOOD = {"version": 1, "kind": "checkpoint", "epoch": 3, "learning_rate": 0.001}
ARRAYS = {"actor.w": np.ones(2, np.float32)}


def paragraph(path: Path) -> str:
    """What reading the file says, which is one paragraph that names it."""
    with pytest.raises(CheckpointError) as raised:
        read_checkpoint(path)
    text = str(raised.value)
    assert text.startswith("expected a checkpoint")
    assert str(path) in text
    assert "\n" not in text
    return text


def odd(tmp_path: Path, scalars: str, arrays=ARRAYS) -> Path:
    path = tmp_path / "odd.safetensors"
    path.write_bytes(save(arrays, {"porse": scalars}))
    return path


NETWORKS = {
    "actor.mlp.0.weight": (8, 3),
    "actor.mlp.0.bias": (8,),
    "actor.mlp.2.weight": (16, 8),
    "actor.mlp.10.weight": (2, 16),
    "critic.mlp.0.weight": (8, 3),
}


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"actor.mlp.0.weight": (8, 5)}, "5 observations, hidden layers of 8-16 and 2 actions"),
        ({"actor.mlp.10.weight": (2, 16, 1)}, "3 observations, hidden layers of 8 and 16 actions"),
        ({"critic.mlp.0.weight": (8, 5)}, "the shape (8, 5) for critic.mlp.0.weight in place of the shape (8, 3)"),
        ({"actor.mlp.0.bias": None}, "no array for actor.mlp.0.bias in place of the shape (8,)"),
        ({"critic.more": ()}, "the shape () for critic.more in place of no array"),
        (dict.fromkeys(NETWORKS), "no actor"),
    ],
)
def test_networks_of_other_sizes_are_told_by_their_sizes_or_by_the_array_that_differs(changes, found):
    shapes = {name: shape for name, shape in (NETWORKS | changes).items() if shape is not None}
    policy = policy_checkpoint({name: np.zeros(shape, np.float32) for name, shape in shapes.items()})
    with pytest.raises(CheckpointError) as raised:
        check_networks(policy, NETWORKS, "Cart", Path("best.safetensors"))
    assert str(raised.value) == (
        f"expected a policy of Cart with 3 observations, hidden layers of 8-16 and 2 actions, found {found} in best.safetensors; "
        "name the task and the parameters (train.hidden, train.normalise_observations) that it was trained with"
    )


def test_networks_are_all_of_a_policy_and_nothing_else():
    arrays = {name: np.zeros(shape, np.float32) for name, shape in NETWORKS.items()}
    check_networks(Checkpoint(arrays | {"task.physics": np.zeros(3)}, {}), NETWORKS, "Cart", Path("best.safetensors"))


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"version": 2}, "found 2"),
        ({"version": None}, "found None"),
        ({"kind": "model"}, "the kind 'model'"),
        ({"kind": ["policy"]}, "the kind ['policy']"),
        ({"epoch": -1}, "the epoch -1"),
        ({"epoch": 3.5}, "the epoch 3.5"),
        ({"epoch": True}, "the epoch True"),
        ({"learning_rate": 0.0}, "the learning rate 0.0"),
        ({"learning_rate": float("nan")}, "the learning rate nan"),
        ({"learning_rate": "1"}, "the learning rate '1'"),
    ],
)
def test_scalars_that_no_training_writes_are_refused(tmp_path, changes, found):
    assert found in paragraph(odd(tmp_path, json.dumps({**GOOD, **changes})))


@pytest.mark.parametrize("scalars", ["", "{", "[1]", "3", "null", '"text"', "[" * 100_000])
def test_metadata_that_is_no_object_is_refused(tmp_path, scalars):
    paragraph(odd(tmp_path, scalars))


def test_a_file_without_metadata_or_with_that_of_another_program_is_refused(tmp_path):
    path = tmp_path / "other.safetensors"
    for metadata in (None, {"format": "pt"}):
        path.write_bytes(save(ARRAYS, metadata))
        assert "version 1" in paragraph(path)


@pytest.mark.parametrize("name", ["actor.w", "critic.mlp.0.bias", "optimizer.0.exp_avg"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_weights_that_are_not_finite_are_refused(tmp_path, name, value):
    path = tmp_path / "odd.safetensors"
    write_checkpoint(path, policy_checkpoint({name: np.array([0.5, value], np.float32)}))
    assert f"{name} with values that are not finite" in paragraph(path)


def test_what_is_no_weight_may_be_infinite(tmp_path):
    path = tmp_path / "wide.safetensors"
    write_checkpoint(
        path, Checkpoint({"reward.low": np.array([np.inf])}, {k: v for k, v in GOOD.items() if k != "version"})
    )
    assert read_checkpoint(path).arrays["reward.low"].tolist() == [np.inf]


@pytest.mark.parametrize(
    "content",
    [
        b"", b"{}", b"\xff" * 64, (2**63).to_bytes(8, "little") + b"{}", (2).to_bytes(8, "little") + b"{}x",
        (90).to_bytes(8, "little") + b'{"actor.w":{"dtype":"BF16","shape":[1],"data_offsets":[0,2]}}'.ljust(90) + b"\0\0",
    ],
)  # fmt: skip
def test_a_file_that_is_no_checkpoint_is_refused(tmp_path, content):
    path = tmp_path / "odd.safetensors"
    path.write_bytes(content)
    paragraph(path)


def test_a_folder_in_the_place_of_a_file_is_refused(tmp_path):
    (tmp_path / "odd.safetensors").mkdir()
    paragraph(tmp_path / "odd.safetensors")


def trained(small, tmp_path: Path) -> Job:
    start = tmp_path / "start.safetensors"
    write_checkpoint(start, random_policy(small, 1))
    one = Job("one", program(REWARD), program(MAPPING), 1.0, start, tmp_path / "finish.safetensors", 1, 7)
    assert train_candidate(one, small, lambda *_: None).failure == ""
    return one


def test_a_training_refuses_a_checkpoint_whose_state_is_of_something_else(small, tmp_path):
    one = trained(small, tmp_path)
    whole = read_checkpoint(one.finish)
    for name in whole.arrays:
        if name.startswith(("actor.", "critic.")):
            continue
        left = {key: array for key, array in whole.arrays.items() if key != name}
        write_checkpoint(tmp_path / "less.safetensors", Checkpoint(left, whole.scalars))
        again = Job(
            "one",
            program(REWARD),
            program(MAPPING),
            1.0,
            tmp_path / "less.safetensors",
            tmp_path / "x.safetensors",
            2,
            7,
        )
        with pytest.raises(CheckpointError, match="expected the state of a training"):
            train_candidate(again, small, lambda *_: None)


WRITE = """
import resource, sys
from pathlib import Path
import numpy as np
from porse.checkpoint import policy_checkpoint, write_checkpoint
from porse.errors import CheckpointError
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
try:
    write_checkpoint(Path(sys.argv[1]), policy_checkpoint({"actor.w": np.ones(1000, np.float32)}))
except CheckpointError as error:
    sys.exit(str(error))
"""


def test_a_file_that_the_system_does_not_let_be_written_leaves_nothing_and_says_so(root, tmp_path):
    path = tmp_path / "out" / "new.safetensors"
    done = subprocess.run([sys.executable, "-c", WRITE, path], cwd=root, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.startswith("expected to write 4")
    assert "File too large" in done.stderr
    assert "Traceback" not in done.stderr
    assert list(path.parent.iterdir()) == []


def test_a_full_disk_says_so_and_leaves_the_file_that_was_there(tmp_path):
    # Linux's device that is always full takes the place of the file that is being written.
    path = tmp_path / "old.safetensors"
    write_checkpoint(path, policy_checkpoint(ARRAYS))
    before = path.read_bytes()
    path.with_suffix(".partial").symlink_to("/dev/full")
    with pytest.raises(CheckpointError, match="No space left on device"):
        write_checkpoint(path, policy_checkpoint({"actor.w": np.zeros(2, np.float32)}))
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["old.safetensors"]
