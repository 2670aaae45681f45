"""What a training means: the total reward, PPO's construction, GAE by pencil, and who is trained with which draws."""

import dataclasses
from typing import ClassVar

import numpy as np
import pytest
import torch

from meaning_cases import changed, named, row_of
from porse import tables
from porse.checkpoint import policy_checkpoint, read_checkpoint, write_checkpoint
from porse.exploration import SimHashCounts, SumCounts, VisitCounts
from porse.identity import seed_for
from porse.pool import Pool, policy_file, read_pool, write_pool
from porse.training import candidate as candidate_module
from porse.training import evaluation as evaluation_module
from porse.training import probing as probing_module
from porse.training import rung as rung_module
from porse.training.bonus import MappingBonus, NoBonus, SimHashBonus
from porse.training.candidate import train_candidate
from porse.training.evaluation import evaluate
from porse.training.goal import generated, human, sparse
from porse.training.job import Job, Outcome
from porse.training.ppo import build_ppo
from porse.training.probing import Probe, search_alphas, search_rung
from porse.training.reward import CandidateFailed, EpochMeans, Reward
from porse.training.rung import job_for, train_rung
from porse.training.start import random_policy
from porse.training.trainer import Trainer, draw_policy
from porse.training.vecenv import TaskEnv, observation_groups
from samples import MAPPING, REWARD, program


class Task:
    """Three environments whose states, ends and rewards a pencil knows.

    Observations before each step and after the last; the first environment never ends, the second meets the time limit
    in the second step, the third fails there, at the time limit, too.
    """

    NUM_ACTIONS, NUM_OBSERVATIONS, EPISODE_LENGTH, num_envs = 1, 1, 9, 3
    STATES: ClassVar = [[1.0, 2.0, 2.0], [2.0, 3.0, 3.0], [3.0, 1.0, 1.0], [4.0, 3.0, 3.0]]
    REWARDS: ClassVar = [10.0, 20.0, 40.0]

    def __init__(self):
        self.progress = torch.zeros(3, dtype=torch.int64)
        self.steps, self.resets = 0, []

    def step(self, actions):
        self.steps += 1

    def observations(self):
        return torch.tensor(self.STATES[self.steps % 4]).unsqueeze(1)

    def variables(self):
        return {"num_envs": 3, "obs_buf": self.observations()}

    def _second(self, flags):
        return torch.tensor(flags if self.steps == 2 else [False] * 3)

    def terminated(self):
        return self._second([False, False, True])

    def timed_out(self):
        return self._second([False, True, True])

    def reset(self, mask):
        self.resets.append((self.steps, mask.tolist()))

    def human_reward(self):
        return torch.full((3,), 11.0)

    def sparse_reward(self):
        return torch.full((3,), 0.25)

    def fitness(self):
        return 100.0 + self.steps

    def state(self):
        return {}


def goal_of_task(task, variables):
    return torch.full((3,), task.REWARDS[(task.steps - 1) % 3]), {}


# The total reward.


class Fixed:
    """A bonus of 0.5, 3 and 4, whatever happens."""

    def pay(self, variables):
        return torch.tensor([0.5, 3.0, 4.0]), {"z": torch.tensor([7.0, 8.0, 9.0]), "a": torch.tensor([1.0, 2.0, 3.0])}


def fixed_goal(task, variables):
    components = {"y": torch.tensor([1.0, 2.0, 3.0]), "b": torch.tensor([4.0, 5.0, 6.0])}
    return torch.tensor([10.0, -2.0, 1.0]), components


def test_beta_weighs_the_bonus_and_the_rest_of_the_scale_the_goal():
    payment = Reward(fixed_goal, Fixed(), 0.7, 2.0).pay(Task())
    # 0.7 x 0.5 + 1.3 x 10 = 13.35; 0.7 x 3 - 1.3 x 2 = -0.5; 0.7 x 4 + 1.3 = 4.1
    assert payment.total.tolist() == pytest.approx([13.35, -0.5, 4.1], abs=1e-6)
    # of a scale of 1: 0.35 + 0.3 x 10 = 3.35; 2.1 - 0.6 = 1.5; 2.8 + 0.3 = 3.1
    assert Reward(fixed_goal, Fixed(), 0.7, 1.0).pay(Task()).total.tolist() == pytest.approx([3.35, 1.5, 3.1], abs=1e-6)


