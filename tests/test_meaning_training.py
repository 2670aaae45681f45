"""What a training means: the total reward, PPO's construction, GAE by pencil, and who is trained with which draws."""

import dataclasses
import json
import math
from typing import ClassVar

import numpy as np
import pytest
import torch

from meaning_cases import changed, named, row_of
from porse import tables
from porse.checkpoint import policy_checkpoint, read_checkpoint, write_checkpoint
from porse.errors import CheckpointError
from porse.exploration import Counts, ProgressSpace, SimHash, literal, relative
from porse.functions.verdict import CodeError
from porse.identity import seed_for
from porse.plan import write_plan
from porse.pool import Pool, policy_file, read_pool, write_pool
from porse.training import candidate as candidate_module
from porse.training import evaluation as evaluation_module
from porse.training import probing as probing_module
from porse.training import rung as rung_module
from porse.training.bonus import Bonuses, Ledger, MappingBonus, NoBonus, Price, SimHashBonus
from porse.training.candidate import train_candidate
from porse.training.episodes import Episode, play_episodes
from porse.training.evaluation import evaluate
from porse.training.fitness import EpochFitness
from porse.training.goal import generated, human, sparse
from porse.training.job import Job, Outcome
from porse.training.ppo import build_ppo
from porse.training.probing import Probe, search_alphas, search_rung
from porse.training.reward import CandidateFailed, EpochMeans, Reward
from porse.training.rung import job_for, train_rung
from porse.training.scale import NoScale, ReturnScale
from porse.training.start import random_policy
from porse.training.trainer import Trainer, draw_policy
from porse.training.vecenv import TaskEnv, observation_groups
from samples import MAPPING, REWARD, program


class Task:
    """Three environments whose states, ends and rewards a pencil knows.

    Observations before each step and after the last; the first environment never ends, the second meets the time limit
    in the second step, the third fails there, at the time limit, too.
    """

    NAME = "Scripted"
    NUM_ACTIONS, NUM_OBSERVATIONS, EPISODE_LENGTH, OVER_EPISODES, num_envs = 1, 1, 9, False, 3
    device, is_asynchronous = torch.device("cpu"), False
    STATES: ClassVar = [[1.0, 2.0, 2.0], [2.0, 3.0, 3.0], [3.0, 1.0, 1.0], [4.0, 3.0, 3.0]]
    REWARDS: ClassVar = [1.0, 2.0, 4.0]

    def __init__(self):
        self.progress = torch.zeros(3, dtype=torch.int64)
        self.steps, self.resets, self.staggered = 0, [], []

    def step(self, actions):
        self.steps += 1

    def observations(self):
        return torch.tensor(self.STATES[self.steps % 4]).unsqueeze(1)

    def present(self):
        return {"num_envs": 3, "obs_buf": self.observations()}

    def _second(self, flags):
        return torch.tensor(flags if self.steps == 2 else [False] * 3)

    def terminated(self):
        return self._second([False, False, True])

    def timed_out(self):
        return self._second([False, True, True])

    def reset(self, mask):
        self.resets.append((self.steps, mask.tolist()))

    renew = reset

    def stagger(self, seed):
        self.staggered.append(seed)

    def check(self):
        pass

    def mean_fitness(self):
        return torch.tensor(self.fitness())

    def human_reward(self):
        return torch.full((3,), 11.0)

    def sparse_reward(self):
        return torch.full((3,), 0.25)

    def fitness(self):
        return 100.0 + self.steps

    def state(self):
        return {}

    def load_state(self, state):
        assert state == {}


def goal_of_task(task, variables):
    return torch.full((3,), task.REWARDS[(task.steps - 1) % 3]), {}


# The total reward.


class Fixed:
    """A bonus of 0.5, 3 and 4, whatever happens."""

    def see(self, variables):
        return torch.zeros(3), {"z": torch.tensor([7.0, 8.0, 9.0]), "a": torch.tensor([1.0, 2.0, 3.0])}

    def pay(self, epoch, seen, ends):
        return Bonuses(torch.tensor([[0.5, 3.0, 4.0]]), {"cells_visited": 0.25, "new_cells": 6.0})

    def state(self):
        return {}


def fixed_goal(task, variables):
    components = {"y": torch.tensor([1.0, 2.0, 3.0]), "b": torch.tensor([4.0, 5.0, 6.0])}
    return torch.tensor([10.0, -2.0, 1.0]), components


def no_ends(steps, num_envs):
    return torch.zeros((steps, num_envs), dtype=torch.bool)


def paid(reward, task=None, epoch=1):
    """What a reward pays for an epoch of one step."""
    task = task or Task()
    reward.see(task)
    return reward.pay(epoch, no_ends(1, task.num_envs))


class Times:
    """Multiplies a stream by a number."""

    def __init__(self, factor):
        self.factor = factor

    def apply(self, stream, ends):
        return self.factor * stream.double()


def test_beta_weighs_the_bonus_and_the_rest_of_the_scale_the_goal():
    total = paid(Reward(fixed_goal, Fixed(), 0.7, 2.0, NoScale(), NoScale())).total
    # 0.7 x 0.5 + 1.3 x 10 = 13.35; 0.7 x 3 - 1.3 x 2 = -0.5; 0.7 x 4 + 1.3 = 4.1
    assert total[0].tolist() == pytest.approx([13.35, -0.5, 4.1], abs=1e-6)
    # of a scale of 1: 0.35 + 0.3 x 10 = 3.35; 2.1 - 0.6 = 1.5; 2.8 + 0.3 = 3.1
    total = paid(Reward(fixed_goal, Fixed(), 0.7, 1.0, NoScale(), NoScale())).total
    assert total[0].tolist() == pytest.approx([3.35, 1.5, 3.1], abs=1e-6)
    assert total.dtype == torch.float32


def test_the_goal_is_scaled_before_the_mix_and_the_mix_after_it():
    payment = paid(Reward(fixed_goal, Fixed(), 0.7, 2.0, Times(0.1), Times(3.0)))
    # 3 (0.7 x 0.5 + 1.3 x 1) = 4.95; 3 (2.1 - 0.26) = 5.52; 3 (2.8 + 0.13) = 8.79
    assert payment.total[0].tolist() == pytest.approx([4.95, 5.52, 8.79], abs=1e-6)
    # and the mean of the mix, before it is scaled: (1.65 + 1.84 + 2.93) / 3
    assert payment.series["reward"] == pytest.approx(2.14)


def test_what_is_written_down_is_each_stream_before_it_is_weighed_and_both_sizes_after():
    series = paid(Reward(fixed_goal, Fixed(), 0.7, 2.0, Times(0.1), Times(3.0))).series
    assert list(series) == [
        "goal", "bonus", "goal_size", "bonus_size", "bonus_share", "cells_visited", "new_cells", "component/b",
        "component/y", "progress/z", "progress/a", "reward",
    ]  # fmt: skip
    # (10 - 2 + 1) / 3 and (0.5 + 3 + 4) / 3, as they are
    assert (series["goal"], series["bonus"]) == (pytest.approx(3.0), pytest.approx(2.5))
    assert (series["component/b"], series["component/y"]) == (5.0, 2.0)
    assert (series["progress/z"], series["progress/a"]) == (8.0, 2.0)
    # 0.13 x (10, -2, 1): distances from the mean 0.13 x (7, -5, -2), so 0.13 sqrt(78 / 3)
    assert series["goal_size"] == pytest.approx(0.13 * 26**0.5)
    # 0.7 x (0.5, 3, 4): 0.7 x (-2, 0.5, 1.5), so 0.7 sqrt(6.5 / 3)
    assert series["bonus_size"] == pytest.approx(0.7 * (6.5 / 3) ** 0.5)
    # of the mix 1.65, 1.84, 2.93: -0.49, -0.30, 0.79 from 2.14, so sqrt((0.2401 + 0.09 + 0.6241) / 3)
    assert series["bonus_share"] == pytest.approx(0.7 * (6.5 / 3) ** 0.5 / (0.9542 / 3) ** 0.5)
    assert (series["cells_visited"], series["new_cells"]) == (0.25, 6.0)


