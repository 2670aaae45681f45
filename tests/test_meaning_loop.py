"""What a training's loop means where one number stands for another: found by mutants that no other test noticed.

Public functions alone are called, so that the loop may be written otherwise.
"""

import dataclasses

import numpy as np
import pytest
import torch

from meaning_cases import changed
from porse.checkpoint import Checkpoint, write_checkpoint
from porse.training.actor import policy_actor
from porse.training.bonus import Bonuses
from porse.training.finite import check_policy, finite
from porse.training.lengths import EpisodeLengths
from porse.training.ppo import build_ppo
from porse.training.reward import CandidateFailed, Reward
from porse.training.scale import NoScale, ReturnScale
from porse.training.snapshot import same_names
from porse.training.trainer import Trainer, draw_policy
from porse.training.vecenv import observation_groups


class Standing:
    """Three environments in which nothing moves and nothing ends."""

    NAME = "Standing"
    NUM_ACTIONS, NUM_OBSERVATIONS, EPISODE_LENGTH, OVER_EPISODES, num_envs = 1, 1, 9, False, 3
    device, is_asynchronous = torch.device("cpu"), False

    def __init__(self):
        self.progress = torch.zeros(3, dtype=torch.int64)

    def step(self, actions):
        pass

    def observations(self):
        return torch.tensor([[1.0], [2.0], [4.0]])

    def present(self):
        return {"num_envs": 3, "obs_buf": self.observations()}

    def terminated(self):
        return torch.zeros(3, dtype=torch.bool)

    timed_out = terminated

    def check(self):
        pass

    def mean_fitness(self):
        return torch.tensor(0.5)


class Asked:
    """A bonus of zero that remembers for which epochs it was asked."""

    def __init__(self):
        self.epochs = []

    def see(self, variables):
        return torch.zeros(3), {}

    def pay(self, epoch, seen, ends):
        self.epochs.append(epoch)
        return Bonuses(torch.zeros(ends.shape), {})


@pytest.fixture
def tiny(params):
    """A training of one step an epoch, and of networks of one unit."""
    return changed(
        params, train={"num_envs": 3, "steps_per_epoch": 1, "hidden": (1,), "activation": "relu", "minibatches": 1}
    ).train


def one(task, variables):
    return torch.tensor([1.0, 2.0, 4.0]), {}


def test_a_bonus_is_told_the_epoch_that_is_paid_for(tiny):
    bonus = Asked()
    training = Trainer(Standing(), Reward(one, bonus, 0.7, 2.0, NoScale(), NoScale()), tiny, 5)
    training.train(3, lambda *_: None, lambda _: None)
    # counts that live three epochs begin with the first and the fourth
    assert bonus.epochs == [1, 2, 3]


def test_a_training_that_is_older_than_it_should_become_does_nothing(tiny):
    training = Trainer(Standing(), Reward(one, Asked(), 0.7, 2.0, NoScale(), NoScale()), tiny, 5)
    assert [row.epoch for row in training.train(2, lambda *_: None, lambda _: None) if row.series == "fitness"] == [
        1,
        2,
    ]
    begun = []

    def before(epoch):
        begun.append(epoch)
        raise AssertionError(epoch)

    assert (training.train(1, lambda *_: None, before), begun, training.epoch) == ([], [], 2)


def test_a_training_takes_the_algorithms_of_torch_that_have_one_result(tiny):
    torch.use_deterministic_algorithms(False)
    Trainer(Standing(), Reward(one, Asked(), 0.7, 2.0, NoScale(), NoScale()), tiny, 5)
    assert torch.are_deterministic_algorithms_enabled()


