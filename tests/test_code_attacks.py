"""Every attack is refused and nothing of it takes effect; text that only looks like one is only text."""

import os

import pytest
import torch

from code_attacks import ATTACKS, HARMLESS_LOOKALIKES, TRACER_ATTACKS
from code_cases import values
from porse.functions.read.confine import Limits
from porse.functions.read.sandbox import Sandbox
from porse.functions.read.states import packed


@pytest.fixture(scope="module")
def sandbox():
    with Sandbox(Limits(wall_s=2.0, cpu_s=2)) as running:
        running.prepare(packed(values()))
        yield running


ALL = ATTACKS | TRACER_ATTACKS


def test_there_are_many():
    assert len(ATTACKS) >= 100
    assert len(TRACER_ATTACKS) >= 40


@pytest.mark.parametrize("name", ALL)
def test_attack_is_refused(sandbox, tmp_path, name):
    canary = tmp_path / "canary"
    before = dict(os.environ), torch.get_num_threads(), torch.initial_seed()
    verdict, source = sandbox.judge(ALL[name].replace("CANARY", str(canary)), "reward")
    assert not verdict.passed
    assert not source
    assert verdict.message
    assert not canary.exists()
    assert before == (dict(os.environ), torch.get_num_threads(), torch.initial_seed())


@pytest.mark.parametrize("name", HARMLESS_LOOKALIKES)
def test_text_that_is_never_run_is_only_text(sandbox, tmp_path, name):
    canary = tmp_path / "canary"
    reply = HARMLESS_LOOKALIKES[name].replace("CANARY", str(canary))
    verdict, _ = sandbox.judge(reply, "reward")
    assert verdict.passed, verdict
    assert not canary.exists()