def test_without_a_bonus_its_share_is_zero_and_no_cells_are_counted():
    series = paid(Reward(fixed_goal, NoBonus(), 0.0, 2.0, NoScale(), NoScale())).series
    assert (series["bonus"], series["bonus_size"], series["bonus_share"]) == (0.0, 0.0, 0.0)
    assert "cells_visited" not in series
    assert "new_cells" not in series
    # where nothing varies at all, neither does the bonus
    constant = Reward(lambda task, variables: (torch.ones(3), {}), NoBonus(), 0.0, 2.0, NoScale(), NoScale())
    assert paid(constant).series["bonus_share"] == 0.0


def test_where_goal_and_bonus_cancel_out_the_share_is_the_bonuss_own_size():
    # 0.5 x (0.5, 3, 4) and 0.5 x (-0.5, -3, -4): the mix is 0 everywhere
    goal = Reward(lambda *_: (torch.tensor([-0.5, -3.0, -4.0]), {}), Fixed(), 0.5, 1.0, NoScale(), NoScale())
    series = paid(goal).series
    assert series["bonus_size"] == series["bonus_share"] == pytest.approx(0.5 * (6.5 / 3) ** 0.5)


def test_means_are_over_all_steps_and_environments_and_begin_anew_with_an_epoch():
    goals = iter([[1.0, 3.0, 2.0], [6.0, 0.0, 3.0], [4.0, 8.0, 9.0]])
    reward = Reward(lambda *_: (torch.tensor(next(goals)), {}), NoBonus(), 0.0, 1.0, NoScale(), NoScale())
    reward.see(Task())
    reward.see(Task())
    assert reward.pay(1, no_ends(2, 3)).series["goal"] == 2.5
    assert paid(reward).series["goal"] == 7.0


def test_what_a_function_returns_is_copied():
    """It may be the simulation's own memory, which the next step changes."""
    memory = torch.tensor([1.0, 2.0, 6.0])
    reward = Reward(lambda *_: (memory, {}), NoBonus(), 0.0, 1.0, NoScale(), NoScale())
    reward.see(Task())
    memory.zero_()
    assert reward.pay(1, no_ends(1, 3)).total.tolist() == [[1.0, 2.0, 6.0]]


# The scale of a stream.


def test_a_stream_is_divided_by_the_deviation_of_its_discounted_return():
    """Gamma 1/2; rewards 1, 2, 4 and 3, 1, 2; the second environment's episode ends in the second step.

    Returns: 1, 0.5 + 2 = 2.5, 1.25 + 4 = 5.25; 3, 1.5 + 1 = 2.5, then anew 2. Their mean is 16.25 / 6 and the mean of
    their squares (1 + 6.25 + 27.5625 + 9 + 6.25 + 4) / 6 = 54.0625 / 6.
    """
    size = ReturnScale(0.5, 2)
    stream = torch.tensor([[1.0, 3.0], [2.0, 1.0], [4.0, 2.0]])
    ends = torch.tensor([[False, False], [False, True], [False, False]])
    expected = (54.0625 / 6 - (16.25 / 6) ** 2) ** 0.5
    assert size.apply(stream, ends).flatten().tolist() == pytest.approx([v / expected for v in (1, 3, 2, 1, 4, 2)])
    assert size.deviation() == pytest.approx(expected)
    # The next epoch goes on from the returns 5.25 and 2: 2.625 + 1 and 1 + 5; moments are over all 8.
    expected = ((54.0625 + 3.625**2 + 6.0**2) / 8 - ((16.25 + 3.625 + 6.0) / 8) ** 2) ** 0.5
    found = size.apply(torch.tensor([[1.0, 5.0]]), no_ends(1, 2))
    assert found.flatten().tolist() == pytest.approx([1.0 / expected, 5.0 / expected])


def test_the_scale_does_not_depend_on_the_units():
    def scaled(factor):
        size = ReturnScale(0.9, 8)
        streams = [torch.randn((5, 8), generator=torch.Generator().manual_seed(seed)) + 3.0 for seed in range(3)]
        return torch.cat([size.apply(factor * stream.double(), no_ends(5, 8)) for stream in streams])

    assert torch.equal(scaled(1.0), scaled(2.0**-30))
    torch.testing.assert_close(scaled(1000.0), scaled(1.0), rtol=1e-12, atol=0.0)
    torch.testing.assert_close(scaled(1e-20), scaled(1.0), rtol=1e-12, atol=0.0)


