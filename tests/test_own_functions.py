"""`generator: files`: functions of one's own in the model's place."""

import shutil

import pytest

import tiny
from at_once import run_at_once
from porse import tables
from porse.config import parse_params
from porse.errors import ParamsError, SearchError
from porse.generation.states import checker
from porse.inputs.resolve import resolve_inputs


def document(functions: str, candidates: int) -> dict:
    params = tiny.committed_params()
    params |= {"generator": "files", "iterations": [{"n": 1, "next": "result"}]}
    params["generate"] |= {"candidates": candidates, "elites": 0, "functions": functions}
    params["validate"] |= {"probe_envs": 8, "probe_steps": 8}
    params["train"] |= {"num_envs": 4, "steps_per_epoch": 4, "rung_epochs": 1, "hidden": [8], "minibatches": 2}
    params["rungs"] = [{"rung": 1, "pool": "validate-code", "until": 1, "keep": 1}]
    params["mutate"] |= {"pool": "validate-code", "mutants": 0}
    params["fuse"]["pool"] = "eliminate-1"
    params["evaluate"]["seeds"] = 0
    return params


@pytest.fixture
def written(tmp_path, monkeypatch, root):
    """A working folder whose functions/mine has two pairs; the second one's reward is the first one's, doubled."""
    folder = tmp_path / "functions" / "mine"
    shutil.copytree(root / "functions" / "quadcopter-hover", folder)
    reward = (folder / "reward-0.py").read_text()
    (folder / "reward-1.py").write_text(reward.replace("near + steady, {", "2.0 * (near + steady), {"))
    shutil.copy(folder / "mapping-0.py", folder / "mapping-1.py")
    shutil.copytree(root / "presets", tmp_path / "presets")
    monkeypatch.chdir(tmp_path)
    return folder


@pytest.fixture(scope="module")
def check():
    with checker(parse_params(document("mine", 1), "a test")) as found:
        yield found


def test_each_slot_is_trained_with_the_functions_in_its_own_files(written, tmp_path, check):
    run_at_once(tmp_path / "out", document("mine", 2), check)
    rows = tables.read(tmp_path / "out" / "results" / "candidates.parquet", tables.CANDIDATES)
    doubled = {row["slot"]: "2.0 * (near + steady)" in row["reward_source"] for row in rows}
    assert doubled == {0: False, 1: True}
    replies = tables.read(tmp_path / "out" / "results" / "replies.parquet", tables.REPLIES)
    assert {row["answered_by"] for row in replies} == {"files"}


def test_a_missing_file_is_named(written, tmp_path, check):
    with pytest.raises(SearchError, match=r"slot 2 in functions/mine/reward-2\.py, found no such file"):
        run_at_once(tmp_path / "out", document("mine", 3), check)


@pytest.mark.parametrize("name", ["", "..", "/etc", "a/b"])
def test_a_folder_elsewhere_is_refused(name):
    with pytest.raises(ParamsError, match=r"expected generate\.functions to be a folder below functions/"):
        parse_params(document(name, 1), "params.yaml")


def test_the_stages_that_ask_depend_on_the_files_and_no_others_do(root):
    inputs = resolve_inputs(root, document("franka-reach", 1), "params.yaml")
    reads = {name for name, found in inputs.items() if "functions/franka-reach/reward-0.py" in found.files}
    assert reads == {"generate", "validate-code", "mutate"}
    assert not any("functions/franka-open/reward-0.py" in found.files for found in inputs.values())
