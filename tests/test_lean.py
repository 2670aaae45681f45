"""With PyTorch's products, the lean PPO does what rsl_rl's does, bit for bit, in both numeric profiles."""

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from rsl_rl.algorithms import PPO

from porse import numerics
from porse.config import load_params
from porse.training import gradients
from porse.training.gradients import of_clamped
from porse.training.ppo import build_ppo
from porse.training.products import TorchProducts
from porse.training.snapshot import optimizer_arrays, policy_arrays
from porse.training.vecenv import observation_groups

ROOT = Path(__file__).resolve().parent.parent
ENVS, STEPS, WIDTH, ACTIONS = 6, 7, 5, 3
VARIED = {
    "as it is": {},
    "plain observations": {"normalise_observations": False},
    "entropy": {"entropy": 0.02},
    "relu": {"activation": "relu", "entropy": 0.03, "normalise_observations": False},
    "tanh": {"activation": "tanh", "hidden": (8,)},
    "three hidden layers": {"hidden": (9, 8, 7)},
    "one minibatch": {"passes": 3, "minibatches": 1},
    "two samples left over": {"minibatches": 4},
    "sizes of a training": {"num_envs": 129, "hidden": (64, 64)},
}
"""Minibatches of 14 samples, or of 301: no power of two, so that each division has to be the library's."""


@pytest.fixture(autouse=True)
def _torch_products(monkeypatch):
    """The library's products: those of the profile `portable` have other bits (tests/test_products.py)."""
    monkeypatch.setattr(gradients, "products_on", lambda device: TorchProducts())


def made(changes):
    """A PPO with every parameter of its own."""
    train = dataclasses.replace(
        load_params(ROOT / "params.yaml", ROOT).train, num_envs=ENVS, steps_per_epoch=STEPS, hidden=(16, 8), minibatches=3, passes=4, clip=0.1,
        value_coefficient=0.7, learning_rate=0.003, max_grad_norm=0.4, init_std=0.8, desired_kl=0.012,
    )  # fmt: skip
    train = dataclasses.replace(train, **changes)
    torch.manual_seed(1)
    return build_ppo(observation_groups(torch.zeros(train.num_envs, WIDTH)), ACTIONS, train)


def epochs(count, num_envs=ENVS):
    """Epochs as an environment would give them: states, ends, time limits and rewards, with zeros of both among them."""
    generator = torch.Generator().manual_seed(2)
    for _ in range(count):
        states = 3.0 * torch.randn(STEPS + 1, num_envs, WIDTH, generator=generator) + 1.0
        ends = torch.rand(STEPS, num_envs, generator=generator) < 0.3
        timed_out = ends & (torch.rand(STEPS, num_envs, generator=generator) < 0.5)
        yield states, ends, timed_out, torch.randn(STEPS, num_envs, 1, generator=generator)


def by_the_library(ppo, states, ends, timed_out, rewards):
    """An epoch through rsl_rl's own methods, as its runner calls them."""
    unpaid = torch.zeros_like(rewards[0, :, 0])
    with torch.inference_mode():
        for step in range(STEPS):
            PPO.act(ppo, observation_groups(states[step]))
            extras = {"time_outs": timed_out[step].float()}
            PPO.process_env_step(ppo, observation_groups(states[step + 1]), unpaid, ends[step], extras)
        ppo.storage.rewards += rewards
        PPO.compute_returns(ppo, observation_groups(states[-1]))
    return PPO.update(ppo)


def lean(ppo, states, ends, timed_out, rewards):
    with torch.inference_mode():
        for step in range(STEPS):
            ppo.choose(states[step])
            ppo.follow(ends[step], timed_out[step])
        ppo.storage.rewards += rewards
        ppo.finish(states[-1])
    return ppo.update()


def stored(ppo):
    storage = ppo.storage
    return {
        "observations": storage.observations["policy"], "actions": storage.actions, "rewards": storage.rewards,
        "dones": storage.dones, "values": storage.values, "log": storage.actions_log_prob, "returns": storage.returns,
        "advantages": storage.advantages, "means": storage.distribution_params[0], "deviations": storage.distribution_params[1],
    }  # fmt: skip


def assert_same(found, wanted):
    assert found.keys() == wanted.keys()
    assert [name for name in wanted if found[name].tobytes() != wanted[name].tobytes()] == []