def test_a_stream_that_was_never_paid_stays_zero_and_one_that_never_varies_gets_the_size_1():
    nothing, ends = torch.zeros(3, 2), no_ends(3, 2)
    assert ReturnScale(0.9, 2).apply(nothing, ends).tolist() == nothing.tolist()
    # gamma 0: the return is the reward, 0.1 in every step, and what its sums are off is no variance
    assert ReturnScale(0.0, 2).apply(torch.full((7, 2), 0.1), no_ends(7, 2)).tolist() == [[1.0, 1.0]] * 7
    size = ReturnScale(0.9, 2)
    assert (size.deviation(), size.apply(nothing, ends).isfinite().all().item()) == (1.0, True)
    # nor is there a size after zeros
    assert size.deviation() == 1.0
    # one payment at last: of 12 returns one is 1
    first = torch.tensor([[0.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
    assert size.apply(first, ends)[2, 1].item() == pytest.approx(1.0 / (1 / 12 - 1 / 144) ** 0.5)


def test_a_variance_below_a_trillionth_of_the_squared_mean_is_rounding():
    # gamma 0, rewards 3 (1 - d) and 3 (1 + d): mean 3, variance 9 d^2; the limit is 9 x 2^-40
    for times, expected in ((1.25, 3.0 * 1.25 * 2.0**-20), (0.75, 3.0)):
        apart = times * 2.0**-20
        size = ReturnScale(0.0, 2)
        size.apply(3.0 * torch.tensor([[1.0 - apart, 1.0 + apart]], dtype=torch.float64), no_ends(1, 2))
        assert size.deviation() == pytest.approx(expected, rel=1e-6)


def test_a_scale_continues_from_a_state():
    streams = [torch.randn((4, 3), generator=torch.Generator().manual_seed(seed)) for seed in range(6)]
    ends = [stream > 1.0 for stream in streams]
    whole, first, second = (ReturnScale(0.9, 3) for _ in range(3))
    expected = [whole.apply(*step).tolist() for step in zip(streams, ends, strict=True)]
    for step in zip(streams[:3], ends[:3], strict=True):
        first.apply(*step)
    second.load_state(first.state())
    assert [second.apply(*step).tolist() for step in zip(streams[3:], ends[3:], strict=True)] == expected[3:]
    with pytest.raises(ValueError, match="of 3 environments, not of 4"):
        ReturnScale(0.9, 4).load_state(first.state())
    second.forget()
    assert second.apply(streams[0], ends[0]).tolist() == expected[0]


def test_goals_are_the_generated_function_the_human_and_the_sparse_reward():
    task = Task()
    assert human(task, {})[0].tolist() == [11.0] * 3
    assert sparse(task, {})[0].tolist() == [0.25] * 3

    def function(variables):
        return [torch.full((variables["num_envs"],), 6.0), torch.full((3,), 2.0), torch.full((3,), 4.0)]

    function.names = ("near", "calm")
    total, components = generated(function)(task, task.present())
    assert total.tolist() == [6.0] * 3
    assert {name: value.tolist() for name, value in components.items()} == {"near": [2.0] * 3, "calm": [4.0] * 3}


def test_epoch_means_weigh_every_step_alike():
    means = EpochMeans()
    for values in ([1.0, 3.0], [2.0, 6.0], [0.0, 3.0]):
        means.add({"x": torch.tensor(values)})
    # (1 + 3 + 2 + 6 + 0 + 3) / 6, and anew in the next epoch: (4 + 8) / 2
    assert means.take() == {"x": 2.5}
    means.add({"x": torch.tensor([4.0, 8.0])})
    assert means.take() == {"x": 6.0}


def test_one_environment_whose_goal_is_not_finite_ends_the_training():
    def goal(task, variables):
        late = torch.tensor([0.0, float("nan"), 2.0])
        return late, {"late": late, "fine": torch.ones(3)}

    # one of three
    with pytest.raises(CandidateFailed, match=r"not finite in 33\.3% of the epoch's states \(components: late\)"):
        paid(Reward(goal, NoBonus(), 0.7, 2.0, NoScale(), NoScale()))


def test_a_function_that_raises_ends_the_training():
    def goal(task, variables):
        raise CodeError("run", "odd")

    with pytest.raises(CandidateFailed, match="its function raised in training: odd"):
        paid(Reward(goal, NoBonus(), 0.7, 2.0, NoScale(), NoScale()))


def test_a_total_that_single_precision_cannot_hold_ends_the_training():
    large = Reward(lambda *_: (torch.full((3,), 3e38), {}), NoBonus(), 0.0, 2.0, NoScale(), NoScale())
    with pytest.raises(CandidateFailed, match=r"its total reward was not finite in 100\.0% of the epoch's states"):
        paid(large)


# The bonus.


def ledger(cells, num_envs, factor=0.4, *, rarity=literal, size=None, life_epochs=0, each_episode=False):
    price = Price(rarity, size or NoScale(), factor)
    return Ledger(Counts(cells, num_envs, each_episode), price, life_epochs)


def test_a_mapping_bonus_counts_the_outputs_in_their_order_and_shows_them_by_name():
    def mapping(variables):
        return [torch.tensor([0.0, 30.0, -30.0]), torch.tensor([0.0, -30.0, -30.0])]

    mapping.names = ("far", "deep")
    bonus = MappingBonus(mapping, ProgressSpace([True, False], 16, "grid"), ledger(16, 3))
    seen, progress = bonus.see({})
    assert seen.tolist() == [[0.0, 30.0, -30.0], [0.0, -30.0, -30.0]]
    assert [(name, value.tolist()) for name, value in progress.items()] == [
        ("far", [0.0, 30.0, -30.0]),
        ("deep", [0.0, -30.0, -30.0]),
    ]
    found = bonus.pay(1, seen.unsqueeze(0), no_ends(1, 3))
    # 4 bins: m = 0 of the first and 30 of the second, turned; s = 7.5; nothing is beyond 22.3 s.
    # bins (2, 1), (2, 2), (1, 2), so cells 9, 10 and 6
    assert bonus.space.locate(seen.t().unsqueeze(0)).tolist() == [[9, 10, 6]]
    assert found.amount[0].tolist() == pytest.approx([0.4] * 3)
    assert found.series == {"cells_visited": 3 / 16, "new_cells": 3.0}


def test_a_simhash_bonus_counts_the_observation_and_remembers_its_counts():
    bonus = SimHashBonus(SimHash(1, 3, 0), ledger(8, 3))
    seen, progress = bonus.see({"obs_buf": torch.tensor([[1.0], [1.0], [-1.0]]), "root": torch.zeros(3, 1)})
    assert progress == {}
    found = bonus.pay(1, seen.unsqueeze(0), no_ends(1, 3))
    assert found.amount[0].tolist() == pytest.approx([0.4 / 2**0.5, 0.4 / 2**0.5, 0.4])
    assert found.series == {"cells_visited": 0.25, "new_cells": 2.0}
    other = SimHashBonus(SimHash(1, 3, 0), ledger(8, 3))
    other.load_state(bonus.state())
    # a third, a fourth and a second visit... of all three environments at once: 2 + 2 and 1 + 1
    assert other.pay(2, seen.unsqueeze(0), no_ends(1, 3)).amount[0].tolist() == pytest.approx(
        [0.4 / 4**0.5, 0.4 / 4**0.5, 0.4 / 2**0.5]
    )


def test_counts_live_as_long_as_they_are_told():
    cells, ends = torch.tensor([[1, 1]]), no_ends(1, 2)

    def amounts(life_epochs):
        book = ledger(5, 2, life_epochs=life_epochs)
        found = []
        for epoch in range(1, 6):
            book.begins_anew(epoch)
            found.append(book.pay(cells, ends).amount[0, 0].item())
        return found

    # 2, 4, 6, 8, 10 visits; or anew in the third and in the fifth epoch
    assert amounts(0) == pytest.approx([0.4 / n**0.5 for n in (2, 4, 6, 8, 10)])
    assert amounts(2) == pytest.approx([0.4 / n**0.5 for n in (2, 4, 2, 4, 2)])
    # in the fourth; and in every epoch
    assert amounts(3) == pytest.approx([0.4 / n**0.5 for n in (2, 4, 6, 2, 4)])
    assert amounts(1) == pytest.approx([0.4 / 2**0.5] * 5)


def test_bins_are_fixed_anew_with_the_counts():
    def bonus(life_epochs):
        return MappingBonus(None, ProgressSpace([True], 5, "grid"), ledger(5, 1, life_epochs=life_epochs))

    for life_epochs, centre in ((0, 3.0), (2, 9.0)):
        found = bonus(life_epochs)
        for epoch, value in ((1, 3.0), (2, 6.0), (3, 9.0), (4, 12.0)):
            found.pay(epoch, torch.tensor([[[value]]]), no_ends(1, 1))
        assert found.space.state()["bins"][0, 0].item() == centre


def test_a_mapping_bonus_remembers_its_bins_and_its_counts():
    def made():
        return MappingBonus(None, ProgressSpace([True], 5, "grid"), ledger(5, 2))

    first, second = made(), made()
    first.pay(1, torch.tensor([[[3.0, 3.0]]]), no_ends(1, 2))
    assert set(first.state()) == {"bins", "counts", "visited"}
    second.load_state(first.state())
    # third and fourth visit of the cell around 3, and a first one of another cell
    found = second.pay(2, torch.tensor([[[3.0, 9.0]], [[3.0, 3.0]]]), no_ends(2, 2))
    assert found.amount.tolist() == [pytest.approx([0.4 / 3**0.5, 0.4]), pytest.approx([0.4 / 5**0.5] * 2)]


def test_a_price_is_a_factor_times_the_sized_rarity():
    book = ledger(5, 2, 0.3, rarity=relative)
    # cell 1 twice, then 2 and 1: 2 visits of 1 cell, then 4 of 2 cells; sqrt(2 / 2), then sqrt(2 / 1), sqrt(2 / 3)
    found = book.pay(torch.tensor([[1, 1], [2, 1]]), no_ends(2, 2)).amount
    assert found.flatten().tolist() == pytest.approx([0.3, 0.3, 0.3 * 2**0.5, 0.3 * (2 / 3) ** 0.5])
    assert ledger(5, 2, 0.3, size=Times(5.0)).pay(torch.tensor([[1, 2]]), no_ends(1, 2)).amount.tolist() == [[1.5, 1.5]]


def test_a_ledger_remembers_counts_and_size():
    first = ledger(5, 2, size=ReturnScale(0.5, 2))
    cells = [torch.randint(0, 5, (4, 2), generator=torch.Generator().manual_seed(seed)) for seed in range(3)]
    first.pay(cells[0], no_ends(4, 2))
    second = ledger(5, 2, size=ReturnScale(0.5, 2))
    second.load_state(first.state())
    for step in cells[1:]:
        assert torch.equal(first.pay(step, no_ends(4, 2)).amount, second.pay(step, no_ends(4, 2)).amount)


def test_a_rewards_state_is_its_bonuss_and_its_scales():
    def made():
        bonus = SimHashBonus(SimHash(1, 3, 0), ledger(8, 3))
        return Reward(fixed_goal, bonus, 0.7, 2.0, ReturnScale(0.5, 3), ReturnScale(0.5, 3))

    first, second = made(), made()
    paid(first)
    assert set(first.state()) == {
        "bonus.counts", "bonus.visited", "goal.return", "goal.moments", "total.return", "total.moments",
    }  # fmt: skip
    assert first.state()["goal.return"].tolist() == [10.0, -2.0, 1.0]
    second.load_state(first.state())
    assert torch.equal(paid(second).total, paid(first).total)
    assert all(torch.equal(value, second.state()[name]) for name, value in first.state().items())


def test_no_bonus_is_zero_for_every_environment():
    seen, progress = NoBonus().see({"num_envs": 3})
    assert (seen.shape, progress, NoBonus().state()) == ((3, 0), {}, {})
    found = NoBonus().pay(1, seen.unsqueeze(0), no_ends(1, 3))
    assert (found.amount.tolist(), found.series) == ([[0.0, 0.0, 0.0]], {})


# PPO.


@pytest.fixture(scope="module")
def pencil(params):
    """Values that no two parameters share."""
    train = {
        "num_envs": 3, "steps_per_epoch": 3, "hidden": (1,), "activation": "relu", "normalise_observations": False,
        "gamma": 0.5, "gae_lambda": 0.8, "observation_clip": 2.5, "scaling": "none", "passes": 2, "minibatches": 3, "clip": 0.3,
        "entropy": 0.02, "value_coefficient": 0.7, "max_grad_norm": 0.6, "learning_rate": 0.004, "desired_kl": 0.013,
        "init_std": 0.4,
    }  # fmt: skip
    return changed(params, train=train).train


def test_every_parameter_of_ppo_reaches_its_own_place(pencil):
    torch.manual_seed(0)
    ppo = build_ppo(observation_groups(torch.zeros(3, 1)), 1, pencil)
    assert (ppo.gamma, ppo.lam) == (0.5, 0.8)
    assert (ppo.num_learning_epochs, ppo.num_mini_batches) == (2, 3)
    assert (ppo.clip_param, ppo.entropy_coef, ppo.value_loss_coef, ppo.max_grad_norm) == (0.3, 0.02, 0.7, 0.6)
    assert (ppo.learning_rate, ppo.desired_kl, ppo.schedule) == (0.004, 0.013, "adaptive")
    [group] = ppo.optimizer.param_groups
    assert (type(ppo.optimizer), group["lr"], group["fused"]) == (torch.optim.Adam, 0.004, True)
    assert (group["betas"], group["eps"], group["weight_decay"]) == ((0.9, 0.999), 1e-8, 0)
    # actor and critic: 1 -> 1 -> 1 with biases, 4 numbers each, and the actor's deviation
    assert sum(parameter.numel() for parameter in group["params"]) == 9
    assert (ppo.storage.num_transitions_per_env, ppo.storage.num_envs) == (3, 3)
    ppo.act(observation_groups(torch.zeros(3, 1)))
    assert ppo.actor.output_distribution_params[1].tolist() == [[pytest.approx(0.4)]] * 3


def value_is_the_observation(ppo):
    """Sets the critic to V(s) = s for s >= 0: one hidden relu, weights 1 and biases 0."""
    with torch.no_grad():
        for name, parameter in ppo.critic.named_parameters():
            parameter.fill_(0.0 if "bias" in name else 1.0)


def test_advantages_by_pencil(pencil):
    """Gamma 1/2, lambda 0.8, so gamma lambda = 0.4; V(s) = s; rewards r = 1, 2, 4.

    First environment, states 1, 2, 3, then 4; it never ends:
        delta_2 = 4 + 0.5 x 4 - 3 = 3        A_2 = 3                     R_2 = 3 + 3 = 6
        delta_1 = 2 + 0.5 x 3 - 2 = 1.5      A_1 = 1.5 + 0.4 x 3 = 2.7   R_1 = 2.7 + 2 = 4.7
        delta_0 = 1 + 0.5 x 2 - 1 = 1        A_0 = 1 + 0.4 x 2.7 = 2.08  R_0 = 2.08 + 1 = 3.08
    Second, states 2, 3, then anew 1, then 3; the time limit ends it in the second step, which is paid gamma V(s_1) more:
        delta_2 = 4 + 0.5 x 3 - 1 = 4.5      A_2 = 4.5                   R_2 = 5.5
        delta_1 = (2 + 0.5 x 3) - 3 = 0.5    A_1 = 0.5                   R_1 = 3.5
        delta_0 = 1 + 0.5 x 3 - 2 = 0.5      A_0 = 0.5 + 0.4 x 0.5 = 0.7 R_0 = 2.7
    Third, the same states; it fails in the second step, at the time limit, and nothing is paid for what comes:
        R_2 = 5.5
        delta_1 = 2 - 3 = -1                 A_1 = -1                    R_1 = 2
        delta_0 = 0.5 as above               A_0 = 0.5 - 0.4 = 0.1       R_0 = 2.1
    """
    task = Task()
    trained = trainer(pencil, 5, task)
    ppo = trained._ppo
    value_is_the_observation(ppo)
    ppo.update = lambda: {}
    trained.train(1, lambda *_: None, lambda _: None)
    returns = ppo.storage.returns.squeeze(-1)
    assert returns[0].tolist() == pytest.approx([3.08, 2.7, 2.1], abs=1e-6)
    assert returns[1].tolist() == pytest.approx([4.7, 3.5, 2.0], abs=1e-6)
    assert returns[2].tolist() == pytest.approx([6.0, 5.5, 5.5], abs=1e-6)
    # Advantages are the nine numbers above, less their mean, over their deviation.
    raw = torch.tensor([[2.08, 0.7, 0.1], [2.7, 0.5, -1.0], [3.0, 4.5, 4.5]])
    torch.testing.assert_close(ppo.storage.advantages.squeeze(-1), (raw - raw.mean()) / raw.std(), atol=1e-5, rtol=0.0)


def test_an_epochs_series_are_means_and_resets_follow_ends(pencil):
    task = Task()
    reward = Reward(goal_of_task, NoBonus(), 0.0, 2.0, NoScale(), Times(0.1))
    env = TaskEnv(task, reward)
    for _ in range(3):
        env.step(torch.zeros(3, 1))
    # the third environment of three fails in one of three steps; total 2 (1 + 2 + 4) / 3
    assert env.means.take() == {"terminated": pytest.approx(1 / 9)}
    series = reward.pay(1, no_ends(3, 3)).series
    assert series["goal"] == pytest.approx(7 / 3)
    assert series["reward"] == pytest.approx(14 / 3)
    assert task.resets == [(2, [False, True, True])]


def test_an_episodes_end_is_an_end_for_scales_and_counts(pencil):
    seen = []

    class Spy(NoScale):
        def apply(self, stream, ends):
            seen.append(ends.tolist())
            return super().apply(stream, ends)

    reward = Reward(goal_of_task, NoBonus(), 0.0, 1.0, Spy(), Spy())
    Trainer(Task(), reward, pencil, 5).train(1, lambda *_: None, lambda _: None)
    # in the second step: at the time limit and by failing alike
    assert seen == [[[False] * 3, [False, True, True], [False] * 3]] * 2


def test_normalised_observations_are_cut_off_for_actor_and_critic_alike(pencil):
    normalising = dataclasses.replace(pencil, normalise_observations=True)
    torch.manual_seed(0)
    ppo = build_ppo(observation_groups(torch.zeros(3, 1)), 1, normalising)
    for network in (ppo.actor, ppo.critic):
        norm = network.obs_normalizer
        norm._mean.fill_(1.0)
        norm._std.fill_(1.99)
        # (x - 1) / (1.99 + 0.01): 6, 2, -2 and -6 deviations, cut off at 2.5
        values = torch.tensor([[13.0], [5.0], [-3.0], [-11.0]])
        assert norm(values).flatten().tolist() == [2.5, 2.0, -2.0, -2.5]
        latent = network.get_latent(observation_groups(values))
        assert latent.flatten().tolist() == [2.5, 2.0, -2.0, -2.5]
    # in what is exported too
    exported = ppo.actor.as_onnx(verbose=False)
    assert torch.equal(exported(torch.tensor([[13.0]])), exported(torch.tensor([[1e6]])))


def trainer(pencil, seed, task=None):
    reward = Reward(goal_of_task, NoBonus(), 0.0, 1.0, NoScale(), NoScale())
    return Trainer(task or Task(), reward, pencil, seed)


def test_episode_lengths_are_those_of_the_episodes_that_ended_in_an_epoch_before_they_were_reset(pencil):
    class Aged(Task):
        def step(self, actions):
            super().step(actions)
            self.progress = self.progress + torch.tensor([1, 3, 8])

        def reset(self, mask):
            super().reset(mask)
            self.progress[mask] = 0

    two_steps = dataclasses.replace(pencil, steps_per_epoch=2)
    rows = trainer(two_steps, 5, Aged()).train(2, lambda *_: None, lambda _: None)
    # in the second step, the last of the first epoch, the second and third episode end, at 6 and 16; then none does
    assert [(row.epoch, row.value) for row in rows if row.series == "episode_length"] == [(1, 11.0)]


def test_a_training_draws_from_a_generator_that_its_seed_names(pencil):
    trainer(pencil, 5)
    after = torch.get_rng_state()
    torch.manual_seed(named('[5,"ppo"]'))
    build_ppo(observation_groups(torch.zeros(3, 1)), 1, pencil)
    assert torch.equal(after, torch.get_rng_state())
    trainer(pencil, 6)
    assert not torch.equal(after, torch.get_rng_state())


@pytest.mark.parametrize(
    # fitness 101, 102, 103 | 104, 105, 106: their means, or what it is at an epoch's end
    ("over_episodes", "fitness"),
    [(False, [(1, 102.0), (2, 105.0)]), (True, [(1, 103.0), (2, 106.0)])],
)
def test_an_epoch_is_so_many_steps_and_its_fitness_their_mean_or_a_statistic_at_its_end(pencil, over_episodes, fitness):
    task, told, begun = Task(), [], []
    task.OVER_EPISODES = over_episodes
    rows = trainer(pencil, 5, task).train(2, lambda epoch, fitness: told.append((epoch, fitness)), begun.append)
    assert task.steps == 6
    assert begun == [1, 2]
    assert told == fitness
    assert [(row.epoch, row.value) for row in rows if row.series == "fitness"] == told
    assert [row.epoch for row in rows if row.series == "goal"] == [1, 2]


def test_fitness_is_of_the_state_that_a_step_led_to_and_not_of_what_a_reset_put_there(pencil):
    class Reset(Task):
        def fitness(self):
            return -9.0 if self.resets else 1.0 + self.steps

    env = TaskEnv(Reset(), Reward(goal_of_task, NoBonus(), 0.0, 1.0, NoScale(), NoScale()))
    env.step(torch.zeros(3, 1))
    env.step(torch.zeros(3, 1))
    # two environments were reset in the second step, after 3.0 had been read
    assert env.task.resets
    assert env.fitness.take() == 2.5


def test_a_step_without_a_finite_fitness_spoils_its_epoch_and_no_other():
    fitness, task = EpochFitness(), Task()
    for value in (1.0, float("inf"), float("-inf")):
        task.fitness = lambda value=value: value
        fitness.add(task)
    assert math.isnan(fitness.take())
    for value in (2.0, 5.0):
        task.fitness = lambda value=value: value
        fitness.add(task)
    assert fitness.take() == 3.5


def test_episodes_are_staggered_where_a_training_starts_and_not_where_it_goes_on(pencil, tmp_path):
    task = Task()
    first = trainer(pencil, 5, task)
    write_checkpoint(tmp_path / "policy.safetensors", draw_policy(1, 1, pencil, 0))
    first.load(tmp_path / "policy.safetensors")
    assert task.staggered == [named('[5,"ages"]')]
    first.train(1, lambda *_: None, lambda _: None)
    first.save(tmp_path / "checkpoint.safetensors")
    later = Task()
    trainer(pencil, 5, later).load(tmp_path / "checkpoint.safetensors")
    assert later.staggered == []


def test_a_checkpoint_holds_the_epoch_the_learning_rate_and_the_generator(pencil, tmp_path):
    first = trainer(pencil, 5)
    first.train(1, lambda *_: None, lambda _: None)
    first._ppo.learning_rate = 0.00321
    first.save(tmp_path / "c.safetensors")
    torch.manual_seed(0)
    found = read_checkpoint(tmp_path / "c.safetensors")
    assert (found.scalars["epoch"], found.scalars["learning_rate"]) == (1, 0.00321)
    drawn = torch.from_numpy(np.array(found.part("ppo")["generator"]))
    second = trainer(pencil, 99)
    second._env.task.load_state = lambda state: None
    second.load(tmp_path / "c.safetensors")
    assert (second.epoch, second._ppo.learning_rate) == (1, 0.00321)
    assert second._ppo.optimizer.param_groups[0]["lr"] == 0.00321
    assert torch.equal(torch.get_rng_state(), drawn)


def test_a_policy_is_started_from_at_epoch_zero_with_fresh_draws(pencil, tmp_path):
    write_checkpoint(tmp_path / "p.safetensors", draw_policy(1, 1, pencil, 77))
    started = trainer(pencil, 5)
    drawn = torch.get_rng_state()
    started.load(tmp_path / "p.safetensors")
    assert started.epoch == 0
    assert torch.equal(torch.get_rng_state(), drawn)
    weights = read_checkpoint(tmp_path / "p.safetensors").part("actor")
    assert all(np.array_equal(value.numpy(), weights[key]) for key, value in started._ppo.actor.state_dict().items())


def test_theta_random_is_drawn_by_run_and_iteration(small):
    task = {"NUM_OBSERVATIONS": 21, "NUM_ACTIONS": 12}
    five = dataclasses.replace(small, seed=5)
    expected = draw_policy(task["NUM_OBSERVATIONS"], task["NUM_ACTIONS"], small.train, named('[5,"policy",2]'))
    found = random_policy(five, 2)
    assert found.arrays.keys() == expected.arrays.keys()
    assert all(np.array_equal(found.arrays[name], expected.arrays[name]) for name in found.arrays)
    assert any(not np.array_equal(found.arrays[n], random_policy(five, 3).arrays[n]) for n in found.arrays)


# One candidate.


@pytest.fixture
def made(monkeypatch):
    """What `train_candidate` makes of a job, and no training."""
    seen = {}

    class Trained:
        def __init__(self, task, reward, train, seed):
            seen.update(task=task, reward=reward, train=train, seed=seed)

        def load(self, path):
            seen["start"] = path

        def train(self, until, progress, before):
            seen["until"] = until
            return []

        def save(self, path):
            seen["finish"] = path

    real = candidate_module.make_task

    def make_task(name, num_envs, seed, device):
        seen.update(name=name, num_envs=num_envs, task_seed=seed)
        return real(name, num_envs, seed, device=device)

    monkeypatch.setattr(candidate_module, "Trainer", Trained)
    monkeypatch.setattr(candidate_module, "make_task", make_task)
    return seen


def job(tmp_path, **changes):
    whole = Job("c", program(REWARD), program(MAPPING), 0.7, tmp_path / "start", tmp_path / "finish", 9, 5)
    return dataclasses.replace(whole, **changes)


def test_a_job_is_trained_with_its_own_start_length_and_draws(small, made, tmp_path):
    assert train_candidate(job(tmp_path), small, lambda *_: None) == Outcome([], "")
    assert (made["name"], made["num_envs"], made["task_seed"]) == ("Quadcopter", 8, named('[5,"task"]'))
    assert (made["seed"], made["until"], made["train"]) == (5, 9, small.train)
    assert (made["start"], made["finish"]) == (tmp_path / "start", tmp_path / "finish")


@pytest.mark.parametrize(
    ("error", "epoch", "failure", "outside"),
    [
        (CandidateFailed("its reward broke"), 3, "its reward broke, in epoch 3", False),
        (CodeError("run", "odd"), 0, "its function cannot be run: odd, before its first epoch", False),
        (ValueError("odd"), 1, "its training raised ValueError: odd, in epoch 1", False),
        (SystemExit("bye"), 4, "its training raised SystemExit: bye, in epoch 4", False),
        (MemoryError("full"), 2, "its training may take no more memory: MemoryError: full, in epoch 2", True),
    ],
)
def test_a_failure_says_in_which_epoch_and_whether_its_cause_may_lie_outside(
    small, made, tmp_path, monkeypatch, error, epoch, failure, outside
):
    def train(self, until, progress, before):
        if epoch:
            before(epoch)
        raise error

    monkeypatch.setattr(candidate_module.Trainer, "train", train)
    assert train_candidate(job(tmp_path), small, lambda *_: None) == Outcome([], failure, outside)
    assert "finish" not in made


def test_a_fault_of_the_program_is_no_failed_candidate(small, made, tmp_path, monkeypatch):
    def load(self, path):
        raise CheckpointError("it is damaged")

    monkeypatch.setattr(candidate_module.Trainer, "load", load)
    with pytest.raises(CheckpointError, match="it is damaged"):
        train_candidate(job(tmp_path), small, lambda *_: None)


@pytest.mark.parametrize(("goal", "method"), [("human", "human_reward"), ("sparse", "sparse_reward")])
def test_a_candidate_is_paid_the_goal_that_its_parameters_name(small, made, tmp_path, goal, method):
    chosen = changed(small, candidate={"goal": goal, "bonus": "none", "scale": 2.0}, train={"scaling": "none"})
    train_candidate(job(tmp_path), chosen, lambda *_: None)
    task = made["task"]
    expected = getattr(task, method)()
    assert not torch.allclose(task.human_reward(), task.sparse_reward(), atol=0.1)
    # beta 0.7 of 2, no bonus: 1.3 times the goal
    torch.testing.assert_close(paid(made["reward"], task).total[0], 1.3 * expected)


def unscaled(small, **exploration):
    return changed(small, candidate={"scale": 1.7}, exploration=exploration, train={"scaling": "none"})


def test_a_generated_goal_and_a_mappings_bonus_are_weighed_by_beta_of_the_scale(small, made, tmp_path):
    train_candidate(job(tmp_path), unscaled(small, form="literal", lambda_=0.25, cells=100), lambda *_: None)
    payment = paid(made["reward"], made["task"])
    goal, bonus = payment.series["goal"], payment.series["bonus"]
    assert payment.series["reward"] == pytest.approx(0.7 * bonus + 1.0 * goal)
    assert [name for name in payment.series if name.startswith("progress/")] == ["progress/distance", "progress/speed"]


def lone(small, made, tmp_path, **exploration):
    """What a visit pays in a cell of its own beside one with 3 visits, and a second visit of it."""
    train_candidate(job(tmp_path), unscaled(small, **exploration), lambda *_: None)
    book = made["reward"]._bonus.ledger
    cells = torch.tensor([[3, 3, 3, 7, -1, -1, -1, -1]])
    amount = book.pay(cells, no_ends(1, 8)).amount[0]
    assert amount[4:].tolist() == [0.0] * 4
    again = book.pay(torch.tensor([[7, *[-1] * 7]]), no_ends(1, 8)).amount[0, 0]
    return amount[3].item(), amount[0].item(), again.item()


def test_the_forms_of_a_bonus_are_lambda_times_what_they_say(small, made, tmp_path):
    # 1 / sqrt(1), 1 / sqrt(3), 1 / sqrt(2)
    expected = [0.25, 0.25 / 3**0.5, 0.25 / 2**0.5]
    assert lone(small, made, tmp_path, form="literal", lambda_=0.25) == pytest.approx(expected)
    # means 4 visits / 2 cells and 5 / 2; gamma 0.99: 0.01 x sqrt(2 / 1), sqrt(2 / 3), sqrt(2.5 / 2)
    expected = [0.0025 * 2**0.5, 0.0025 * (2 / 3) ** 0.5, 0.0025 * 1.25**0.5]
    assert lone(small, made, tmp_path, form="relative", lambda_=0.25) == pytest.approx(expected)
    # gamma 0.4: 0.6 takes the place of 0.01
    shorter = changed(small, train={"gamma": 0.4})
    expected = [60.0 * amount for amount in expected]
    assert lone(shorter, made, tmp_path, form="relative", lambda_=0.25) == pytest.approx(expected)
    # the returns of the 8 environments' first step are the rarities themselves
    first = torch.tensor([3**-0.5] * 3 + [1.0] + [0.0] * 4, dtype=torch.float64)
    own, other, _ = lone(small, made, tmp_path, form="calibrated", lambda_=0.25)
    deviation = first.std(unbiased=False).item()
    assert (own, other) == (pytest.approx(0.25 / deviation), pytest.approx(0.25 / deviation / 3**0.5))


def test_functions_are_run_portably_where_the_numbers_are_to_be_portable(small, made, tmp_path, monkeypatch):
    asked = []
    real = candidate_module.Function

    def function(program, kind, portable):
        asked.append((kind, portable))
        return real(program, kind, portable)

    monkeypatch.setattr(candidate_module, "Function", function)
    for numerics in ("portable", "fast"):
        train_candidate(job(tmp_path), dataclasses.replace(small, numerics=numerics), lambda *_: None)
    assert sorted(asked[:2]) == [("mapping", True), ("reward", True)]
    assert sorted(asked[2:]) == [("mapping", False), ("reward", False)]


def test_counts_live_as_the_parameters_say(small, made, tmp_path):
    def book(**exploration):
        train_candidate(job(tmp_path), changed(small, exploration=exploration), lambda *_: None)
        return made["reward"]._bonus.ledger

    found = book(lifetime="candidate", cells=100)
    assert (found._life_epochs, found._counts.table.shape) == (0, (100,))
    # a rung of `small` has 2 epochs
    found = book(lifetime="rung", cells=100)
    assert [found.begins_anew(epoch) for epoch in range(1, 6)] == [True, False, True, False, True]
    found = book(lifetime="episode", cells=100)
    assert (found._life_epochs, found._counts.table.shape) == (0, (8, 100))
    # and of a run that is one iteration long, as many times more as there are iterations
    longer = changed(small, exploration={"lifetime": "rung"}, train={"length": "run"})
    train_candidate(job(tmp_path), longer, lambda *_: None)
    assert made["reward"]._bonus.ledger._life_epochs == 2 * len(small.iterations)


def test_streams_are_scaled_as_the_parameters_say(small, made, tmp_path):
    train_candidate(job(tmp_path), small, lambda *_: None)
    scales = (made["reward"]._goal_size, made["reward"]._total_size)
    assert [type(scale) for scale in scales] == [ReturnScale] * 2
    assert scales[0] is not scales[1]
    assert [scale._gamma for scale in scales] == [small.train.gamma] * 2
    train_candidate(job(tmp_path), unscaled(small), lambda *_: None)
    assert type(made["reward"]._goal_size) is type(made["reward"]._total_size) is NoScale


@pytest.mark.parametrize(("discretiser", "cells", "bins"), [("grid", 100, 10), ("sum", 99, 50)])
def test_a_mapping_is_counted_as_its_discretiser_says_with_all_cells(small, made, tmp_path, discretiser, cells, bins):
    chosen = changed(small, exploration={"discretiser": discretiser, "cells": 100})
    train_candidate(job(tmp_path), chosen, lambda *_: None)
    bonus = made["reward"]._bonus
    # two variables: 10 x 10 = 100; 2 (50 - 1) + 1 = 99
    assert (bonus.space.cells, bonus.space.bins, len(bonus.ledger._counts.table)) == (cells, bins, cells)
    # both fall as the task is done
    assert bonus.space._signs == [-1.0, -1.0]


def test_a_simhash_follows_from_the_jobs_seed(small, made, tmp_path):
    chosen = changed(small, candidate={"bonus": "simhash"}, exploration={"simhash_bits": 3, "cells": 100})
    projections = {}
    for seed in (5, 6):
        train_candidate(job(tmp_path, seed=seed), chosen, lambda *_: None)
        projections[seed] = made["reward"]._bonus.hashes.projection
    assert torch.equal(projections[5], SimHash(21, 3, named('[5,"simhash"]')).projection)
    assert not torch.equal(projections[5], projections[6])
    assert made["reward"]._bonus.ledger._counts.table.shape == (8,)


def test_where_there_is_no_bonus_the_mapping_is_not_asked(small, made, tmp_path):
    chosen = changed(small, candidate={"bonus": "none"})
    train_candidate(job(tmp_path, mapping_program=""), chosen, lambda *_: None)
    assert paid(made["reward"], made["task"]).series["bonus"] == 0.0


# Rungs: who is trained, from what, with which draws.


def row(name, slot, **changes):
    values = {
        "iteration": 3, "slot": slot, "candidate_id": name, "origin": "new", "reward_source": f"reward {name}",
        "mapping_source": f"mapping {name}", "reward_program": f"reward list {name}",
        "mapping_program": f"mapping list {name}", "beta": 0.7, "alpha": 0.3, "policy": "fused",
    }  # fmt: skip
    return row_of(tables.CANDIDATES, **{**values, **changes})


def weights(path, value):
    write_checkpoint(path, policy_checkpoint({"actor.w": np.full((1,), value, np.float32)}))


class Bar:
    """Takes the place of the bar on the terminal, and remembers what it was to show."""

    shown: ClassVar = []

    def __init__(self, label, candidates, epochs, steps_per_epoch):
        Bar.shown.append((label, candidates, epochs, steps_per_epoch))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def tell(self, event):
        pass


class Pretended:
    """Trains nobody: writes 10 + beta as the policy, fitness = epochs, and two other series; a job of the name `bad` fails."""

    def __init__(self):
        self.jobs = []

    def __call__(self, jobs, params, on_report):
        self.jobs.append(list(jobs))
        outcomes = []
        for entry in jobs:
            if entry.name == "bad":
                outcomes.append(Outcome([], "its reward was not finite"))
                continue
            weights(entry.finish, 10.0 + entry.beta)
            series = {"bonus": 99.0, "fitness": float(entry.until), "goal": -1.0}
            outcomes.append(Outcome([(entry.until, name, value) for name, value in series.items()], ""))
        return outcomes


@pytest.fixture
def pretended(monkeypatch):
    train = Pretended()
    for module in (rung_module, evaluation_module, probing_module):
        monkeypatch.setattr(module, "train_pool", train)
    monkeypatch.setattr(rung_module, "RungBar", Bar)
    monkeypatch.setattr(Bar, "shown", [])
    return train


def test_candidates_of_an_iteration_share_their_draws_and_iterations_and_runs_do_not(small, tmp_path):
    five = dataclasses.replace(small, seed=5)
    seeds = {
        (name, n): job_for(row(name, slot, iteration=n), tmp_path, 4, five, tmp_path).seed
        for slot, (name, n) in enumerate([("a", 3), ("b", 3), ("a", 4)])
    }
    assert seeds == {("a", 3): named('[5,"training",3]'), ("b", 3): named('[5,"training",3]'), ("a", 4): named('[5,"training",4]')}  # fmt: skip
    assert job_for(row("a", 0), tmp_path, 4, small, tmp_path).seed == seed_for(small.seed, "training", 3)
    own = {draw: job_for(row("a", 0, iteration=3, draw=draw), tmp_path, 4, five, tmp_path).seed for draw in (1, 2)}
    assert own == {1: named('[5,"training",3,"draw",1]'), 2: named('[5,"training",3,"draw",2]')}


def test_a_job_is_what_the_candidates_row_says(small, tmp_path):
    found = job_for(row("a", 1), tmp_path / "start", 4, small, tmp_path)
    assert (found.name, found.reward_program, found.mapping_program) == ("a", "reward list a", "mapping list a")
    assert found.beta == 0.7
    assert (found.start, found.finish, found.until) == (tmp_path / "start", policy_file(tmp_path, "a"), 4)


def test_a_rung_trains_the_younger_ones_that_did_not_fail_and_nobody_else(small, pretended, tmp_path):
    rows = [
        row("fresh", 0, beta=0.5),
        row("half", 1, policy="half", epochs=2, beta=0.25),
        row("done", 2, policy="done", epochs=4),
        row("failed", 3, failure="it raised"),
        row("bad", 4),
        row("older", 5, policy="done", epochs=5),
    ]
    stems = {"fused": 1.0, "half": 2.0, "done": 3.0}
    for stem, value in stems.items():
        weights(tmp_path / stem, value)
    before = [{"iteration": 3, "rung": "1", "candidate_id": "half", "series": "fitness", "epoch": 2, "value": 7.0}]
    write_pool(tmp_path / "in", rows, before, {stem: tmp_path / stem for stem in stems})
    train_rung(read_pool(tmp_path / "in"), small, 3, "2", 4, tmp_path / "out")
    [jobs] = pretended.jobs
    assert [(entry.name, entry.start.stem, entry.until) for entry in jobs] == [
        # the longest first
        ("fresh", "fused", 4),
        ("bad", "fused", 4),
        ("half", "half", 4),
    ]
    # 4 + 4 + 2 epochs of 8 environments' 8 steps
    assert Bar.shown == [("iteration 3 rung 2", 3, 10, 64)]
    after = read_pool(tmp_path / "out")
    assert [(r["candidate_id"], r["epochs"], r["policy"], r["failure"]) for r in after.candidates] == [
        ("fresh", 4, "fresh", ""),
        ("half", 4, "half", ""),
        ("done", 4, "done", ""),
        ("failed", 0, "fused", "it raised"),
        ("bad", 0, "fused", "its reward was not finite"),
        ("older", 5, "done", ""),
    ]
    held = {r["candidate_id"]: read_checkpoint(after.policy(r)).arrays["actor.w"].item() for r in after.candidates}
    assert held == {"fresh": 10.5, "half": 10.25, "done": 3.0, "failed": 1.0, "bad": 1.0, "older": 3.0}
    fitness = [(r["candidate_id"], r["rung"], r["epoch"], r["value"]) for r in after.curves if r["series"] == "fitness"]
    assert fitness == [("fresh", "2", 4, 4.0), ("half", "1", 2, 7.0), ("half", "2", 4, 4.0)]


# The evaluation of a lineage.


def test_a_lineage_is_trained_anew_link_by_link_with_draws_of_every_further_seed(
    small, pretended, tmp_path, monkeypatch
):
    five = changed(dataclasses.replace(small, seed=5), evaluate={"seeds": 2})
    lineage = [row("first", 0, iteration=1, beta=0.5), row("second", 1, iteration=4, alpha=0.25, beta=0.9)]
    first = {number: random_policy(dataclasses.replace(five, seed=named(f'[5,"evaluate",{number}]')), 1) for number in (1, 2)}  # fmt: skip

    def train(jobs, params, on_report):
        outcomes = pretended(jobs, params, on_report)
        for entry in jobs:
            # a policy with the task's own arrays, all of them 4
            like = next(iter(first.values())).arrays
            content = {name: np.full_like(array, 4) for name, array in like.items()}
            write_checkpoint(entry.finish, policy_checkpoint(content))
        return outcomes

    monkeypatch.setattr(evaluation_module, "train_pool", train)
    rows, seeds = evaluate(lineage, 6, five, tmp_path)
    assert seeds == [{"seed": number, "links": 2, "failure": ""} for number in (1, 2)]
    assert [(r["iteration"], r["candidate_id"], r["seed"], r["epoch"], r["fitness"]) for r in rows] == [
        (1, "first", 1, 6, 6.0),
        (1, "first", 2, 6, 6.0),
        (4, "second", 1, 6, 6.0),
        (4, "second", 2, 6, 6.0),
    ]
    # two seeds of 6 epochs in each link
    assert [entry[:3] for entry in Bar.shown] == [
        ("evaluation, iteration 1", 2, 12),
        ("evaluation, iteration 4", 2, 12),
    ]
    # the plan knows both by name: else their bars would have no stage
    write_plan(tmp_path / "plan.json", five)
    assert {entry[0] for entry in Bar.shown} <= json.loads((tmp_path / "plan.json").read_text())["bars"].keys()
    links = pretended.jobs
    for number in (1, 2):
        run_seed = named(f'[5,"evaluate",{number}]')
        assert [jobs[number - 1].name for jobs in links] == [
            f"first seed {number}",
            f"second seed {number}",
        ]
        assert links[0][number - 1].seed == named(f'[{run_seed},"training",1]')
        assert links[1][number - 1].seed == named(f'[{run_seed},"training",4]')
        start = read_checkpoint(links[0][number - 1].start).arrays
        assert all(np.array_equal(start[name], first[number].arrays[name]) for name in start)
        # the second link: a quarter of 4, three quarters of its own theta_random
        random = random_policy(dataclasses.replace(five, seed=run_seed), 4).arrays
        fused = read_checkpoint(links[1][number - 1].start).arrays
        for name, array in random.items():
            expected = 4.0 if ".obs_normalizer." in name else 1.0 + 0.75 * array
            np.testing.assert_allclose(fused[name], np.broadcast_to(expected, array.shape), atol=1e-6)


def test_every_link_of_a_long_lineage_goes_on_from_the_one_before(small, pretended, tmp_path, monkeypatch):
    lineage = [row(str(place), place, iteration=place + 1, alpha=0.5) for place in range(5)]
    like = random_policy(small, 1).arrays

    def train(jobs, params, on_report):
        outcomes = pretended(jobs, params, on_report)
        for entry in jobs:
            # all numbers of a policy say how many links it comes after
            content = {name: np.full_like(array, len(pretended.jobs)) for name, array in like.items()}
            write_checkpoint(entry.finish, policy_checkpoint(content))
        return outcomes

    monkeypatch.setattr(evaluation_module, "train_pool", train)
    _, seeds = evaluate(lineage, 6, changed(small, evaluate={"seeds": 3}), tmp_path)
    assert [(entry["seed"], entry["links"]) for entry in seeds] == [(1, 5), (2, 5), (3, 5)]
    # a fusion keeps what the better policy has seen of the observations
    seen = next(name for name in like if "actor.obs_normalizer" in name)
    starts = [[read_checkpoint(entry.start).arrays[seen].max() for entry in jobs] for jobs in pretended.jobs[1:]]
    assert starts == [[1, 1, 1], [2, 2, 2], [3, 3, 3], [4, 4, 4]]


def test_a_seed_whose_training_fails_ends_there(small, pretended, tmp_path, monkeypatch):
    lineage = [row("first", 0, iteration=1), row("second", 1, iteration=2)]
    like = random_policy(small, 1)

    def train(jobs, params, on_report):
        outcomes = pretended(jobs, params, on_report)
        for entry in jobs:
            write_checkpoint(entry.finish, like)
        # the first of the two seeds fails in the first link
        return [Outcome([], "late"), outcomes[1]] if len(jobs) == 2 else outcomes

    monkeypatch.setattr(evaluation_module, "train_pool", train)
    rows, seeds = evaluate(lineage, 6, changed(small, evaluate={"seeds": 2}), tmp_path)
    assert seeds == [{"seed": 1, "links": 0, "failure": "late"}, {"seed": 2, "links": 2, "failure": ""}]
    assert [(r["iteration"], r["seed"]) for r in rows] == [(1, 2), (2, 2)]
    assert [len(jobs) for jobs in pretended.jobs] == [2, 1]


def test_a_seed_that_fails_later_says_after_how_many_links_and_a_failed_evaluation_has_no_rows_of_it(
    small, pretended, tmp_path, monkeypatch
):
    lineage = [row("first", 0, iteration=1), row("second", 1, iteration=2), row("third", 2, iteration=3)]
    like = random_policy(small, 1)

    def train(jobs, params, on_report):
        outcomes = pretended(jobs, params, on_report)
        for entry in jobs:
            write_checkpoint(entry.finish, like)
        # all fail in the second link, each with words of its own
        return [Outcome([], entry.name) for entry in jobs] if len(pretended.jobs) == 2 else outcomes

    monkeypatch.setattr(evaluation_module, "train_pool", train)
    rows, seeds = evaluate(lineage, 6, changed(small, evaluate={"seeds": 2}), tmp_path)
    assert [(r["iteration"], r["seed"]) for r in rows] == [(1, 1), (1, 2)]
    assert [(r["seed"], r["links"]) for r in seeds] == [(1, 1), (2, 1)]
    assert [r["failure"] for r in seeds] == [entry.name for entry in pretended.jobs[1]]
    # nobody is left for the third link
    assert [len(jobs) for jobs in pretended.jobs] == [2, 2, 0]


# Whole episodes of the trained policy.


class Played(Task):
    """Three environments: episodes of 2, 5 and 3 steps, and then of 1 step each, all at once.

    The first one's end by failure, the second one's by the time limit, the third one's by both in one step. The sparse reward is 11, 20 and 30 times the step.
    """

    LENGTHS: ClassVar = [2, 5, 3]

    def __init__(self):
        super().__init__()
        self.ages, self.seen = torch.zeros(3, dtype=torch.int64), []
        self.limits = torch.tensor(self.LENGTHS)

    def observations(self):
        return torch.full((3, 1), float(self.steps))

    def step(self, actions):
        self.seen.append(actions.flatten().tolist())
        self.steps += 1
        self.ages += 1

    def sparse_reward(self):
        return torch.tensor([11.0, 20.0, 30.0]) * self.steps

    def episode_outcome(self, mean_sparse_reward):
        return mean_sparse_reward

    def terminated(self):
        return (self.ages >= self.limits) & torch.tensor([True, False, True])

    def timed_out(self):
        return (self.ages >= self.limits) & torch.tensor([False, True, True])

    def reset(self, mask):
        self.ages[mask], self.limits[mask] = 0, 1


def test_every_environment_plays_one_whole_episode_and_what_it_does_afterwards_counts_nowhere():
    task = Played()
    # 11 (1 + 2) / 2 = 16.5; 20 (1 + 2 + 3 + 4 + 5) / 5 = 60; 30 (1 + 2 + 3) / 3 = 60
    assert play_episodes(task, lambda observations: observations + 0.5) == [
        Episode(2, 16.5),
        Episode(5, 60.0),
        Episode(3, 60.0),
    ]
    # actions come from the observations, until the longest has ended
    assert task.seen == [[0.5] * 3, [1.5] * 3, [2.5] * 3, [3.5] * 3, [4.5] * 3]


def test_an_outcome_of_its_own_is_read_when_its_episode_ends():
    task = Played()
    task.episode_outcome = lambda mean: torch.tensor([1.0, 2.0, 3.0]) * task.steps
    # after 2, 5 and 3 steps
    assert [episode.outcome for episode in play_episodes(task, lambda observations: observations)] == [2.0, 10.0, 9.0]


# The search of alpha.


def test_a_probe_scores_by_its_highest_fitness():
    outcome = Outcome(
        [(1, "fitness", -3.0), (2, "fitness", -1.0), (3, "fitness", -2.0), (3, "goal", 9.0), (3, "bonus", 8.0)], ""
    )
    assert Probe(row("a", 0), outcome).score == -1.0


@pytest.fixture
def fusible(tmp_path):
    for stem, value in (("best", 1.0), ("random", 0.0)):
        weights(policy_file(tmp_path, stem), value)
    return Pool(tmp_path, [row("a", 0, iteration=2), row("b", 1, iteration=2)], [])


def test_a_probe_that_failed_counts_as_the_worst_and_not_as_the_best(params, fusible, tmp_path):
    """Of 0, 0.5 and 1 the first fails and the others score 2 and 3: the search goes on above a half."""
    roska = changed(params, probe={"trainings": 4, "initial": 3, "least_epochs": 1})

    def train(rows, starts, until):
        fitness = {0.0: None, 0.5: 2.0, 1.0: 3.0}
        found = [fitness.get(entry["alpha"], 2.5) for entry in rows]
        return [Outcome([], "late") if value is None else Outcome([(1, "fitness", value)], "") for value in found]

    probes = search_alphas(fusible, roska, 6, tmp_path / "out", train)
    asked = {probe.row["parent_id"]: probe.alpha for probe in probes if probe.alpha not in (0.0, 0.5, 1.0)}
    assert set(asked) == {"a", "b"}
    assert all(alpha > 0.5 for alpha in asked.values())
    assert {probe.row["parent_id"]: probe.alpha for probe in probes if probe.chosen} == {"a": 1.0, "b": 1.0}


def test_only_the_chosen_probes_go_on_to_the_rungs_end_from_their_own_checkpoints(small, pretended, fusible, tmp_path):
    """2 candidates, 3 probes each to epoch round(0.4 x 5) = 2; then one of each to epoch 5."""
    roska = changed(
        small, train={"rung_epochs": 5}, probe={"trainings": 3, "initial": 3, "share": 0.4, "least_epochs": 2}
    )
    search_rung(fusible, roska, 2, "1", 5, tmp_path / "out")
    # 6 probes of 2 epochs, and 3 epochs more for the two that go on
    assert [entry[:3] for entry in Bar.shown] == [("iteration 2 rung 1", 2, 18)]
    probed, going = pretended.jobs
    assert [entry.until for entry in probed] == [2] * 6
    # theta_best is 1 and theta_random 0, so theta_f is alpha
    assert [read_checkpoint(entry.start).arrays["actor.w"].item() for entry in probed] == [0.0, 0.5, 1.0] * 2
    assert [entry.until for entry in going] == [5] * 2
    # equal scores: the largest alpha goes on
    assert [entry.start.stem for entry in going] == [entry.name for entry in going]
    after = read_pool(tmp_path / "out").candidates
    assert [(r["alpha"], r["epochs"]) for r in after] == [(1.0, 5), (1.0, 5), (0.0, 2), (0.5, 2), (0.0, 2), (0.5, 2)]
    assert len({entry.seed for entry in probed + going}) == 1


def test_probes_that_another_one_beat_are_numbered_behind_the_last_slot(small, pretended, fusible, tmp_path):
    """2 candidates, 2 probes each that are spread and 2 that follow one by one, to epoch 2; then one of each to epoch 5."""
    pool = Pool(fusible.folder, [row("a", 4, iteration=2), row("b", 2, iteration=2)], [])
    roska = changed(
        small, train={"rung_epochs": 5}, probe={"trainings": 4, "initial": 2, "share": 0.4, "least_epochs": 2}
    )
    search_rung(pool, roska, 2, "1", 5, tmp_path / "out")
    assert [len(jobs) for jobs in pretended.jobs] == [4, 2, 2, 2]
    # 2 x (4 x 2 + 3)
    assert [entry[:3] for entry in Bar.shown] == [("iteration 2 rung 1", 2, 22)]
    after = read_pool(tmp_path / "out").candidates
    assert {r["parent_id"]: r["slot"] for r in after if r["epochs"] == 5} == {"a": 4, "b": 2}
    assert sorted(r["slot"] for r in after if r["epochs"] == 2) == [5, 6, 7, 8, 9, 10]
