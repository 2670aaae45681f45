"""States in a file: everything comes back, and the same values give the same bytes."""

import pytest
import torch

from code_cases import VARIABLES, values
from porse.errors import TaskError
from porse.functions.read.states import load_states, save_states


def test_states_come_back_as_they_were(tmp_path):
    states = values()
    save_states(tmp_path / "s", states)
    loaded = load_states(tmp_path / "s", VARIABLES)
    assert loaded.keys() == states.keys()
    for name, value in states.items():
        same = torch.equal(value, loaded[name]) if isinstance(value, torch.Tensor) else value == loaded[name]
        assert same, name
    assert loaded["steps"].dtype == torch.int64


def test_the_same_states_give_the_same_bytes_in_any_order(tmp_path):
    states = values()
    save_states(tmp_path / "one", states)
    save_states(tmp_path / "two", dict(reversed(states.items())))
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


def test_a_missing_variable_is_an_error_that_names_it_and_the_rest(tmp_path):
    save_states(tmp_path / "s", {"a": torch.zeros(2, 3)})
    with pytest.raises(TaskError, match="expected the variable b in the states file s, found a"):
        load_states(tmp_path / "s", VARIABLES)
