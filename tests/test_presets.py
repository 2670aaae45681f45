"""Presets: what the files hold, what the rules give, and which layer a value comes from."""

import math
import re

import pytest
import yaml
from click.testing import CliRunner

from porse.cli import main
from porse.config import parse_params, resolve_document
from porse.errors import ParamsError
from porse.methods import ABLATIONS, METHODS
from porse.presets import FOLDER, GIVEN, SIZES
from porse.presets.own import sizes_of
from porse.presets.rules import Sizes, values_by_rule
from porse.search.schedule import total_epochs
from porse.task_names import TASK_CLASSES, TASK_TAGS
from porse.tasks import TASKS
from tiny import ROOT, committed_params, dvc, run

HANDS = [name for name, tags in TASK_TAGS.items() if "hands" in tags]
LENGTHS = ("rung_epochs", "num_envs", "steps_per_epoch")


def preset(task, size):
    return yaml.safe_load((ROOT / FOLDER / f"{task}.yaml").read_text())[size]


def params_of(task, size, **sections):
    document = {**committed_params(), "task": task, "size": size}
    for name, values in sections.items():
        document[name] = {**document[name], **values}
    return parse_params(document, "params.yaml")


def test_every_task_has_one_file_and_dvc_compares_them(root):
    names = [f"{FOLDER}/{task}.yaml" for task in TASK_CLASSES]
    assert sorted(str(path.relative_to(root)) for path in (root / FOLDER).iterdir()) == sorted(names)
    pipeline = yaml.safe_load((root / "dvc.yaml").read_text())
    assert pipeline["params"] == names
    assert FOLDER in pipeline["stages"]["resolve"]["deps"]


def test_what_a_preset_gives_is_null_in_the_committed_parameters_and_nothing_else_of_its_sections():
    document = committed_params()
    for section, keys in GIVEN.items():
        assert {key for key, value in document[section].items() if value is None} == set(keys)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("task", TASK_CLASSES)
def test_a_rung_and_what_ranks_it_hold_a_whole_episode(task, size):
    params, length = params_of(task, size), TASKS[task].EPISODE_LENGTH
    steps, rung = params.train.steps_per_epoch, params.train.rung_epochs
    assert rung * steps >= length
    # No more epochs than that, but ten at least: the mean is of the policy as it is at the rung's end.
    assert params.probe.least_epochs == math.ceil(length / steps) <= rung
    assert params.eliminate.window == max(10, math.ceil(length / steps)) <= rung
    # Mutants are proposed after three rungs, from all that was trained.
    assert params.mutate.window == 3 * rung
    assert params.train.num_envs * steps % params.train.minibatches == 0


