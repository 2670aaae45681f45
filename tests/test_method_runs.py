"""Every method and every ablation that the grammar can express on two tasks: what differs from PoRSE's run.

The runs are real ones at tiny size, in one process; those whose way through the stages is their own are run by DVC as
well. An ablation concerns the search and not the task: on the second task they belong to the long suite.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from at_once import outputs, run_at_once
from porse import tables
from porse.config import load_params, parse_params
from porse.generation.functions import Check
from porse.generation.states import checker
from porse.methods import ABLATIONS, METHODS
from porse.methods.sets import ASKED
from porse.report.results import read_results
from porse.search.schedule import total_epochs
from porse.training.limits import WORKERS_VARIABLE
from tiny import committed_params, dvc, make_project
from warm_stages import warm_stages

TASKS = ("Quadcopter", "Over")
METHOD_NAMES = [*METHODS]
ABLATION_NAMES = [name for name in ABLATIONS if name != "none" and name not in ASKED]
NAMES = [*METHOD_NAMES, *ABLATION_NAMES]
ORDER = [
    f"run/{where}"
    for n in (1, 2)
    for where in (
        f"{n}/start", f"{n}/generate", f"{n}/validate-code", f"{n}/train-1", f"{n}/eliminate-1", f"{n}/mutate",
        f"{n}/train-mutants", f"{n}/eliminate-mutants",
    )
]  # fmt: skip
FIRST_DIFFERENCE = {
    # Other questions are asked than PoRSE asks, or none.
    **dict.fromkeys([name for name in METHOD_NAMES if name != "porse"], "run/1/generate"),
    "without-goal-reward": "run/1/generate",
    "without-bonus": "run/1/generate",
    "spliced-mapping": "run/1/generate",
    # Candidates differ from the start in their weights.
    "weights-sum-to-1": "run/1/validate-code",
    # The bonus differs.
    "cells-2000": "run/1/train-1",
    "cells-3000": "run/1/train-1",
    "literal-bonus": "run/1/train-1",
    # Mutants differ: beta is due in iteration 1, alpha in iteration 2.
    "fixed-beta": "run/1/mutate",
    "fixed-alpha": "run/2/mutate",
    # What iteration 2 starts from differs.
    "without-fusion": "run/2/start",
    # The paper's own value.
    "cells-1000": None,
    "porse": None,
}
"""The first output, in the order of the run, whose bytes differ from PoRSE's."""

REWARDS = ("eureka", "roska", "roska-ce", "revolve-auto", "simhash", "without-bonus", "spliced-mapping")
MAPPINGS = ("llmcount", "without-goal-reward")
"""Who asks for the same rewards, or mappings, as PoRSE in iteration 1."""

BY_DVC = ("roska", "revolve-auto", "llmcount", "without-fusion")
"""Who is run by DVC as well: alpha is searched, islands are handed on, the second iteration has nobody in it, and an
ablation changes what `fuse` and `mutate` do. PoRSE itself is in `tests/test_pipeline.py`."""

ONE_ITERATION = (
    "without-goal-reward", "spliced-mapping", "cells-1000", "cells-2000", "cells-3000", "weights-sum-to-1",
    "literal-bonus",
)  # fmt: skip
"""Ablations that show in the first iteration, which is then all that is run of them."""


def params_of(task: str, name: str) -> dict:
    params = committed_params()
    params |= {"task": task, "generator": "grammar"}
    params["method" if name in METHODS else "ablation"] = name
    params["generate"] |= {"candidates": 2, "elites": 1}
    params["validate"] |= {"probe_envs": 8, "probe_steps": 8}
    params["train"] |= {"num_envs": 8, "steps_per_epoch": 4, "rung_epochs": 1, "hidden": [8], "minibatches": 2}
    # A rung has one epoch: it is one short training.
    params["probe"] |= {"initial": 2, "share": 1.0}
    params["mutate"] |= {"pool": "eliminate-1", "mutants": 2}
    params["fuse"] |= {"pool": "eliminate-mutants"}
    params["evaluate"] |= {"seeds": 1, "episodes": 8}
    count = 1 if name in ONE_ITERATION else 2
    params["iterations"] = [{"n": n, "next": n + 1} for n in range(1, count + 1)]
    params["rungs"] = [
        {"rung": 1, "pool": "validate-code", "until": 1, "keep": 1},
        {"rung": "mutants", "pool": "mutate", "until": 1, "keep": 1},
    ]
    return params


def is_long(task: str, name: str) -> bool:
    return task != TASKS[0] and name in ABLATION_NAMES


def each(names: Sequence[str]) -> pytest.MarkDecorator:
    """Parametrizes a test by task and name."""
    pairs = [(task, name) for name in names for task in TASKS]
    marks = {pair: [pytest.mark.slow] if is_long(*pair) else [] for pair in pairs}
    return pytest.mark.parametrize(("task", "name"), [pytest.param(*pair, marks=marks[pair]) for pair in pairs])


