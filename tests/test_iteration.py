"""A run in one process. That it leaves the bytes of `dvc repro` is held by test_pipeline.py and test_method_runs.py."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

from at_once import outputs
from porse import iteration, tables
from porse.cli import main
from porse.config import Iteration, parse_params
from porse.functions.verdict import Verdict
from porse.generation import states
from porse.generation.functions import Attempt, NoFunctionLeft
from porse.iteration import OUTPUTS, Place
from porse.llm.request import Reply
from tiny import committed_params


def short_params() -> dict:
    """Two candidates from the grammar, one rung and its mutants, one iteration."""
    params = committed_params() | {"generator": "grammar"}
    params["generate"] |= {"candidates": 2, "elites": 1}
    params["validate"] |= {"probe_envs": 8, "probe_steps": 8}
    params["train"] |= {"num_envs": 8, "steps_per_epoch": 4, "rung_epochs": 1, "hidden": [8], "minibatches": 2}
    params["mutate"] |= {"pool": "eliminate-1", "mutants": 2}
    params["fuse"] |= {"pool": "eliminate-mutants"}
    params["evaluate"] |= {"seeds": 1, "episodes": 8}
    params["iterations"] = [{"n": 1, "next": "result"}]
    params["rungs"] = [
        {"rung": 1, "pool": "validate-code", "until": 1, "keep": 1},
        {"rung": "mutants", "pool": "mutate", "until": 1, "keep": 1},
    ]
    return params


@pytest.fixture(scope="module")
def ran(root, tmp_path_factory) -> tuple[Path, list[str]]:
    """A folder with a run that the command made, and what the command said."""
    folder = tmp_path_factory.mktemp("ran")
    (folder / "params.yaml").write_text(yaml.safe_dump(short_params(), sort_keys=False))
    done = CliRunner().invoke(main, words(root, folder, "out"), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return folder, done.output.splitlines()


def words(root, folder, out) -> list[str]:
    given = {
        "params": folder / "params.yaml",
        "out": folder / out,
        "prompts": root / "prompts",
        "cache": folder / "none",
    }
    return ["run", *(word for name, path in given.items() for word in (f"--{name}", str(path)))]


def test_the_command_runs_all_steps_and_says_what_they_did(ran):
    folder, said = ran
    assert sorted(path.name for path in (folder / "out").iterdir()) == sorted(OUTPUTS)
    assert [path.name for path in sorted((folder / "out" / "run" / "1").iterdir())] == [
        "eliminate-1", "eliminate-mutants", "generate", "mutate", "start", "train-1", "train-mutants", "validate-code",
    ]  # fmt: skip
    assert "iteration 1: 4 replies" in said
    assert "iteration 1 rung 1: 1 of 2 survive" in " ".join(said)
    assert said[-1].startswith("iteration 1: MTS ")
    # 2 candidates and 2 mutants, an epoch each.
    assert json.loads((folder / "out" / "metrics.json").read_text())["epochs_spent"] == 4


def test_a_run_is_never_written_over_another_one(root, ran):
    folder, _ = ran
    before = outputs(folder / "out")
    done = CliRunner().invoke(main, words(root, folder, "out"))
    assert done.exit_code == 1
    assert done.output.startswith("Error: expected a folder without a run in it, found run, evaluation, results,")
    assert len(done.output.splitlines()) == 1
    assert outputs(folder / "out") == before


def test_the_steps_of_an_iteration_come_in_the_order_of_the_algorithm(params, monkeypatch, tmp_path):
    """With the default schedule: mutants after the third of six rungs, and each rung trains what the one before left."""
    called: list[str] = []

    def noted(name):
        def step(*arguments):
            folders = [str(path.relative_to(tmp_path / "run")) for path in arguments if isinstance(path, Path)]
            called.append(" ".join((name, *(path for path in folders if not path.startswith("..")))))
            return ""

        return step

    for name in ("generate", "validate_code", "train_population", "eliminate", "mutate", "fuse"):
        monkeypatch.setattr(iteration, name, noted(name))
    place = Place(tmp_path, tmp_path / "run" / ".." / "prompts", tmp_path / "run" / ".." / "cache")
    iteration.iterate(params, Iteration(2, 3), place, lambda _: [], lambda _: None)
    assert called == [
        "generate 2/start 2/generate",
        "validate_code 2/start 2/generate 2/validate-code",
        "train_population 2/validate-code 2/train-1", "eliminate 2/train-1 2/eliminate-1",
        "train_population 2/eliminate-1 2/train-2", "eliminate 2/train-2 2/eliminate-2",
        "train_population 2/eliminate-2 2/train-3", "eliminate 2/train-3 2/eliminate-3",
        "mutate 2/eliminate-3 2/start 2/mutate",
        "train_population 2/mutate 2/train-mutants", "eliminate 2/train-mutants 2/eliminate-mutants",
        "train_population 2/eliminate-mutants 2/train-4", "eliminate 2/train-4 2/eliminate-4",
        "train_population 2/eliminate-4 2/train-5", "eliminate 2/train-5 2/eliminate-5",
        "train_population 2/eliminate-5 2/train-6", "eliminate 2/train-6 2/eliminate-6",
        "fuse 2/start 2/eliminate-6 3/start",
    ]  # fmt: skip


def test_one_process_tries_all_functions_and_ends_with_the_block(monkeypatch):
    """A process that tries functions loads torch, which takes longer than to try all functions of a short run."""
    opened: list[states.Sandbox] = []

    class Counted(states.Sandbox):
        def __init__(self, *arguments) -> None:
            super().__init__(*arguments)
            opened.append(self)

    monkeypatch.setattr(states, "Sandbox", Counted)
    texts = {
        "good": "def compute_reward(root_positions):\n    near = -torch.norm(root_positions, dim=-1)\n    return near, {'near': near}",
        "wrong": "def compute_reward(root_positions):\n    near = root_positions.nonsense()\n    return near, {'near': near}",
    }
    attempts = [
        Attempt("reward", 0, 0, (), Reply(name, text, "stop", 0, 0, "a test", 0.0)) for name, text in texts.items()
    ]
    with states.checker(parse_params(short_params(), "a test")) as check:
        assert check([]) == []
        assert opened == []
        assert [verdict.passed for verdict, _ in check(attempts)] == [True, False]
        assert [verdict.passed for verdict, _ in check(attempts[::-1])] == [False, True]
        assert len(opened) == 1
        process = opened[0]._process.pid
        assert Path(f"/proc/{process}").exists()
    assert not Path(f"/proc/{process}").exists()


def test_a_run_that_ends_for_want_of_functions_leaves_all_verdicts(root, tmp_path):
    asked: list[Attempt] = []

    def refused(attempts):
        asked.extend(attempts)
        return [(Verdict(False, "shape", f"wrong in {len(asked)}", 3), "") for _ in attempts]

    params = parse_params(short_params(), "a test")
    with pytest.raises(NoFunctionLeft, match="expected a usable reward function for slot 0 of iteration 1"):
        iteration.run(params, Place(tmp_path, root / "prompts", tmp_path / "none"), refused, lambda _: None)
    left = tmp_path / "run" / "1" / "validate-code"
    verdicts = tables.read(left / "verdicts.parquet", tables.VERDICTS)
    found = sorted((row["kind"], row["slot"], row["attempt"], row["check"]) for row in verdicts)
    assert found == sorted((attempt.kind, attempt.slot, attempt.number, "shape") for attempt in asked)
    assert len(tables.read(left / "replies.parquet", tables.REPLIES)) == len(verdicts) > 4


def test_a_heavy_library_is_imported_by_no_step_that_does_without_it():
    """A stage starts with what its step imports: 0.1 s where it is tables alone, seconds with torch."""
    light = ("eliminate", "fuse", "summarise", "train_population")
    code = "; ".join(f"import porse.steps.{name}" for name in light)
    heavy = "{'torch', 'mujoco', 'sklearn', 'llvmlite', 'openai'} & set(sys.modules)"
    found = subprocess.run(
        [sys.executable, "-c", f"import sys; {code}; print({heavy})"], capture_output=True, text=True
    )
    assert found.stdout == "set()\n", found.stderr
