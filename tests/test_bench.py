"""The bench: its arithmetic by hand, and that each suite's measuring sees work that was put in."""

import dataclasses
import json
import math
import shutil
import sys
import time
from itertools import islice

import numpy as np
import psutil
import pytest
import torch
from click.testing import CliRunner

from porse.bench import commands, replies, sim
from porse.bench.command import bench, line_of
from porse.bench.figure import Bar, Figure, Measure, ratios
from porse.bench.floor import Products, bare_steps_s, physics_of, starts_of
from porse.bench.humanoid import ACTION, OwnHumanoids, step_s
from porse.bench.machine import described, machine, plain_environment
from porse.bench.runner import HumanEnv
from porse.bench.table import MTS, OVER_ENVPOOL, OVER_GYMNASIUM, TABLE, found, missing
from porse.bench.task_speed import rounds
from porse.bench.work import Epochs, Work, human_params
from porse.bench.workshop import workshop
from porse.errors import PorseError
from porse.llm.store import Store
from porse.tasks import make_task
from tiny import ROOT


def burn(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


@pytest.mark.parametrize(
    ("bar", "rounds", "value", "holds"),
    [
        # In order: 0.7, 0.9, 1.6. The mean, 1.07, would be on the other side of 1.
        (Bar(">=", 0.9), (1.6, 0.7, 0.9), 0.9, True),
        (Bar(">=", 1.0), (1.6, 0.7, 0.9), 0.9, False),
        (Bar("<=", 0.9), (1.6, 0.7, 0.9), 0.9, True),
        (Bar("<=", 0.8), (1.6, 0.7, 0.9), 0.9, False),
        # Between 2 and 3, where there are two in the middle.
        (Bar(">=", 2.5), (9.0, 3.0, 2.0, 1.0), 2.5, True),
        (Bar(">=", -0.33), (-0.5, -0.31, -0.2), -0.31, True),
        (None, (0.7,), 0.7, None),
        (Bar("<=", 1.0), (), None, None),
    ],
)
def test_a_value_is_the_median_of_its_rounds_and_holds_on_the_side_of_its_bar(bar, rounds, value, holds):
    figure = Figure(Measure("sim", "x", "ratio", "y", bar), rounds)
    assert figure.value == value
    assert figure.holds is holds


def test_a_ratio_is_taken_within_each_round():
    # The second round had half the machine: of medians, 3 / 2, it would be another.
    assert ratios([3.0, 6.0, 1.0], [2.0, 4.0, 4.0]) == (1.5, 1.5, 0.25)
    with pytest.raises(ValueError, match="zip"):
        ratios([1.0, 2.0], [1.0])


def test_a_figure_is_found_by_its_name_and_printed_with_spread_and_bar():
    figure = found("train", MTS, [-0.5, -0.25, -0.375])
    assert figure.as_json() == {
        "suite": "train", "name": MTS, "value": -0.375, "unit": "fitness", "peer": figure.measure.peer, "sense": ">=",
        "bar": -0.33, "holds": False, "low": -0.5, "high": -0.25, "rounds": 3, "missing": None,
    }  # fmt: skip
    head, rest = line_of(figure)
    assert head.split() == ["train", *MTS.split(), "-0.375", ">=", "-0.33", "no", "-0.5", "to", "-0.25", "3"]
    assert rest == f"fitness; {figure.measure.peer}"
    with pytest.raises(ValueError, match="unpack"):
        found("sim", MTS, [1.0])


def test_figures_are_told_apart_by_their_names():
    names = [(measure.suite, measure.name) for measure in TABLE]
    assert len({*names}) == len(names)
    assert {suite for suite, _ in names} == {"sim", "train", "pipeline", "llm"}


def test_what_was_not_measured_says_why_in_both_forms():
    figure = missing("sim", OVER_ENVPOOL, "no EnvPool: pip install it")
    assert [figure.as_json()[key] for key in ("value", "holds", "low", "high", "rounds", "missing")] == [
        None, None, None, None, 0, "no EnvPool: pip install it",
    ]  # fmt: skip
    assert line_of(figure)[1] == "not measured: no EnvPool: pip install it"


def test_a_peer_that_is_not_installed_is_named_with_the_command_that_installs_it(monkeypatch):
    monkeypatch.setattr(sim, "lacking", lambda *packages: [*packages])
    figures = {figure.measure.name: figure for figure in sim._peers(1)}
    assert {*figures} == {OVER_ENVPOOL, OVER_GYMNASIUM}
    assert all("pip install 'porse[bench]'" in figure.missing for figure in figures.values())
    assert all(figure.rounds == () for figure in figures.values())


def test_the_command_prints_the_machine_and_a_list_of_figures():
    arguments = ["--suite", "llm", "--rounds", "2", "--json", "--cache", str(ROOT / "llm_cache")]
    done = CliRunner().invoke(bench, arguments, catch_exceptions=False)
    said = json.loads(done.output)
    assert [figure["name"] for figure in said["figures"]] == [m.name for m in TABLE if m.suite == "llm"]
    assert all(figure["rounds"] == 2 for figure in said["figures"])
    assert all(0.0 < figure["low"] <= figure["value"] <= figure["high"] for figure in said["figures"])
    assert said["machine"]["cores"] >= 1
    assert (
        said["machine"]["package torch"] == torch.__version__.split("+")[0] or "+" in said["machine"]["package torch"]
    )
    text = CliRunner().invoke(bench, arguments[:4] + arguments[5:], catch_exceptions=False).output
    assert text.startswith("machine  ")
    assert sum(line.startswith("llm ") for line in text.splitlines()) == 3


@pytest.mark.parametrize(("load", "warned"), [(0.04, False), (1.9, True)])
def test_a_busy_machine_is_named(load, warned):
    lines = described({**machine(), "load average": load})
    assert any(line.startswith("warning") and str(load) in line for line in lines) is warned
    assert f"load average {load}" in lines[0]


def test_a_process_that_chooses_its_profile_inherits_no_switch_of_another(monkeypatch):
    monkeypatch.setenv("MKL_CBWR", "COMPATIBLE")
    monkeypatch.setenv("KEPT", "yes")
    assert "MKL_CBWR" not in plain_environment()
    assert plain_environment()["KEPT"] == "yes"


# Suite sim.


def test_the_share_of_the_physics_falls_with_work_of_the_task():
    task = make_task("Anymal", 8, seed=0)
    [plain] = islice(rounds(task, time.process_time), 1)
    measured = task.compute_observations

    def slowly():
        # Ten control steps of a round: twice as long, at least.
        burn(plain.whole_s / 10)
        return measured()

    task.compute_observations = slowly
    [slow] = islice(rounds(task, time.process_time), 1)
    assert 0.4 < plain.share < 1.0
    assert slow.share < 0.75 * plain.share


def test_the_bare_physics_leads_where_a_task_is_led_that_does_nothing_between_substeps():
    """From the states with the controls of this very step: those of the one before would lead elsewhere."""
    task = make_task("Humanoid", 3, seed=0)
    physics = physics_of(task)
    with starts_of(physics) as starts:
        for _ in range(2):
            task.step(2.0 * torch.rand(3, task.NUM_ACTIONS, generator=torch.Generator().manual_seed(7)) - 1.0)
    led = physics.qpos.clone()
    assert len(starts) == 2
    assert bare_steps_s(physics, starts, task.SUBSTEPS, time.process_time) > 0.0
    assert torch.equal(physics.qpos, led)
    assert "advance" not in vars(physics)


class Stepped:
    """Humanoids that burn so many milliseconds a step."""

    def __init__(self, milliseconds):
        self.milliseconds, self.shapes = milliseconds, set()

    def step(self, actions):
        self.shapes.add(actions.shape)
        burn(1e-3 * self.milliseconds)

    def spent_s(self):
        return time.process_time()


def test_a_peer_that_takes_three_times_as_long_makes_a_ratio_of_three():
    own, peer = Stepped(1), Stepped(3)
    found = sim.beside(own, peer, 512, 3)
    assert len(found) == 3
    assert sorted(found)[1] == pytest.approx(3.0, rel=0.15)
    assert own.shapes == peer.shapes == {(512, 17)}


def test_the_humanoid_is_gymnasiums():
    import gymnasium

    theirs = gymnasium.make("Humanoid-v5", reset_noise_scale=0.0).unwrapped
    theirs.reset(seed=0)
    own = OwnHumanoids(2)
    own._physics.restart(torch.arange(2))
    own._physics.refresh(torch.arange(2))
    own._place = own._mass_centre()
    for action in np.random.default_rng(3).uniform(-ACTION, ACTION, (4, 17)):
        seen, reward, ended, _, facts = theirs.step(action)
        own.step(np.stack([action, action]))
    assert own._physics.qpos[1].numpy() == pytest.approx(theirs.data.qpos, abs=1e-9)
    # Positions and velocities; what follows from them is gymnasium's of one substep earlier.
    assert own.observations[1, :45].numpy() == pytest.approx(seen[:45], abs=1e-5)
    assert own.observations.shape == (2, len(seen) - 13 * 6)
    # But for what contacts cost, of which this physics knows nothing.
    assert float(own.rewards[1]) == pytest.approx(reward - facts["reward_contact"], abs=0.02)
    assert not ended
    assert not own.ended.any()


def test_a_humanoid_that_lies_down_begins_again():
    own = OwnHumanoids(3)
    own._physics.qpos[1, 2] = 0.9
    step_s(own, np.zeros((1, 3, 17)))
    assert own.ended.tolist() == [False, True, False]
    assert own._ages.tolist() == [1, 0, 1]
    assert float(own._physics.qpos[1, 2]) == pytest.approx(1.4, abs=0.011)
    # 5 for each that is healthy, and little for standing still.
    assert own.rewards.tolist() == pytest.approx([5.0, 0.0, 5.0], abs=0.5)


# Suite train.


@pytest.fixture
def train(small):
    return dataclasses.replace(small.train, passes=3, steps_per_epoch=5, hidden=(7, 6), minibatches=2, num_envs=8)


def test_products_are_those_of_both_networks_in_rollout_and_update(train):
    products = Products(9, 4, train)
    # Three layers each: six products a step and three for the last values; and forward, weights and two inputs of each
    # network in each of 3 x 2 minibatches.
    assert products.count() == 5 * 6 + 3 + 3 * 2 * 2 * (3 + 3 + 2)
    shapes = [(tuple(left.shape), tuple(right.shape)) for left, right, _ in products._parts[2][1]]
    # 8 x 5 samples in two minibatches.
    assert shapes[:8] == [
        ((20, 9), (9, 7)), ((20, 7), (7, 6)), ((20, 6), (6, 4)),
        ((7, 20), (20, 9)), ((6, 20), (20, 7)), ((4, 20), (20, 6)),
        ((20, 6), (6, 7)), ((20, 4), (4, 6)),
    ]  # fmt: skip
    assert products.seconds() > 0.0


@pytest.fixture
def tiny():
    found = human_params(ROOT / "params.yaml", "Quadcopter", "portable")
    return dataclasses.replace(
        found, train=dataclasses.replace(found.train, num_envs=16, steps_per_epoch=8, hidden=(8,), minibatches=2)
    )


def test_trainings_have_the_human_reward_and_no_bonus(tiny):
    assert (tiny.candidate.goal, tiny.candidate.bonus, tiny.candidate.beta) == ("human", "none", 0.0)
    assert (tiny.size, tiny.device, tiny.numerics) == ("cpu", "cpu", "portable")


def test_work_of_the_reward_is_in_an_epoch_and_in_the_runners_and_not_in_the_floor(tiny, tmp_path, monkeypatch):
    epochs = Epochs(tiny, tmp_path)
    plain = {what: getattr(epochs, what)(1) for what in ("epoch_s", "runner_s", "floor_s")}
    plain = {what: getattr(epochs, what)(2) for what in plain}
    assert plain["epoch_s"] > plain["floor_s"] > 0.0
    kind = type(make_task("Quadcopter", 2, seed=0))
    measured = kind.human_reward

    def slowly(task):
        burn(0.02)
        return measured(task)

    monkeypatch.setattr(kind, "human_reward", slowly)
    # Eight steps of an epoch.
    assert epochs.epoch_s(2) > plain["epoch_s"] + 0.1
    assert epochs.runner_s(2) > plain["runner_s"] + 0.1
    assert epochs.floor_s(1) < plain["floor_s"] + 0.05


def test_the_runners_environment_pays_ends_and_begins_as_a_training_does():
    task, played = (make_task("Quadcopter", 3, seed=0) for _ in range(2))
    for each in (task, played):
        each.head_start[1] = each.TIME_LIMIT - 1
    actions = torch.full((3, task.NUM_ACTIONS), 0.25)
    seen, rewards, ends, extras = HumanEnv(task).step(actions)
    played.step(actions)
    assert torch.equal(rewards, played.human_reward())
    assert ends.tolist() == [False, True, False]
    assert extras["time_outs"].tolist() == [0.0, 1.0, 0.0]
    assert torch.equal(seen["policy"], task.observations())
    assert task.progress.tolist() == [1, 0, 1]


def test_workers_share_a_pool_its_memory_is_seen_and_its_fitness_returned(tiny, tmp_path, monkeypatch):
    monkeypatch.setenv("PORSE_WORKERS", "1")
    work = Work(lambda task: tiny, tmp_path)
    assert work.pool_s("Quadcopter", candidates=2, epochs=1, workers=2) > 0.0
    # A training has some memory of its own, and far less than the libraries that it shares.
    assert 1.0 < work.memory_mb("Quadcopter", epochs=2) < psutil.Process().memory_info().rss / 1e6
    mts, spent = work.learning("Quadcopter", seed=3, epochs=2)
    again, _ = work.learning("Quadcopter", seed=3, epochs=2)
    other, _ = work.learning("Quadcopter", seed=4, epochs=2)
    assert mts == again != other
    assert spent > 0.0
    assert math.isfinite(mts)


def test_a_process_says_what_failed_and_when_it_ends_unasked(capfd):
    with workshop("fast", ROOT / "params.yaml") as shop:
        with pytest.raises(PorseError, match=r"module:Class, found 'Nowhere' in .*params.yaml"):
            shop.ask("floor_s", task="Nowhere", times=1)
        with pytest.raises(PorseError, match=r"no_such_thing of .* in profile fast, found that its process ended"):
            shop.ask("no_such_thing")
    assert "no attribute 'no_such_thing'" in capfd.readouterr().err


# Suites pipeline and llm.


def test_a_command_is_charged_with_its_own_work_and_that_of_its_children():
    code = "import time\nend = time.process_time() + {}\nwhile time.process_time() < end: pass"
    child = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {code.format(0.2)!r}])"
    [short] = commands.spent_s([sys.executable, "-c", code.format(0.0)], 1)
    [long] = commands.spent_s([sys.executable, "-c", code.format(0.2)], 1)
    [through] = commands.spent_s([sys.executable, "-c", child], 1)
    assert long > short + 0.15
    assert through > short + 0.15
    with pytest.raises(PorseError, match=r"found exit code 3: it is so; run"):
        commands.spent_s([sys.executable, "-c", "print('it is so'); raise SystemExit(3)"], 1)


def test_dvc_is_not_measured_where_there_is_no_project(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert commands._dvc_status(1).missing == "no project of DVC here: run it in a checkout"


def test_a_look_up_that_takes_longer_is_seen(tmp_path, monkeypatch):
    cache = tmp_path / "llm_cache"
    for shard in sorted(path for path in (ROOT / "llm_cache").iterdir() if path.is_dir())[:5]:
        shutil.copytree(shard, cache / shard.name)
    plain = {figure.measure.name: figure.value for figure in replies.figures(1, cache)}
    measured = Store.read

    def slowly(store, key):
        burn(0.005)
        return measured(store, key)

    monkeypatch.setattr(Store, "read", slowly)
    slow = {figure.measure.name: figure for figure in replies.figures(1, cache)}
    look_up = slow["look-up of a recorded reply"]
    # 5 ms more, and the limit is 1.
    assert look_up.value > plain["look-up of a recorded reply"] + 4.0
    assert look_up.holds is False
    assert slow["key of a question"].value < 4.0


def test_no_recorded_replies_are_said(tmp_path):
    assert {figure.missing for figure in replies.figures(1, tmp_path)} == {
        f"no recorded replies in {tmp_path}: name a folder with --cache"
    }