@pytest.mark.parametrize("task", TASK_CLASSES)
def test_a_preset_says_how_long_an_episode_a_rung_and_a_run_are(root, task):
    text = (root / FOLDER / f"{task}.yaml").read_text()
    assert text.startswith(
        f"# {task}: what params.yaml leaves to the task. An episode has {TASKS[task].EPISODE_LENGTH} steps.\n"
    )
    said = {
        "rung": [int(steps) for steps in re.findall(r"# A rung: (\d+) steps of each environment", text)],
        "epoch": [int(steps) for steps in re.findall(r"An epoch: (\d+) steps", text)],
        "minibatch": [int(steps) for steps in re.findall(r"in minibatches of (\d+)\.", text)],
        "run": [
            float(steps) * 10 ** {"M": 6, "G": 9}[unit] for steps, unit in re.findall(r"([\d.]+) ([MG]) steps", text)
        ],
    }
    sizes = [preset(task, size)["train"] for size in SIZES]
    epochs = [train["num_envs"] * train["steps_per_epoch"] for train in sizes]
    assert said["rung"] == [train["rung_epochs"] * train["steps_per_epoch"] for train in sizes]
    assert said["epoch"] == epochs
    assert said["minibatch"] == [epochs[1] // sizes[1]["minibatches"]]
    # 5 iterations of 36 rungs, and the lineage of 5 x 6 rungs again with 2 further seeds.
    runs = [(5 * 36 + 2 * 5 * 6) * train["rung_epochs"] * steps for train, steps in zip(sizes, epochs, strict=True)]
    assert said["run"] == pytest.approx(runs, rel=0.03)


def test_a_whole_run_of_the_default_task_is_what_the_rungs_say():
    # 240 rungs of 16 epochs of 128 x 32 steps.
    assert "240 rungs, 15.7 M steps, about 6 minutes" in (ROOT / FOLDER / "Quadcopter.yaml").read_text()
    assert 240 * 16 * 128 * 32 == 15_728_640


@pytest.mark.parametrize("task", HANDS)
def test_two_hand_tasks_share_all_but_their_lengths(task):
    for size in SIZES:
        own, other = preset(task, size)["train"], preset("Over", size)["train"]
        assert {key for key in own if own[key] != other[key]} <= set(LENGTHS if size == "cpu" else ())
    # Rollouts of the learner are of one size, however they are cut.
    assert preset(task, "cpu")["train"]["num_envs"] * preset(task, "cpu")["train"]["steps_per_epoch"] == 4096


PUBLIC = {
    # environments, horizon, minibatch, passes; networks; gamma, learning rate, divergence; half of the critic's coefficient
    "Quadcopter": (8192, 8, 16384, 8, [256, 256, 128], 0.99, 1e-3, 0.016, 2 / 2),
    "FrankaCabinet": (4096, 16, 8192, 8, [256, 128, 64], 0.99, 5e-4, 0.008, 4 / 2),
    "Anymal": (4096, 24, 32768, 5, [256, 128, 64], 0.99, 3e-4, 0.008, 2 / 2),
    "Humanoid": (4096, 32, 32768, 5, [400, 200, 100], 0.99, 5e-4, 0.008, 4 / 2),
    "Over": (2048, 8, 16384, 5, [512, 256, 128], 0.96, 3e-4, 0.016, 1 / 2),
}
"""Isaac Gym's and Eureka's configurations of the learner, as they are published."""


@pytest.mark.parametrize("task", PUBLIC)
def test_the_papers_size_is_the_public_configuration(task):
    train = params_of(task, "paper").train
    found = (
        train.num_envs, train.steps_per_epoch, train.num_envs * train.steps_per_epoch // train.minibatches, train.passes,
        list(train.hidden), train.gamma, train.learning_rate, train.desired_kl, train.value_coefficient,
    )  # fmt: skip
    assert found == PUBLIC[task]
    # Isaac Gym's learners normalise what they observe, Eureka's with two hands do not.
    assert (train.rung_epochs, train.init_std, train.normalise_observations) == (500, 1.0, task != "Over")


@pytest.mark.parametrize("task", ["Anymal", "Kettle"])
def test_the_papers_size_spends_the_papers_budget(task):
    params = params_of(task, "paper")
    # T_max: six rungs of one policy; 5 iterations of 36 rungs.
    assert (6 * params.train.rung_epochs, total_epochs(params)) == (3_000, 90_000)


def test_the_default_task_keeps_its_numbers_but_for_the_rung():
    train = params_of("Quadcopter", "cpu").train
    assert (train.num_envs, train.steps_per_epoch, train.hidden, train.gamma) == (128, 32, (64, 64), 0.99)
    assert (train.rung_epochs, params_of("Quadcopter", "cpu").eliminate.window) == (16, 16)


# Layers.


@pytest.fixture
def project(tmp_path):
    """A folder with a preset for Over whose numbers are like no other."""
    (tmp_path / FOLDER).mkdir()
    write(tmp_path, {size: numbers(gamma) for size, gamma in (("cpu", 0.71), ("paper", 0.83))})
    return tmp_path


def numbers(gamma):
    train = {
        "rung_epochs": 7, "num_envs": 6, "steps_per_epoch": 5, "hidden": [3, 2], "init_std": 0.4,
        "normalise_observations": False, "learning_rate": 0.013, "desired_kl": 0.011, "gamma": gamma,
        "value_coefficient": 1.7, "passes": 9, "minibatches": 15,
    }  # fmt: skip
    return {"train": train, "probe": {"least_epochs": 3}, "eliminate": {"window": 4}, "mutate": {"window": 19}}


def write(project, content):
    (project / FOLDER / "Over.yaml").write_text(content if isinstance(content, str) else yaml.safe_dump(content))


def asked(**changed):
    """Returns the committed parameters, for Over; `train__gamma` is the key gamma of the section train."""
    document = {**committed_params(), "task": "Over"}
    for name, value in changed.items():
        section, _, key = name.partition("__")
        document[section] = {**document[section], key: value} if key else value
    return document


def test_null_is_the_presets_value_and_any_other_value_takes_its_place(project):
    params = parse_params(asked(), "params.yaml", project)
    assert (params.train.gamma, params.train.minibatches, params.train.hidden) == (0.71, 15, (3, 2))
    assert (params.probe.least_epochs, params.eliminate.window, params.mutate.window) == (3, 4, 19)
    paper = parse_params(
        asked(size="paper", train__passes=2, train__normalise_observations=True), "params.yaml", project
    )
    assert (paper.train.gamma, paper.train.passes, paper.train.normalise_observations) == (0.83, 2, True)


def test_a_zero_and_a_false_are_values_and_no_nulls(project):
    params = parse_params(asked(train__gamma=0.0, train__value_coefficient=0), "params.yaml", project)
    assert (params.train.gamma, params.train.value_coefficient) == (0.0, 0.0)


def test_the_order_of_layers_is_preset_file_method_ablation(project, monkeypatch):
    monkeypatch.setitem(METHODS, "mine", {"train": {"gamma": 0.5, "passes": 3, "clip": 0.3}})
    monkeypatch.setitem(ABLATIONS, "less", {"train": {"passes": 1}})
    document = asked(method="mine", ablation="less", train__gamma=0.6, train__init_std=0.9)
    resolved = resolve_document(document, "params.yaml", project)
    train = resolved.document["train"]
    assert [train[key] for key in ("gamma", "passes", "clip", "init_std", "minibatches")] == [0.5, 1, 0.3, 0.9, 15]
    assert {key: resolved.origins.get(f"train.{key}") for key in ("gamma", "passes", "init_std", "minibatches")} == {
        "gamma": "method mine",
        "passes": "ablation less",
        "init_std": None,
        "minibatches": "preset Over cpu",
    }


def test_the_document_itself_is_not_changed(project):
    document = asked()
    resolve_document(document, "params.yaml", project)
    assert document == asked()


def test_a_file_without_a_null_needs_no_preset(tmp_path):
    values = numbers(0.2)
    document = asked(**{f"{name}__{key}": value for name, section in values.items() for key, value in section.items()})
    assert parse_params(document, "params.yaml", tmp_path).train.gamma == 0.2


def changed(name, value):
    """Returns a preset with another value at a dotted name; None takes the key away."""
    content = {size: numbers(0.9) for size in SIZES}
    *path, last = name.split(".")
    section = content
    for key in path:
        section = section[key]
    if value is None:
        del section[last]
    else:
        section[last] = value
    return content


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (changed("cpu.train.gama", 0.9), ["found cpu.train.gama", "did you mean cpu.train.gamma?"]),
        (changed("cpu.exploration", {"cells": 3}), ["found cpu.exploration", "a preset gives train, probe, eliminate, mutate"]),
        (changed("gpu", {}), ["found gpu", "did you mean cpu?"]),
        (changed("cpu.mutate.window", None), ["expected cpu.mutate.window", "found none"]),
        (changed("paper", None), ["expected paper", "found none"]),
        (changed("cpu.train", [1]), ["expected cpu.train to hold rung_epochs", "found [1]"]),
        (changed("cpu.train.gamma", 1.3), ["expected train.gamma to be a number in [0, 1], found 1.3", "size cpu"]),
        (changed("cpu.train.hidden", 64), ["train.hidden", "a list", "64"]),
        (changed("cpu.eliminate.window", 0), ["eliminate.window", "[1,", "0"]),
        (changed("cpu.train.num_envs", 2.5), ["train.num_envs", "int", "2.5"]),
        # 6 x 5 steps in 7 minibatches: either file may be the one to mend.
        (changed("cpu.train.minibatches", 7), ["train.minibatches", "a divisor of num_envs x steps_per_epoch = 30", "params.yaml over"]),
        ("cpu: [", ["YAML"]),
        ("text", ["expected the preset to hold cpu, paper", "'text'"]),
    ],
)  # fmt: skip
def test_an_error_in_a_preset_names_its_file(project, content, words):
    write(project, content)
    with pytest.raises(ParamsError) as caught:
        parse_params(asked(), "params.yaml", project)
    assert [word for word in [*words, f"{project}/presets/Over.yaml"] if word not in str(caught.value)] == []


