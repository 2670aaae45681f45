"""Every attack is refused and nothing of it takes effect; text that only looks like one is only text."""

import os

import pytest
import torch

from code_attacks import ATTACKS, HARMLESS_LOOKALIKES, TRACER_ATTACKS
from code_cases import VARIABLES, judge, values
from porse.functions.read.limits import Limits
from porse.functions.read.sandbox import Sandbox, Submission
from porse.functions.read.states import save_states


@pytest.fixture(scope="module")
def sandbox(tmp_path_factory):
    path = tmp_path_factory.mktemp("states") / "states.safetensors"
    save_states(path, values())
    with Sandbox(Limits(wall_s=2.0, cpu_s=2)) as running:
        running.load(path, VARIABLES)
        yield running


ALL = ATTACKS | TRACER_ATTACKS


def test_there_are_many():
    assert len(ATTACKS) >= 100
    assert len(TRACER_ATTACKS) >= 40


@pytest.mark.parametrize("name", ALL)
def test_attack_is_refused(sandbox, tmp_path, name):
    canary = tmp_path / "canary"
    before = dict(os.environ), torch.get_num_threads(), torch.initial_seed()
    verdict, source = judge(Submission(ALL[name].replace("CANARY", str(canary)), "reward"), VARIABLES, sandbox)
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