def test_a_policy_acts_on_observations_in_deviations_from_their_mean_that_are_no_whole_numbers(tiny, tmp_path):
    normalising = dataclasses.replace(tiny, normalise_observations=True, observation_clip=2.5)
    drawn = draw_policy(1, 1, normalising, 0)
    # mean 1 and deviation 2, with the hundredth that is added to it; every weight is 1, and every bias 0
    values = {"_mean": 1.0, "_std": 1.99, "_var": 1.99**2, "weight": 1.0, "bias": 0.0}
    arrays = {
        name: next((np.full_like(array, value) for end, value in values.items() if name.endswith(end)), array)
        for name, array in drawn.arrays.items()
    }
    write_checkpoint(tmp_path / "policy.safetensors", Checkpoint(arrays, drawn.scalars))
    act = policy_actor(Standing(), tmp_path / "policy.safetensors", normalising)
    # (4 - 1) / 2; (1.5 - 1) / 2; 6 deviations, cut off at 2.5; and what the hidden unit holds at 0
    actions = act(torch.tensor([[4.0], [1.5], [13.0], [-3.0]]))
    assert actions.flatten().tolist() == pytest.approx([1.5, 0.25, 2.5, 0.0], abs=1e-6)


# What has to be finite.


def test_a_failure_says_which_share_of_the_values_is_not_finite():
    finite("its numbers were", torch.tensor([1.0, -3.0]))
    with pytest.raises(CandidateFailed, match=r"^its numbers were not finite in 40\.0% of the values$"):
        finite("its numbers were", torch.tensor([1.0, float("nan"), 2.0, float("-inf"), 3.0]))


@pytest.mark.parametrize(("deviation", "told"), [(0.0, "0"), (-0.25, "-0.25")])
def test_the_deviation_of_actions_has_to_stay_above_zero(tiny, deviation, told):
    ppo = build_ppo(observation_groups(torch.zeros(3, 1)), 1, tiny)
    check_policy(ppo)
    with torch.no_grad():
        ppo.actor.distribution.std_param.fill_(deviation)
    with pytest.raises(CandidateFailed, match=f"^the deviation of its actions fell to {told}$"):
        check_policy(ppo)


@pytest.mark.parametrize("network", ["actor", "critic"])
def test_no_weight_may_be_infinite(tiny, network):
    ppo = build_ppo(observation_groups(torch.zeros(3, 1)), 1, tiny)
    name, weight = next(iter(getattr(ppo, network).named_parameters()))
    with torch.no_grad():
        weight.fill_(float("inf"))
    with pytest.raises(CandidateFailed, match=f"^its weights {name} were not finite in 100"):
        check_policy(ppo)


# Streams and series.


def test_moments_of_several_epochs_are_those_of_all_their_returns():
    # gamma 0: returns are the rewards themselves. 1 and 3, then 8, then 0: mean 3, squares 4 + 0 + 25 + 9 = 38
    size = ReturnScale(0.0, 1)
    for rewards in ([1.0, 3.0], [8.0], [0.0]):
        stream = torch.tensor(rewards).unsqueeze(1)
        size.apply(stream, torch.zeros(stream.shape, dtype=torch.bool))
    assert size.deviation() == pytest.approx(9.5**0.5)
    assert size.state()["moments"].tolist() == pytest.approx([4.0, 3.0, 38.0])


@pytest.mark.parametrize(("num_envs", "moments"), [(2, 3), (4, 3), (3, 2), (3, 4)])
def test_a_scale_of_other_environments_or_moments_is_refused(num_envs, moments):
    state = {"return": torch.zeros(num_envs), "moments": torch.zeros(moments)}
    with pytest.raises(ValueError, match=f"of {num_envs} environments, not of 3"):
        ReturnScale(0.5, 3).load_state(state)


def test_an_epochs_episode_length_is_a_mean_that_may_be_no_whole_number():
    lengths = EpisodeLengths()
    lengths.add(torch.tensor([3, 5, 8]), torch.tensor([True, False, True]))
    lengths.add(torch.tensor([4, 6, 9]), torch.tensor([False, True, False]))
    # 17 steps of 3 episodes; then none ended
    assert lengths.take() == {"episode_length": pytest.approx(17 / 3)}
    assert lengths.take() == {}


def test_a_state_may_have_neither_more_nor_fewer_names_than_are_wanted():
    one, two = torch.zeros(1), torch.ones(2)
    found = {"a": one, "b": two}
    assert same_names(found, {"b": one, "a": two}) is found
    for wanted, named in (({"a": one}, "b"), ({"a": one, "b": one, "c": one}, "c"), ({"a": one, "d": one}, "b, d")):
        with pytest.raises(ValueError, match=f"^{named} are in one of the two alone$"):
            same_names(found, wanted)