def test_what_is_written_down_is_each_stream_before_it_is_weighed():
    series = Reward(fixed_goal, Fixed(), 0.7, 2.0).pay(Task()).series
    assert list(series) == ["goal", "bonus", "component/b", "component/y", "progress/z", "progress/a"]
    assert series["goal"].tolist() == [10.0, -2.0, 1.0]
    assert series["bonus"].tolist() == [0.5, 3.0, 4.0]
    assert series["component/y"].tolist() == [1.0, 2.0, 3.0]
    assert series["progress/z"].tolist() == [7.0, 8.0, 9.0]


def test_goals_are_the_generated_function_the_human_and_the_sparse_reward():
    task = Task()
    assert human(task, {})[0].tolist() == [11.0] * 3
    assert sparse(task, {})[0].tolist() == [0.25] * 3
    goal = generated(lambda variables: (torch.full((variables["num_envs"],), 6.0), {"c": torch.ones(3)}))
    total, components = goal(task, task.variables())
    assert (total.tolist(), list(components)) == ([6.0] * 3, ["c"])


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
    with pytest.raises(CandidateFailed, match=r"not finite in 33\.3% of the environments \(components: late\)"):
        Reward(goal, NoBonus(), 0.7, 2.0).pay(Task())


# The bonus.


def test_a_mapping_bonus_counts_the_outputs_in_their_order_and_shows_them_by_name():
    def mapping(variables):
        return [torch.tensor([0.0, 3.0]), torch.tensor([0.0, -30.0])], [True, False], ["far", "deep"]

    visits = VisitCounts([True, False], 16, 0.4)
    bonus, progress = MappingBonus(mapping, visits).pay({})
    assert bonus.tolist() == pytest.approx([0.4, 0.4])
    assert {name: value.tolist() for name, value in progress.items()} == {"far": [0.0, 3.0], "deep": [0.0, -30.0]}
    # 4 bins of 1 for the first, 4 of 8 for the second, turned: cells (0, 0) and (3, 3)
    assert visits.counts.nonzero().flatten().tolist() == [0, 15]


def test_a_simhash_bonus_counts_the_observation_and_remembers_its_counts():
    counts = SimHashCounts(1, 3, 0.4, 0)
    bonus = SimHashBonus(counts)
    paid, progress = bonus.pay({"obs_buf": torch.tensor([[1.0], [1.0], [-1.0]]), "root": torch.zeros(3, 1)})
    assert paid.tolist() == pytest.approx([0.4 / 2**0.5, 0.4 / 2**0.5, 0.4])
    assert progress == {}
    other = SimHashBonus(SimHashCounts(1, 3, 0.4, 0))
    other.load_state(bonus.state())
    assert other.pay({"obs_buf": torch.tensor([[1.0]])})[0].tolist() == pytest.approx([0.4 / 3**0.5])


def test_a_rewards_state_is_its_bonuss():
    counts = SimHashCounts(1, 3, 0.4, 0)
    reward = Reward(fixed_goal, SimHashBonus(counts), 0.7, 2.0)
    counts.bonus(torch.tensor([[1.0], [1.0]]))
    assert reward.state()["counts"].tolist() == counts.counts.tolist()
    other = SimHashCounts(1, 3, 0.4, 0)
    Reward(fixed_goal, SimHashBonus(other), 0.7, 2.0).load_state(reward.state())
    assert other.counts.tolist() == counts.counts.tolist()


def test_no_bonus_is_zero_for_every_environment():
    bonus, progress = NoBonus().pay({"num_envs": 3})
    assert (bonus.tolist(), progress, NoBonus().state()) == ([0.0, 0.0, 0.0], {}, {})


# PPO.