@pytest.mark.parametrize(
    ("document", "says"),
    [
        (asked(size="papers"), r"expected size to be one of cpu, paper, found 'papers' in params.yaml; did you mean paper\?"),
        (asked(size=3), "expected size to be one of cpu, paper, found 3 in params.yaml; change it there"),
        (asked(task="Ovre"), "found 'Ovre' in params.yaml; the nearest names are Over$"),
        # Whatever its case; and no more than three.
        (asked(task="doorOpen"), "the nearest names are DoorOpenInward, DoorOpenOutward, DoorCloseInward$"),
        (asked(task="catchUnder"), "the nearest names are CatchUnderarm, TwoCatchUnderarm, CatchOver2Underarm$"),
        (asked(task="Drone"), "found 'Drone' in params.yaml; no name is near, all are Anymal, BlockStack,"),
        (asked(task="Pen"), r"expected the preset of the task in .*presets/Pen\.yaml, found no such file"),
        (asked(train__clip=None), "expected train.clip to be a value of type float, found None in params.yaml"),
        (asked(train__gamma=1.3), r"expected train.gamma to be a number in \[0, 1\], found 1.3 in params.yaml; change"),
    ],
)  # fmt: skip
def test_a_wrong_task_size_or_value_is_named_with_its_file(project, document, says):
    with pytest.raises(ParamsError, match=says):
        parse_params(document, "params.yaml", project)