@pytest.mark.parametrize("changes", VARIED.values(), ids=VARIED)
def test_epochs_leave_the_librarys_weights_optimizer_statistics_rate_draws_and_losses(changes):
    ppo, library = made(changes), made(changes)
    num_envs, rates = ppo.storage.num_envs, set()
    torch.manual_seed(3)
    losses = [lean(ppo, *epoch) for epoch in epochs(4, num_envs)]
    drawn = torch.get_rng_state()
    torch.manual_seed(3)
    for epoch, own in zip(epochs(4, num_envs), losses, strict=True):
        wanted = by_the_library(library, *epoch)
        rates.add(library.learning_rate)
        assert (own["value"], own["surrogate"]) == (wanted["value"], wanted["surrogate"])
        assert own["entropy"] == pytest.approx(wanted["entropy"], rel=1e-6)
    assert torch.equal(drawn, torch.get_rng_state())
    assert_same({n: v.numpy() for n, v in stored(ppo).items()}, {n: v.numpy() for n, v in stored(library).items()})
    assert_same(policy_arrays(ppo), policy_arrays(library))
    assert_same(optimizer_arrays(ppo), optimizer_arrays(library))
    assert ppo.learning_rate == library.learning_rate
    assert len(rates) > 1


def test_deviations_that_fell_below_the_least_one_learn_nothing_as_in_the_library():
    ppo, library = made({}), made({})
    for one in (ppo, library):
        with torch.no_grad():
            one.actor.distribution.std_param[1] = 1e-7
    for one, update in ((ppo, lean), (library, by_the_library)):
        torch.manual_seed(3)
        for epoch in epochs(2):
            update(one, *epoch)
    assert_same(policy_arrays(ppo), policy_arrays(library))
    assert ppo.actor.distribution.std_param[1].item() == pytest.approx(1e-7)


def test_what_was_clamped_has_its_gradient_inside_and_at_both_ends():
    gradient, argument = torch.tensor([1.0, 2.0, 3.0, 4.0, 5.0]), torch.tensor([-2.5, -2.0, 0.5, 1.5, 1.75])
    assert of_clamped(gradient, argument, -2.0, 1.5).tolist() == [0.0, 2.0, 3.0, 4.0, 0.0]
    leaf = argument.clone().requires_grad_()
    leaf.clamp(-2.0, 1.5).backward(gradient)
    assert leaf.grad.tolist() == [0.0, 2.0, 3.0, 4.0, 0.0]


def test_advantages_that_hardly_differ_are_divided_as_in_the_library():
    """Rewards of 1e-8 and values of 0: what is added to the deviation, 1e-8, is as large as the deviation."""
    ppo, library = made({}), made({})
    for one in (ppo, library):
        with torch.no_grad():
            for weight in one.critic.parameters():
                weight.zero_()
    states, ends, timed_out, rewards = next(epochs(1))
    for one, epoch in ((ppo, lean), (library, by_the_library)):
        torch.manual_seed(3)
        epoch(one, states, ends, timed_out, 1e-8 * rewards)
    own, theirs = ppo.storage.advantages, library.storage.advantages
    assert torch.equal(own, theirs)
    assert 0.3 < own.std().item() < 0.7


@pytest.mark.parametrize(
    ("desired_kl", "means", "rate"),
    [
        # One action is a deviation off: (1 + 1 - 1 - log 1) / 2, a divergence of 0.5.
        (0.24, 1.0, 0.002),
        (0.25, 1.0, 0.003),
        (1.0, 1.0, 0.003),
        (1.01, 1.0, 0.0045),
        (1.01, 0.0, 0.003),
    ],
)
def test_the_rate_falls_beyond_twice_the_desired_divergence_and_rises_below_half_of_it(desired_kl, means, rate):
    ppo = made({"desired_kl": desired_kl})
    ppo.storage.distribution_params = (torch.zeros(1, 1, ACTIONS), torch.ones(1, 1, ACTIONS))
    ppo._adapt(torch.zeros(1, ACTIONS), torch.tensor([[means, 0.0, 0.0]]), torch.ones(ACTIONS))
    assert ppo.learning_rate == pytest.approx(rate)
    assert ppo.optimizer.param_groups[0]["lr"] == ppo.learning_rate


_FAST = """
import sys
from porse import numerics
numerics.apply("fast")
import pytest
sys.exit(pytest.main(["--noconftest", "-q", "-p", "no:cacheprovider", sys.argv[1], "-k", "not fast"]))
"""


def test_the_same_holds_in_the_profile_fast():
    """In a process of its own: libraries choose their code once, when they are loaded."""
    switches = numerics.ENVIRONMENT["portable"]
    environment = {name: value for name, value in os.environ.items() if name not in switches}
    done = subprocess.run(
        [sys.executable, "-c", _FAST, __file__], env=environment, cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-2000:]
    assert f"{len(VARIED) + 8} passed" in done.stdout
