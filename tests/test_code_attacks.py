"""Every attack is refused and nothing of it takes effect; text that only looks like one is only text."""

import os

import pytest
import torch

from code_attacks import ATTACKS, HARMLESS_LOOKALIKES
from code_cases import VARIABLES, compile_reward, judge, values
from porse.functions.read.limits import Limits
from porse.functions.read.sandbox import Sandbox
from porse.functions.read.states import save_states
from porse.functions.read.validate import Submission
from porse.functions.verdict import CodeError


@pytest.fixture(scope="module")
def sandbox(tmp_path_factory):
    path = tmp_path_factory.mktemp("states") / "states.safetensors"
    save_states(path, values())
    with Sandbox(Limits(wall_s=2.0, cpu_s=2)) as running:
        running.load(path, VARIABLES)
        yield running


def test_there_are_at_least_forty():
    assert len(ATTACKS) >= 40


@pytest.mark.parametrize("name", ATTACKS)
def test_attack_is_refused(sandbox, tmp_path, name):
    canary = tmp_path / "canary"
    before = dict(os.environ), torch.get_num_threads(), torch.initial_seed()
    verdict, source = judge(Submission(ATTACKS[name].replace("CANARY", str(canary)), "reward"), VARIABLES, sandbox)
    assert not verdict.passed
    assert not source
    assert verdict.message
    assert not canary.exists()
    assert before == (dict(os.environ), torch.get_num_threads(), torch.initial_seed())


@pytest.mark.parametrize("name", HARMLESS_LOOKALIKES)
def test_text_that_is_never_run_is_only_text(sandbox, tmp_path, name):
    canary = tmp_path / "canary"
    reply = HARMLESS_LOOKALIKES[name].replace("CANARY", str(canary))
    verdict, _ = judge(Submission(reply, "reward"), VARIABLES, sandbox)
    assert verdict.passed, verdict
    assert not canary.exists()


_NEEDS_THE_PROBE = {name for name in ATTACKS if name.startswith("doubling") or "_grown_" in name} | {"power_tower"}
"""What a compilation alone cannot tell: what grows in a loop of allowed length, and what is merely infinite."""


@pytest.mark.parametrize("name", sorted(set(ATTACKS) - _NEEDS_THE_PROBE))
def test_a_downloaded_source_is_refused_without_a_probe(tmp_path, name):
    """Training compiles stored sources without the sandbox: the checks alone must refuse them, and run nothing."""
    canary = tmp_path / "canary"
    source = ATTACKS[name].replace("CANARY", str(canary))
    with pytest.raises(CodeError):
        compile_reward(source, VARIABLES, portable=True)
    assert not canary.exists()