def test_without_a_size_the_parameter_is_missed_and_no_preset(project):
    document = asked()
    del document["size"]
    with pytest.raises(ParamsError, match=r"expected the parameter size in params\.yaml, found none"):
        parse_params(document, "params.yaml", project)


# Rules, for tasks of one's own.


def test_the_rules_for_a_small_task_with_short_episodes():
    found = values_by_rule("cpu", Sizes(episode=90, observations=33, actions=7))
    # 40 numbers; 90 steps are 5.6 epochs of 16.
    assert found["train"] == {
        "rung_epochs": 12, "num_envs": 256, "steps_per_epoch": 16, "hidden": [64, 64], "init_std": 1.0,
        "normalise_observations": True, "learning_rate": 0.001, "desired_kl": 0.016, "gamma": 0.96,
        "value_coefficient": 1.0, "passes": 4, "minibatches": 4,
    }  # fmt: skip
    assert (found["probe"], found["eliminate"], found["mutate"]) == (
        {"least_epochs": 6},
        {"window": 10},
        {"window": 36},
    )


@pytest.mark.parametrize(
    ("size", "sizes", "epochs", "envs", "steps", "hidden", "gamma", "window"),
    [
        ("cpu", Sizes(100, 34, 7), 12, 256, 16, [128, 128], 0.99, 10),
        # 250 / 16 = 15.6; CartPole of CONTRIBUTING.md.
        ("cpu", Sizes(250, 4, 1), 16, 256, 16, [64, 64], 0.99, 16),
        ("cpu", Sizes(320, 120, 40), 20, 256, 16, [128, 128], 0.99, 20),
        ("cpu", Sizes(321, 121, 40), 12, 128, 32, [256, 256, 128], 0.99, 11),
        ("cpu", Sizes(1280, 1, 1), 40, 128, 32, [64, 64], 0.99, 40),
        # 5000 / 64 = 78.1
        ("cpu", Sizes(5000, 1, 1), 79, 64, 64, [64, 64], 0.99, 79),
        ("paper", Sizes(99, 120, 40), 500, 4096, 16, [256, 128, 64], 0.96, 10),
        # 9000 / 16 = 562.5
        ("paper", Sizes(9000, 120, 41), 563, 4096, 16, [512, 256, 128], 0.99, 563),
    ],
)
def test_the_rules_follow_from_episode_and_sizes(size, sizes, epochs, envs, steps, hidden, gamma, window):
    found = values_by_rule(size, sizes)
    train = found["train"]
    assert [train[key] for key in ("rung_epochs", "num_envs", "steps_per_epoch", "hidden", "gamma")] == [
        epochs, envs, steps, hidden, gamma,
    ]  # fmt: skip
    assert (found["eliminate"]["window"], found["mutate"]["window"]) == (window, 3 * epochs)
    assert found["probe"]["least_epochs"] * steps >= sizes.episode > (found["probe"]["least_epochs"] - 1) * steps
    assert {section: set(values) for section, values in found.items()} == {
        name: set(keys) for name, keys in GIVEN.items()
    }


OWN = "mine.cart:Cart"
CART = """
class Base:
    EPISODE_LENGTH = 70
    NUM_OBSERVATIONS: int = 11
    NUM_ACTIONS = 3

class Cart(Base):
    EPISODE_LENGTH = 400
"""


