"""`porse export`: the actions of the file are those of the checkpoint, statistics and clipping included."""

import os
import subprocess

import numpy as np
import onnx
import pytest
import torch
import yaml
from click.testing import CliRunner
from onnx.reference import ReferenceEvaluator

from porse.checkpoint import policy_checkpoint, write_checkpoint
from porse.cli import main
from porse.config import parse_params
from porse.pool import BEST, policy_file
from porse.tasks import make_task
from porse.training.actor import policy_actor
from porse.training.start import random_policy
from tiny import BIN, committed_params

# One is far out, where normalised observations are cut off, and so are actions.
SCALES = (0.1, 1.0, 50.0)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run's folder with a winner whose statistics are none of the initial ones."""
    folder = tmp_path_factory.mktemp("run")
    document = committed_params()
    document["train"] |= {"hidden": [16], "observation_clip": 1.5}
    (folder / "params.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
    arrays = dict(random_policy(parse_params(document, "here"), 1).arrays)
    draws = np.random.default_rng(3)
    for name in arrays:
        # Larger weights, so that some mean actions are beyond 1.
        if name.startswith("actor.mlp"):
            arrays[name] = (arrays[name] * 3).astype(np.float32)
        if name.endswith("_mean"):
            arrays[name] = draws.normal(0, 2, arrays[name].shape).astype(np.float32)
        if name.endswith("_std"):
            arrays[name] = draws.uniform(0.5, 3, arrays[name].shape).astype(np.float32)
    write_checkpoint(policy_file(folder / "run" / "result" / "start", BEST), policy_checkpoint(arrays))
    return folder


@pytest.fixture(scope="module")
def expected(run):
    """Observations, and what the task makes of the mean actions of the checkpoint on them."""
    params = parse_params(yaml.safe_load((run / "params.yaml").read_text()), "here")
    task = make_task("Quadcopter", 1, 0)
    draws = np.random.default_rng(4)
    observations = np.concatenate([draws.normal(0, s, (5, task.NUM_OBSERVATIONS)) for s in SCALES]).astype(np.float32)
    actor = policy_actor(task, policy_file(run / "run" / "result" / "start", BEST), params.train)
    with torch.inference_mode():
        actions = actor(torch.from_numpy(observations)).numpy()
    # What is compared depends on the cut.
    assert (np.abs(actions) > 1).any()
    assert (np.abs(actions) < 1).any()
    return observations, actions.clip(-1, 1)


def export(*words):
    return CliRunner().invoke(main, ["export", *map(str, words)], catch_exceptions=False)


@pytest.mark.filterwarnings("ignore:.*torch.jit.load.*:DeprecationWarning")
def test_torchscript_acts_as_the_checkpoint_does(run, expected, root, monkeypatch):
    monkeypatch.chdir(root)
    target = run / "policy.pt"
    done = export(run, "--torchscript", "--out", target)
    assert done.exit_code == 0, done.output
    observations, actions = expected
    loaded = torch.jit.load(str(target))
    assert np.array_equal(loaded(torch.from_numpy(observations)).numpy(), actions)


@pytest.mark.filterwarnings("ignore")
def test_onnx_acts_as_the_checkpoint_does_for_any_number_of_observations(run, expected, root, monkeypatch):
    monkeypatch.chdir(root)
    target = run / "policy.onnx"
    # The folder of the iterations is a run, too.
    done = export(run / "run", "--onnx", "--out", target)
    assert done.exit_code == 0, done.output
    model = onnx.load(target)
    onnx.checker.check_model(model)
    assert [node.name for node in (*model.graph.input, *model.graph.output)] == ["obs", "actions"]
    observations, actions = expected
    evaluator = ReferenceEvaluator(model)
    [found] = evaluator.run(None, {"obs": observations})
    np.testing.assert_allclose(found, actions, rtol=0, atol=2e-5)
    [one] = evaluator.run(None, {"obs": observations[:1]})
    assert one.shape == (1, 12)


def test_a_renderer_that_is_not_there_stops_nothing_that_draws_nothing(run, tmp_path, root):
    done = subprocess.run(
        [BIN / "porse", "export", run, "--torchscript", "--out", tmp_path / "a.pt"],
        cwd=root, env={**os.environ, "MUJOCO_GL": "vulkan"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "a.pt").exists()


def test_what_cannot_be_written_is_refused_before_any_work(run, tmp_path, root, monkeypatch):
    monkeypatch.chdir(root)
    assert "expected --onnx or --torchscript, found neither; name one of them" in export(run).output
    assert (
        "expected --onnx or --torchscript, found both; name one of them"
        in export(run, "--onnx", "--torchscript").output
    )
    assert "expected --out to end in .pt" in export(run, "--torchscript", "--out", tmp_path / "a.onnx").output
    empty = tmp_path / "empty"
    empty.mkdir()
    done = export(empty, "--onnx", "--params", run / "params.yaml", "--out", tmp_path / "a.onnx")
    assert done.exit_code == 1
    assert "expected a checkpoint at" in done.output
