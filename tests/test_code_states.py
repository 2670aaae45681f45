"""States in a message: everything comes back, in its order, and the same values give the same text."""

import json

import torch

from code_cases import values
from porse.functions.read.states import packed, unpacked


def test_states_come_back_as_they_were():
    states = values()
    found = unpacked(json.loads(json.dumps(packed(states))))
    assert list(found) == list(states)
    for name, value in states.items():
        same = torch.equal(value, found[name]) if isinstance(value, torch.Tensor) else value == found[name]
        assert same, name
    assert found["steps"].dtype == torch.int64
    assert found["device"] == torch.device("cpu")


def test_the_same_states_give_the_same_tensors_in_any_order():
    states = values()
    assert packed(states)["tensors"] == packed(dict(reversed(states.items())))["tensors"]