@pytest.fixture(scope="module")
def pencil(params):
    """Values that no two parameters share."""
    train = {
        "num_envs": 3, "steps_per_epoch": 3, "hidden": (1,), "activation": "relu", "normalise_observations": False,
        "gamma": 0.5, "gae_lambda": 0.8, "reward_scale": 0.1, "passes": 2, "minibatches": 3, "clip": 0.3,
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
    """Gamma 1/2, lambda 0.8, so gamma lambda = 0.4; V(s) = s; rewards 10, 20, 40 times 0.1: r = 1, 2, 4.

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
    env = TaskEnv(task, Reward(goal_of_task, NoBonus(), 0.0, 1.0), pencil.reward_scale)
    torch.manual_seed(0)
    observations = env.get_observations()
    ppo = build_ppo(observations, 1, pencil)
    value_is_the_observation(ppo)
    with torch.inference_mode():
        for _ in range(3):
            actions = ppo.act(observations)
            observations, rewards, ends, extras = env.step(actions)
            ppo.process_env_step(observations, rewards, ends, extras)
        ppo.compute_returns(observations)
    returns = ppo.storage.returns.squeeze(-1)
    assert returns[0].tolist() == pytest.approx([3.08, 2.7, 2.1], abs=1e-6)
    assert returns[1].tolist() == pytest.approx([4.7, 3.5, 2.0], abs=1e-6)
    assert returns[2].tolist() == pytest.approx([6.0, 5.5, 5.5], abs=1e-6)
    # Advantages are the nine numbers above, less their mean, over their deviation.
    raw = torch.tensor([[2.08, 0.7, 0.1], [2.7, 0.5, -1.0], [3.0, 4.5, 4.5]])
    torch.testing.assert_close(ppo.storage.advantages.squeeze(-1), (raw - raw.mean()) / raw.std(), atol=1e-5, rtol=0.0)


def test_an_epochs_series_are_unscaled_means_and_resets_follow_ends(pencil):
    task = Task()
    env = TaskEnv(task, Reward(goal_of_task, NoBonus(), 0.0, 2.0), 0.1)
    for _ in range(3):
        env.step(torch.zeros(3, 1))
    # the third environment of three fails in one of three steps; total 2 (10 + 20 + 40) / 3
    means = env.means.take()
    assert means["terminated"] == pytest.approx(1 / 9)
    assert means["goal"] == pytest.approx(70 / 3)
    assert means["reward"] == pytest.approx(140 / 3)
    assert task.resets == [(2, [False, True, True])]
    assert (env.num_envs, env.num_actions, env.max_episode_length) == (3, 1, 9)
    assert env.episode_length_buf is task.progress


def trainer(pencil, seed, task=None):
    return Trainer(task or Task(), Reward(goal_of_task, NoBonus(), 0.0, 1.0), pencil, seed)


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


def test_an_epoch_is_so_many_steps_and_its_fitness_that_of_its_last(pencil):
    task, told, begun = Task(), [], []
    rows = trainer(pencil, 5, task).train(2, lambda epoch, fitness: told.append((epoch, fitness)), begun.append)
    assert task.steps == 6
    assert begun == [1, 2]
    assert told == [(1, 103.0), (2, 106.0)]
    assert [(row.epoch, row.value) for row in rows if row.series == "fitness"] == told
    assert [row.epoch for row in rows if row.series == "goal"] == [1, 2]


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

    def make_task(name, num_envs, seed):
        seen.update(name=name, num_envs=num_envs, task_seed=seed)
        return real(name, num_envs, seed)

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


@pytest.mark.parametrize(("goal", "method"), [("human", "human_reward"), ("sparse", "sparse_reward")])
def test_a_candidate_is_paid_the_goal_that_its_parameters_name(small, made, tmp_path, goal, method):
    chosen = changed(small, candidate={"goal": goal, "bonus": "none", "scale": 2.0})
    train_candidate(job(tmp_path), chosen, lambda *_: None)
    task = made["task"]
    expected = getattr(task, method)()
    assert not torch.allclose(task.human_reward(), task.sparse_reward(), atol=0.1)
    # beta 0.7 of 2, no bonus: 1.3 times the goal
    torch.testing.assert_close(made["reward"].pay(task).total, 1.3 * expected)


def test_a_generated_goal_and_a_mappings_bonus_are_weighed_by_beta_of_the_scale(small, made, tmp_path):
    chosen = changed(small, candidate={"scale": 1.7}, exploration={"lambda_": 0.25, "cells": 100})
    train_candidate(job(tmp_path), chosen, lambda *_: None)
    payment = made["reward"].pay(made["task"])
    goal, bonus = payment.series["goal"], payment.series["bonus"]
    torch.testing.assert_close(payment.total, 0.7 * bonus + 1.0 * goal)
    # 8 starts that are far apart: some cell is visited by one alone, and pays lambda
    assert float(bonus.max()) == pytest.approx(0.25)
    assert [name for name in payment.series if name.startswith("progress/")] == ["progress/distance", "progress/speed"]


@pytest.mark.parametrize(("discretiser", "kind", "bins"), [("grid", VisitCounts, 10), ("sum", SumCounts, 50)])
def test_a_mapping_is_counted_as_its_discretiser_says_with_all_cells(small, made, tmp_path, discretiser, kind, bins):
    chosen = changed(small, exploration={"discretiser": discretiser, "cells": 100})
    train_candidate(job(tmp_path), chosen, lambda *_: None)
    counts = made["reward"]._bonus._counts
    assert type(counts) is kind
    # two variables: 10 x 10 = 100; 2 (50 - 1) + 1 = 99
    assert counts.space.bins == bins
    # both fall as the task is done
    assert counts.space.turn(torch.tensor([[1.0, 2.0]])).tolist() == [[-1.0, -2.0]]


def test_a_simhash_follows_from_the_jobs_seed(small, made, tmp_path):
    chosen = changed(
        small, candidate={"bonus": "simhash"}, exploration={"simhash_bits": 3, "lambda_": 0.25, "cells": 100}
    )
    projections = {}
    for seed in (5, 6):
        train_candidate(job(tmp_path, seed=seed), chosen, lambda *_: None)
        projections[seed] = made["reward"]._bonus._counts.projection
    assert torch.equal(projections[5], SimHashCounts(21, 3, 0.25, named('[5,"simhash"]')).projection)
    assert not torch.equal(projections[5], projections[6])
    assert float(made["reward"]._bonus.pay({"obs_buf": torch.ones(1, 21)})[0]) == pytest.approx(0.25)


def test_where_there_is_no_bonus_the_mapping_is_not_asked(small, made, tmp_path):
    chosen = changed(small, candidate={"bonus": "none"})
    train_candidate(job(tmp_path, mapping_program=""), chosen, lambda *_: None)
    assert made["reward"].pay(made["task"]).series["bonus"].tolist() == [0.0] * 8


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


class Pretended:
    """Trains nobody: writes 10 + beta as the policy, and fitness = epochs; a job of the name `bad` fails."""

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
            outcomes.append(Outcome([(entry.until, "fitness", float(entry.until)), (entry.until, "goal", -1.0)], ""))
        return outcomes


@pytest.fixture
def pretended(monkeypatch):
    train = Pretended()
    for module in (rung_module, evaluation_module, probing_module):
        monkeypatch.setattr(module, "train_pool", train)
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
    after = read_pool(tmp_path / "out")
    assert [(r["candidate_id"], r["epochs"], r["policy"], r["failure"]) for r in after.candidates] == [
        ("fresh", 4, "fresh", ""),
        ("half", 4, "half", ""),
        ("done", 4, "done", ""),
        ("failed", 0, "fused", "it raised"),
        ("bad", 0, "fused", "its reward was not finite"),
    ]
    held = {r["candidate_id"]: read_checkpoint(after.policy(r)).arrays["actor.w"].item() for r in after.candidates}
    assert held == {"fresh": 10.5, "half": 10.25, "done": 3.0, "failed": 1.0, "bad": 1.0}
    fitness = [(r["candidate_id"], r["rung"], r["epoch"], r["value"]) for r in after.curves if r["series"] == "fitness"]
    assert fitness == [("fresh", "2", 4, 4.0), ("half", "1", 2, 7.0), ("half", "2", 4, 4.0)]


# The evaluation of a lineage.


def test_a_lineage_is_trained_anew_link_by_link_with_draws_of_every_further_seed(
    small, pretended, tmp_path, monkeypatch
):
    five = changed(dataclasses.replace(small, seed=5), evaluate={"seeds": 2})
    chain = [row("first", 0, iteration=1, beta=0.5), row("second", 1, iteration=4, alpha=0.25, beta=0.9)]
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
    rows = evaluate(chain, 6, five, tmp_path)
    assert [(r["iteration"], r["candidate_id"], r["seed"], r["epoch"], r["fitness"]) for r in rows] == [
        (1, "first", 1, 6, 6.0),
        (1, "first", 2, 6, 6.0),
        (4, "second", 1, 6, 6.0),
        (4, "second", 2, 6, 6.0),
    ]
    links = pretended.jobs
    for number in (1, 2):
        run_seed = named(f'[5,"evaluate",{number}]')
        assert [jobs[number - 1].name for jobs in links] == [
            f"first with seed {run_seed}",
            f"second with seed {run_seed}",
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


def test_a_seed_whose_training_fails_ends_there(small, pretended, tmp_path, monkeypatch):
    chain = [row("first", 0, iteration=1), row("second", 1, iteration=2)]
    like = random_policy(small, 1)

    def train(jobs, params, on_report):
        outcomes = pretended(jobs, params, on_report)
        for entry in jobs:
            write_checkpoint(entry.finish, like)
        # the first of the two seeds fails in the first link
        return [Outcome([], "late"), outcomes[1]] if len(jobs) == 2 else outcomes

    monkeypatch.setattr(evaluation_module, "train_pool", train)
    rows = evaluate(chain, 6, changed(small, evaluate={"seeds": 2}), tmp_path)
    assert [(r["iteration"], r["seed"]) for r in rows] == [(1, 2), (2, 2)]
    assert [len(jobs) for jobs in pretended.jobs] == [2, 1]


# The search of alpha.


def test_a_probe_scores_by_its_highest_fitness():
    outcome = Outcome([(1, "fitness", -3.0), (2, "fitness", -1.0), (3, "fitness", -2.0), (3, "goal", 9.0)], "")
    assert Probe(row("a", 0), outcome).score == -1.0


@pytest.fixture
def fusible(tmp_path):
    for stem, value in (("best", 1.0), ("random", 0.0)):
        weights(policy_file(tmp_path, stem), value)
    return Pool(tmp_path, [row("a", 0, iteration=2), row("b", 1, iteration=2)], [])


def test_a_probe_that_failed_counts_as_the_worst_and_not_as_the_best(params, fusible, tmp_path):
    """Of 0, 0.5 and 1 the first fails and the others score 2 and 3: the search goes on above a half."""
    roska = changed(params, probe={"trainings": 4, "initial": 3})

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
    roska = changed(small, train={"rung_epochs": 5}, probe={"trainings": 3, "initial": 3, "share": 0.4})
    search_rung(fusible, roska, 2, "1", 5, tmp_path / "out")
    probed, going = pretended.jobs
    assert [entry.until for entry in probed] == [2] * 6
    # theta_best is 1 and theta_random 0, so theta_f is alpha
    assert [read_checkpoint(entry.start).arrays["actor.w"].item() for entry in probed] == [0.0, 0.5, 1.0] * 2
    assert [entry.until for entry in going] == [5] * 2
    # equal scores: the smallest alpha goes on
    assert [entry.start.stem for entry in going] == [entry.name for entry in going]
    after = read_pool(tmp_path / "out").candidates
    assert [(r["alpha"], r["epochs"]) for r in after] == [(0.0, 5), (0.0, 5), (0.5, 2), (1.0, 2), (0.5, 2), (1.0, 2)]
    assert len({entry.seed for entry in probed + going}) == 1