class Runs:
    """The runs, by task and name, each made when it is first asked for."""

    def __init__(self, folder: Path, checks: Callable[[str], Check]) -> None:
        self._folder, self._checks = folder, checks
        self._outs: dict[Path, dict[str, str]] = {}

    def folder(self, task: str, name: str, where: str = "once") -> Path:
        """The folder of a run, which is finished."""
        place = self._folder / where / f"{task} {name}"
        if not place.exists():
            run_at_once(place, params_of(task, name), self._checks(task))
        return place

    def outs(self, task: str, name: str, where: str = "once") -> dict[str, str]:
        """The hash of every output, by its path."""
        folder = self.folder(task, name, where)
        if folder not in self._outs:
            self._outs[folder] = outputs(folder)
        return self._outs[folder]

    def table(self, task: str, name: str, table: str) -> list[dict]:
        return tables.read(self.folder(task, name) / "results" / f"{table}.parquet", tables.TABLES[table])

    def figures(self, task: str, name: str) -> Mapping[str, Any]:
        return read_results(self.folder(task, name)).figures


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> Iterator[Runs]:
    with ExitStack() as opened:
        made: dict[str, Check] = {}

        def checks(task: str) -> Check:
            # Methods and ablations do not differ in how functions are tried: one process tries those of all runs of a task.
            if task not in made:
                made[task] = opened.enter_context(checker(parse_params(params_of(task, "porse"), "a test")))
            return made[task]

        yield Runs(tmp_path_factory.mktemp("runs"), checks)


@pytest.fixture(scope="module")
def venv(tmp_path_factory) -> Iterator[Path]:
    with warm_stages(tmp_path_factory.mktemp("warm")) as made:
        yield made


pytestmark = pytest.mark.timeout(1200)


def test_every_name_has_its_first_difference():
    assert set(FIRST_DIFFERENCE) == set(NAMES)


@each(NAMES)
def test_a_run_differs_from_porses_where_it_should_and_not_before(runs, task, name):
    own, porses = runs.outs(task, name), runs.outs(task, "porse")
    assert next((path for path in ORDER if path in own and own[path] != porses[path]), None) == FIRST_DIFFERENCE[name]


def test_functions_are_tried_in_the_same_way_by_every_method_and_ablation():
    params = [parse_params(params_of(TASKS[0], name), "a test") for name in NAMES]
    assert len({(p.seed, p.validate) for p in params}) == 1


@pytest.mark.parametrize("name", METHOD_NAMES)
def test_the_same_method_gives_the_same_bytes_with_another_number_of_workers(runs, monkeypatch, name):
    monkeypatch.setenv(WORKERS_VARIABLE, "2")
    once = runs.outs(TASKS[0], name)
    monkeypatch.setenv(WORKERS_VARIABLE, "1")
    assert runs.outs(TASKS[0], name, "again") == once


@pytest.mark.parametrize("name", BY_DVC)
def test_dvc_gives_the_bytes_of_one_process(runs, venv, tmp_path, name):
    project = make_project(tmp_path / "project", params_of(TASKS[0], name), venv)
    dvc(project, "repro", "--no-run-cache")
    assert outputs(project) == runs.outs(TASKS[0], name)


@each(NAMES)
def test_what_was_spent_is_what_the_schedule_says(runs, task, name):
    figures, params = runs.figures(task, name), load_params(runs.folder(task, name) / "params.yaml")
    spent = sum(row["series"] == "fitness" for row in runs.table(task, name, "curves"))
    assert figures["epochs_spent"] == spent
    assert figures["environment_steps"] == spent * 8 * 4
    # Equal candidates are trained once: the grammar may write one mapping twice.
    assert spent == total_epochs(params) or (name in MAPPINGS and spent < total_epochs(params))
    assert figures["failed_candidates"] == 0
    assert (figures["evaluation_seeds"], figures["evaluation_failed"]) == (1, 0)
    assert figures["episodes"] == 8


def replies(runs, task, name, kind):
    rows = runs.table(task, name, "replies")
    return [(row["slot"], row["key"], row["text"]) for row in rows if row["kind"] == kind and row["iteration"] == 1]


@pytest.mark.parametrize("task", [TASKS[0], pytest.param(TASKS[1], marks=pytest.mark.slow)])
def test_methods_that_ask_the_same_question_share_the_answer(runs, task):
    for kind, names in (("reward", REWARDS), ("mapping", MAPPINGS)):
        porses = replies(runs, task, "porse", kind)
        for name in names:
            assert replies(runs, task, name, kind) == porses, name