def own(tmp_path, text):
    (tmp_path / "mine").mkdir(exist_ok=True)
    (tmp_path / "mine" / "cart.py").write_text(text)
    return tmp_path


def test_a_class_says_its_sizes_itself_or_by_a_base_in_its_module(tmp_path):
    assert sizes_of(OWN, own(tmp_path, CART), tmp_path) == Sizes(400, 11, 3)


def test_a_task_of_ones_own_gets_its_numbers_by_rule_without_being_imported(tmp_path):
    root = own(tmp_path, f"raise SystemExit\n{CART}")
    resolved = resolve_document({**committed_params(), "task": OWN}, "params.yaml", root)
    # 400 / 32 = 12.5
    assert (resolved.document["train"]["rung_epochs"], resolved.document["train"]["num_envs"]) == (13, 128)
    assert resolved.origins["train.rung_epochs"] == "preset mine.cart:Cart cpu, by rule"


def test_a_file_of_its_own_takes_the_place_of_the_rules(tmp_path):
    root = own(tmp_path, "")
    (root / FOLDER).mkdir()
    (root / FOLDER / "mine.cart.Cart.yaml").write_text(yaml.safe_dump({size: numbers(0.35) for size in SIZES}))
    resolved = resolve_document({**committed_params(), "task": OWN}, "params.yaml", root)
    assert resolved.document["train"]["gamma"] == 0.35
    assert resolved.origins["train.gamma"] == "preset mine.cart:Cart cpu"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("class Card: pass", r"expected the class Cart in .*cart\.py to state EPISODE_LENGTH, NUM_OBSERVATIONS, NUM_ACTIONS"),
        (f"{CART}    NUM_ACTIONS = 2 * 2\n", r"to state NUM_ACTIONS as a whole number.*presets/mine\.cart\.Cart\.yaml"),
        (f"{CART}    NUM_ACTIONS = True\n", "to state NUM_ACTIONS as"),
        (f"{CART}    NUM_ACTIONS = 0\n", "to state NUM_ACTIONS as"),
        ("class Cart(Cart): pass", "to state EPISODE_LENGTH"),
        ("class Cart(:", r"expected Python in .*cart\.py, found"),
    ],
)  # fmt: skip
def test_a_class_that_does_not_say_its_sizes_is_refused_with_what_to_do(tmp_path, text, says):
    with pytest.raises(ParamsError, match=says):
        parse_params({**committed_params(), "task": OWN}, "params.yaml", own(tmp_path, text))


# What people see.


def test_porse_params_shows_which_preset_a_value_comes_from(tmp_path):
    text = (ROOT / "params.yaml").read_text()
    for before, after in (
        ("task: Quadcopter", "task: Anymal"),
        ("size: cpu", "size: paper"),
        ("gamma: null", "gamma: 0.5"),
    ):
        assert f"\n{before}" in text or f" {before}" in text
        text = text.replace(before, after)
    (tmp_path / "params.yaml").write_text(text)
    words = ["params", "--params", str(tmp_path / "params.yaml"), "--stage", "begin"]
    lines = CliRunner().invoke(main, words, catch_exceptions=False).output.splitlines()
    assert "train.steps_per_epoch: 24  # preset Anymal paper" in lines
    assert "train.gamma: 0.5" in lines


def test_dvc_compares_presets(tmp_path):
    for name in ("params.yaml", "dvc.yaml"):
        (tmp_path / name).write_bytes((ROOT / name).read_bytes())
    (tmp_path / FOLDER).mkdir()
    for task in TASK_CLASSES:
        (tmp_path / FOLDER / f"{task}.yaml").write_bytes((ROOT / FOLDER / f"{task}.yaml").read_bytes())
    author = ("-c", "user.name=a", "-c", "user.email=a@b.c")
    run(tmp_path, "git", "init", "-q")
    dvc(tmp_path, "init", "-q")
    run(tmp_path, "git", "add", "-A")
    run(tmp_path, "git", *author, "commit", "-q", "-m", "before")
    path = tmp_path / FOLDER / "Humanoid.yaml"
    path.write_text(path.read_text().replace("num_envs: 4096", "num_envs: 1024"))
    rows = [line.split() for line in dvc(tmp_path, "params", "diff").stdout.splitlines()]
    assert rows[1:] == [["presets/Humanoid.yaml", "paper.train.num_envs", "4096", "1024"]]