@each(NAMES)
def test_candidates_are_made_of_what_the_parameters_say(runs, task, name):
    candidate = load_params(runs.folder(task, name) / "params.yaml").candidate
    rows, curves = runs.table(task, name, "candidates"), runs.table(task, name, "curves")
    assert {bool(row["reward_source"]) for row in rows} == {candidate.goal == "generated"}
    assert {bool(row["mapping_source"]) for row in rows} == {candidate.bonus == "mapping"}
    series = {row["series"].split("/")[0] for row in curves}
    assert ("component" in series) == (candidate.goal == "generated")
    assert ("progress" in series) == (candidate.bonus == "mapping")
    paid = any(row["value"] for row in curves if row["series"] == "bonus")
    assert paid == (candidate.bonus != "none")


@pytest.mark.parametrize("task", [TASKS[0], pytest.param(TASKS[1], marks=pytest.mark.slow)])
def test_mutants_vary_what_the_ablation_leaves_them(runs, task):
    varied = {
        name: [(row["iteration"], row["varied"]) for row in runs.table(task, name, "mutants")]
        for name in ("porse", "fixed-beta", "fixed-alpha", "without-fusion", "without-bonus", "eureka")
    }
    assert varied == {
        "porse": [(1, "beta")] * 2 + [(2, "alpha")] * 2,
        "fixed-beta": [(1, "draw")] * 2 + [(2, "alpha")] * 2,
        "without-bonus": [(1, "draw")] * 2 + [(2, "alpha")] * 2,
        "fixed-alpha": [(1, "beta")] * 2 + [(2, "draw")] * 2,
        "without-fusion": [(1, "beta")] * 2 + [(2, "draw")] * 2,
        "eureka": [],
    }


@each(["fixed-beta"])
def test_mutants_with_draws_of_their_own_are_trained_to_other_ends(runs, task, name):
    rows = [row for row in runs.table(task, name, "candidates") if row["iteration"] == 1]
    ends = {
        row["draw"]: tuple(
            point["value"]
            for point in runs.table(task, name, "curves")
            if point["candidate_id"] == row["candidate_id"] and point["series"] in ("fitness", "goal")
        )
        for row in rows
        if row["origin"] == "mutant" or row["candidate_id"] in {mutant["parent_id"] for mutant in rows}
    }
    assert set(ends) == {0, 1, 2}
    assert len(set(ends.values())) == 3


def start(runs, task, name, policy):
    return (runs.folder(task, name) / "run" / "2" / "start" / "policies" / f"{policy}.safetensors").read_bytes()


@each(["eureka", "revolve-auto", "without-fusion"])
def test_without_fusion_iteration_2_starts_from_the_random_policy(runs, task, name):
    assert start(runs, task, name, "fused") == start(runs, task, name, "random")
    assert start(runs, task, "porse", "fused") != start(runs, task, "porse", "random")


@each(["roska", "roska-ce"])
def test_roska_tries_14_alphas_for_each_candidate_and_goes_on_with_the_best(runs, task, name):
    probes = [row for row in runs.table(task, name, "candidates") if row["origin"] == "probe"]
    assert {row["iteration"] for row in probes} == {2}
    for parent in {row["parent_id"] for row in probes}:
        alphas = [row["alpha"] for row in probes if row["parent_id"] == parent]
        assert len(set(alphas)) == len(alphas) == 14
        assert {0.0, 1.0} <= set(alphas)


@pytest.mark.parametrize("task", TASKS)
def test_revolve_breeds_the_second_iteration_from_the_first(runs, task):
    rows = runs.table(task, "revolve-auto", "candidates")
    first = {row["candidate_id"] for row in rows if row["iteration"] == 1}
    later = [row for row in rows if row["iteration"] == 2]
    assert {row["origin"] for row in later} <= {"mutation", "crossover"}
    assert all(set(row["parent_id"].split("+")) <= first for row in later)


@each(["llmcount", "human", "sparse", "human-budget", "sparse-budget"])
def test_methods_without_iterations_spend_everything_in_the_first(runs, task, name):
    assert [row["iteration"] for row in runs.table(task, name, "iterations")] == [1]
    assert runs.outs(task, name)["run/3/start"] == runs.outs(task, name)["run/2/start"]


@pytest.mark.parametrize("task", TASKS)
def test_human_and_sparse_are_paid_the_tasks_own_rewards(runs, task):
    goals = {
        name: [row["value"] for row in runs.table(task, name, "curves") if row["series"] == "goal"]
        for name in ("human", "sparse")
    }
    assert goals["human"] != goals["sparse"]
    rows = runs.table(task, "human", "curves")
    totals = [row["value"] for row in rows if row["series"] == "reward"]
    # The goal in the size of its returns, and nothing beside it.
    assert all(total * goal >= 0.0 for total, goal in zip(totals, goals["human"], strict=True))
    assert {row["value"] for row in rows if row["series"] == "bonus_share"} == {0.0}
