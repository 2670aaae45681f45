"""Suites: what a file asks for, what the status says of hand-made results, and one real suite at tiny size."""

import dataclasses
import json
import os
import platform
import re
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

import tiny
from porse.cli import main
from porse.config import parse_params
from porse.errors import ParamsError, PorseError
from porse.identity import canonical_json
from porse.pool import BEST, policy_file
from porse.report.results import read_figures
from porse.search.schedule import total_epochs
from porse.suite import run as suite_run
from porse.suite.folders import folders_of, is_locked, locked, read_json, write_json
from porse.suite.plan import load_suite, parse_suite
from porse.suite.resolve import code_id, laid_over, resolve, tracked_files
from porse.suite.status import rows, status_text, suite_status
from porse.training.cluster import Here
from warm_stages import warm_stages

PLAIN = {"name": "a", "tasks": ["Quadcopter"], "methods": ["porse"], "seeds": [1]}


def names(**changed) -> list[str]:
    return [entry.name for entry in parse_suite({**PLAIN, **changed}, "a.yaml").entries]


def test_entries_are_tasks_by_methods_by_ablations_by_seeds_and_then_those_listed():
    asked = {
        "tasks": ["Quadcopter", "my_tasks.cart:CartPole"],
        "methods": ["human", "porse"],
        "ablations": ["none", "without-fusion"],
        "seeds": [2, 1],
        "entries": [{"task": "Over", "method": "eureka", "ablation": "cells-2000", "seed": 3}],
    }
    # An ablation is one of PoRSE, so that the human reward has none; what is listed may have any.
    assert names(**asked) == [
        "Quadcopter-human-2", "Quadcopter-human-1",
        "Quadcopter-porse-2", "Quadcopter-porse-1",
        "Quadcopter-porse-without-fusion-2", "Quadcopter-porse-without-fusion-1",
        "my_tasks.cart.CartPole-human-2", "my_tasks.cart.CartPole-human-1",
        "my_tasks.cart.CartPole-porse-2", "my_tasks.cart.CartPole-porse-1",
        "my_tasks.cart.CartPole-porse-without-fusion-2", "my_tasks.cart.CartPole-porse-without-fusion-1",
        "Over-eureka-cells-2000-3",
    ]  # fmt: skip


def test_a_variant_is_an_entry_of_its_own_with_its_overrides():
    half, none = {"exploration": {"lambda": 0.5}}, {"candidate": {"bonus": "none"}}
    suite = parse_suite({**PLAIN, "seeds": [3, 4], "variants": {"lambda-0.5": half, "none": none}}, "a.yaml")
    assert [(entry.name, entry.overrides) for entry in suite.entries] == [
        ("Quadcopter-porse-lambda-0.5-3", half),
        ("Quadcopter-porse-lambda-0.5-4", half),
        ("Quadcopter-porse-none-3", none),
        ("Quadcopter-porse-none-4", none),
    ]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"variants": {"a/b": {}}}, "expected a variant to be letters, digits, .* found 'a/b' in a.yaml"),
        ({"variants": {"a": 1}}, "expected variants.a to be parameters and their values, found 1 in a.yaml"),
        ({"variants": {"a": {"task": "Over"}}}, "expected variants.a to leave task alone in a.yaml, found 'Over'"),
        ({"taks": ["Over"]}, "found taks; did you mean tasks?"),
        ({"seeds": []}, "expected seeds to be a list with at least one entry"),
        ({"seeds": [True]}, re.escape("expected seeds[0] to be a value of type int, found True")),
        (
            {"tasks": ["Quadcoper"]},
            r"expected tasks\[0\] to be one of .*'Quadcoper' in a.yaml; did you mean Quadcopter",
        ),
        ({"tasks": ["cart:"]}, r"expected tasks\[0\]"),
        ({"methods": ["human", "eureca"]}, r"expected methods\[1\] .*did you mean eureka\?"),
        ({"ablations": ["without-fusoin"]}, r"expected ablations\[0\] .*did you mean without-fusion"),
        ({"name": "../a"}, "expected name to be letters, digits"),
        ({"seeds": [1, 1]}, "expected every entry once in a.yaml, found Quadcopter-porse-1 twice"),
        ({"entries": [{"task": "Quadcopter", "method": "porse", "seed": 1}]}, "found Quadcopter-porse-1 twice"),
        ({"entries": [{"task": "Over", "method": "porse"}]}, re.escape("expected the parameter entries[0].seed")),
        ({"entries": ["Over"]}, re.escape("expected entries[0] to be a mapping, found 'Over'")),
        ({"overrides": {"seed": 2}}, "expected overrides to leave seed alone in a.yaml, found 2"),
        ({"overrides": ["seed"]}, "expected overrides to be a value of type dict"),
    ],
)
def test_what_a_file_must_not_say_is_refused(changed, message):
    with pytest.raises(ParamsError, match=message):
        names(**changed)


def test_a_file_that_is_missing_or_no_yaml_is_refused(tmp_path):
    with pytest.raises(ParamsError, match="found no such file"):
        load_suite(tmp_path / "none.yaml")
    (tmp_path / "bad.yaml").write_text("tasks: [")
    with pytest.raises(ParamsError, match="expected YAML in"):
        load_suite(tmp_path / "bad.yaml")


def test_the_suites_of_the_project_are_fine(root):
    for path in (root / "suites").glob("*.yaml"):
        assert load_suite(path).name == path.stem
        resolve(load_suite(path), root, "", str(path))


def test_the_beta_sweep_is_figure_6_and_nothing_but_beta_differs_in_it(root):
    resolved = resolve(load_suite(root / "suites" / "beta-sweep.yaml"), root, "", "beta-sweep.yaml")
    assert len(resolved) == 2 * 7 * 5
    entries = [parse_params(each.params, each.entry.name) for each in resolved]
    # R_g : R_e of the figure, with Eureka's and LLMCount's ends
    weights = {each.entry.variant: params.candidate for each, params in zip(resolved, entries, strict=True)}
    assert {name: (round(own.scale - own.beta, 6), own.beta) for name, own in weights.items()} == {
        "2-to-0": (2.0, 0.0),
        "1.5-to-0.5": (1.5, 0.5),
        "1.2-to-0.8": (1.2, 0.8),
        "1-to-1": (1.0, 1.0),
        "0.8-to-1.2": (0.8, 1.2),
        "0.5-to-1.5": (0.5, 1.5),
        "0-to-2": (0.0, 2.0),
    }
    # One policy of 3000 epochs each, and no mutant to change beta.
    assert {total_epochs(params) for params in entries} == {3000}
    for task in ("DoorOpenInward", "TwoCatchUnderarm"):
        own = [params for params in entries if params.task == task]
        alike = [dataclasses.replace(p, candidate=dataclasses.replace(p.candidate, beta=1.0), seed=1) for p in own]
        assert len({repr(params) for params in alike}) == 1


def test_overrides_merge_mappings_and_replace_everything_else():
    document = {"train": {"gamma": 0.9, "hidden": [64, 64]}, "seed": 1, "rungs": [1, 2]}
    overrides = {"train": {"hidden": [8]}, "rungs": [3]}
    assert laid_over(document, overrides) == {"train": {"gamma": 0.9, "hidden": [8]}, "seed": 1, "rungs": [3]}
    assert document["train"]["hidden"] == [64, 64]


@pytest.fixture
def project(tmp_path) -> Path:
    """A project of three tracked files: its parameters, its stages, and the code of one of them."""
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(tiny.committed_params()))
    (tmp_path / "dvc.yaml").write_text("stages: {a: {cmd: x, deps: [code, presets, run/start]}}")
    (tmp_path / "iterations" / "1").mkdir(parents=True)
    (tmp_path / "iterations" / "1" / "dvc.yaml").write_text("of an entry")
    (tmp_path / "iterations" / "1" / "dvc.lock").write_text("of an entry")
    (tmp_path / "code").mkdir()
    (tmp_path / "code" / "a.py").write_text("1")
    (tmp_path / "README.md").write_text("text")
    (tmp_path / "llm_cache").mkdir()
    (tmp_path / "llm_cache" / "reply.json").write_text("{}")
    (tmp_path / "presets").mkdir()
    for task in ("Quadcopter", "Over", "SwingCup", "Kettle"):
        shutil.copy(tiny.ROOT / "presets" / f"{task}.yaml", tmp_path / "presets")
    tiny.run(tmp_path, "git", "init", "-q")
    tiny.run(tmp_path, "git", "add", "-A")
    return tmp_path


def test_the_code_is_what_stages_depend_on_as_it_is_now(project):
    def code() -> str:
        return code_id(project, tracked_files(project))

    presets = [f"presets/{task}.yaml" for task in ("Kettle", "Over", "Quadcopter", "SwingCup")]
    assert tracked_files(project) == ["README.md", "code/a.py", "dvc.yaml", *presets]
    before = code()
    (project / "README.md").write_text("other text")
    (project / "code" / "scratch.py").write_text("not tracked")
    assert code() == before
    (project / "code" / "a.py").write_text("2")
    changed = code()
    (project / "code" / "a.py").unlink()
    assert len({before, changed, code()}) == 3


def test_published_runs_are_not_carried_into_clones(project):
    before = tracked_files(project)
    (project / "published" / "a").mkdir(parents=True)
    (project / "published" / "a" / "card.md").touch()
    tiny.run(project, "git", "add", "-A")
    assert tracked_files(project) == before


def test_outside_a_repository_it_says_so(tmp_path):
    with pytest.raises(PorseError, match="expected a Git repository"):
        tracked_files(tmp_path)


def test_an_entry_has_the_values_of_the_file_the_suite_and_itself(project):
    suite = parse_suite(
        {
            **PLAIN,
            "overrides": {"train": {"gamma": 0.5, "clip": 0.3}},
            "entries": [{"task": "Over", "method": "eureka", "seed": 7, "overrides": {"train": {"gamma": 0.6}}}],
        },
        "a.yaml",
    )
    first, second = resolve(suite, project, "code", "a.yaml")
    assert [first.params[key] for key in ("task", "method", "ablation", "seed")] == ["Quadcopter", "porse", "none", 1]
    assert [second.params[key] for key in ("task", "method", "ablation", "seed")] == ["Over", "eureka", "none", 7]
    assert (first.params["train"]["gamma"], first.params["train"]["clip"]) == (0.5, 0.3)
    assert (second.params["train"]["gamma"], second.params["train"]["clip"]) == (0.6, 0.3)
    rest = [{key: value for key, value in each.params["train"].items() if key != "gamma"} for each in (first, second)]
    assert canonical_json(rest[0]) == canonical_json(rest[1])
    assert first.ids["params"] != second.ids["params"]


def test_a_preset_is_a_value_of_the_entries_of_its_task_alone(project):
    suite = parse_suite({**PLAIN, "tasks": ["Quadcopter", "Over"]}, "a.yaml")

    def ids() -> list[dict[str, str]]:
        code = code_id(project, tracked_files(project))
        return [entry.ids for entry in resolve(suite, project, code, "a.yaml")]

    before, path = ids(), project / "presets" / "Over.yaml"
    path.write_text(path.read_text().replace("gamma: 0.96", "gamma: 0.9"))
    after = ids()
    assert after[0] == before[0]
    assert (after[1]["params"] != before[1]["params"], after[1]["code"]) == (True, before[1]["code"])


def test_overrides_that_make_no_parameters_name_the_entry(project):
    suite = parse_suite({**PLAIN, "overrides": {"train": {"gama": 0.5}}}, "a.yaml")
    with pytest.raises(ParamsError, match=r"overrides of Quadcopter-porse-1 in a.yaml, found train.gama; did you mean"):
        resolve(suite, project, "code", "a.yaml")


def test_a_suite_runs_once_at_a_time(tmp_path):
    path = tmp_path / "suite" / "lock"
    assert not is_locked(path)
    with locked(path):
        assert is_locked(path)
        with pytest.raises(PorseError, match="expected that nobody else runs this suite"), locked(path):
            pass
    assert not is_locked(path)


def test_a_cluster_has_as_many_entries_as_it_has_room_for_each_in_a_clone_of_its_own(project, monkeypatch):
    suite = parse_suite({**PLAIN, "seeds": [1, 2, 3]}, "a.yaml")
    folders, together = folders_of("a", project), threading.Barrier(2, timeout=60)
    seen: dict[str, tuple[Path, str, list[str]]] = {}

    def reproduce(work: Path, log: Path, lock: int, warm: dict[str, str]) -> int:
        name = read_json(work.parent / "current.json")["entry"]
        if not name.endswith("3"):
            # Nobody passes who is alone.
            together.wait()
        states = [each.state for each in suite_status(suite, project, "a.yaml")]
        together.wait() if not name.endswith("3") else None
        seen[name] = (work, warm["RAY_ADDRESS"], states)
        log.write_text("Error: gone\n")
        for made in ("metrics.json", "params.yaml", "dvc.lock", "results/a.parquet", "run/result/start/b"):
            (work / made).parent.mkdir(parents=True, exist_ok=True)
            (work / made).write_text("{}")
        return int(name.endswith("2"))

    @contextmanager
    def ray_here() -> Iterator[Here]:
        yield Here({"RAY_ADDRESS": "10.0.0.1:6379"}, 13, 0)

    monkeypatch.setattr(suite_run, "uses_ray", lambda: True)
    monkeypatch.setattr(suite_run, "ray_here", ray_here)
    monkeypatch.setattr(suite_run, "warm_server", lambda profile: nullcontext({"WARM": profile}))
    monkeypatch.setattr(suite_run, "new_clone", lambda work, root: work.mkdir(parents=True))
    monkeypatch.setattr(suite_run, "fill_clone", lambda *arguments: None)
    monkeypatch.setattr(suite_run, "_reproduce", reproduce)
    monkeypatch.setattr("porse.suite.status.read_figures", lambda result: {})
    said: list[str] = []
    # 13 CPUs are room for two entries of six candidates.
    assert suite_run.run_suite(suite, project, "a.yaml", said.append) == ["Quadcopter-porse-2"]
    assert {work for work, _, _ in seen.values()} == {folders.clone_of(name).work for name in seen}
    assert {address for _, address, _ in seen.values()} == {"10.0.0.1:6379"}
    assert seen["Quadcopter-porse-1"][2] == ["running", "running", "waiting"]
    assert [each.state for each in suite_status(suite, project, "a.yaml")] == ["done", "failed", "done"]
    # What is done needs no clone any more; what failed goes on there.
    assert [path.name for path in (folders.suite / "clones").iterdir()] == ["Quadcopter-porse-2"]
    assert "[2/3] Quadcopter-porse-2: failed: gone" in said


@pytest.mark.parametrize(
    ("ends", "starts"),
    [
        (["ERROR: failed to reproduce 'resolve': unable to remove 'inputs/fuse.json' without a confirmation.", ""], 2),
        ([*(f"unable to remove '{name}' without a confirmation." for name in "abc"), ""], 3),
        (["Error: gone", ""], 1),
        (["", "Error: gone"], 1),
    ],
)
def test_an_entry_starts_again_when_another_suite_wrote_the_same_object(tmp_path, monkeypatch, ends, starts):
    log, left = tmp_path / "log", list(ends)

    def reproduce(work: Path, log: Path, lock: int, warm: dict[str, str]) -> int:
        log.write_text(end := left.pop(0))
        return 7 if end else 0

    monkeypatch.setattr(suite_run, "_reproduce", reproduce)
    code = suite_run._reproduce_in_company(tmp_path, log, 5, {})
    assert len(ends) - len(left) == starts
    # The log and the code are those of the last start.
    assert log.read_text() == ends[starts - 1]
    assert code == (7 if ends[starts - 1] else 0)


def test_entries_are_reckoned_by_the_candidates_that_they_begin_with(project):
    variants = {"six": {}, "seven": {"generate": {"candidates": 7}}}
    entries = resolve(parse_suite({**PLAIN, "variants": variants}, "a.yaml"), project, "code", "a.yaml")
    # Of different ones the largest counts.
    rooms = [suite_run.entries_at_once(Here({}, cpus, 15), entries) for cpus in (2, 13, 14, 21)]
    assert rooms == [1, 1, 2, 3]
    on_gpu = [dataclasses.replace(each, params={**each.params, "device": "cuda:0"}) for each in entries]
    assert suite_run.entries_at_once(Here({}, 64, 15), on_gpu) == 2


def figures(
    mts: float,
    hns: float | None = None,
    std: float | None = None,
    share: float | None = None,
    failed: int = 0,
    budget: float | None = None,
) -> dict:
    # By hand: four fifths of MTS; three fifths, between two fifths and six fifths.
    score = 0.8 * mts
    return {
        "score": score,
        "mts": mts,
        "hns_lineage": hns,
        "hns_budget": budget,
        "success": 0.6 * mts,
        "success_low": 0.4 * mts,
        "success_high": 1.2 * mts,
        "evaluation_failed": failed,
        "evaluation_score_mean": score,
        "evaluation_score_std": std,
        "evaluation_mts_mean": mts,
        "evaluation_mts_std": std,
        "epochs_spent": 90,
        "epochs_allowed": 2700,
        "valid_share": share,
    }


CUPS = {
    "name": "cups",
    "tasks": ["SwingCup"],
    "methods": ["human", "sparse", "human-budget", "sparse-budget", "porse"],
    "ablations": ["none", "without-bonus"],
    "seeds": [1, 2],
    "entries": [{"task": "Kettle", "method": method, "seed": 1} for method in ("human", "sparse")],
}
DONE = {
    "SwingCup-human-1": figures(0.025),
    "SwingCup-human-2": figures(0.03, hns=0.5),
    "SwingCup-sparse-1": figures(0.001),
    "SwingCup-human-budget-1": figures(0.205),
    "SwingCup-sparse-budget-1": figures(0.005),
    "SwingCup-porse-1": figures(0.995, hns=9.0, std=0.01, share=0.75, budget=8.0),
    "SwingCup-porse-2": figures(0.985, hns=7.5, failed=1, budget=2.25),
    "Kettle-human-1": figures(0.2),
    "Kettle-sparse-1": figures(0.2),
}

TABLE = """\
entry                           state     score  MTS    HNS        HNS (budget)  success                 evaluation       epochs   valid
SwingCup-human-1                done      0.020  0.025  1.00       0.10          0.015 (0.010 to 0.030)  0.020            90/2700  -
SwingCup-human-2                done      0.024  0.030  0.50       undefined     0.018 (0.012 to 0.036)  0.024            90/2700  -
SwingCup-sparse-1               done      0.001  0.001  0.00       -0.02         0.001 (0.000 to 0.001)  0.001            90/2700  -
SwingCup-sparse-2               failed    -      -      -          -             -                       -                -        -
SwingCup-human-budget-1         done      0.164  0.205  8.50       1.00          0.123 (0.082 to 0.246)  0.164            90/2700  -
SwingCup-human-budget-2         waiting   -      -      -          -             -                       -                -        -
SwingCup-sparse-budget-1        done      0.004  0.005  0.17       0.00          0.003 (0.002 to 0.006)  0.004            90/2700  -
SwingCup-sparse-budget-2        waiting   -      -      -          -             -                       -                -        -
SwingCup-porse-1                done      0.796  0.995  41.42      4.95          0.597 (0.398 to 1.194)  0.796 +- 0.010   90/2700  0.75
SwingCup-porse-2                done      0.788  0.985  7.50       2.25          0.591 (0.394 to 1.182)  0.788, 1 failed  90/2700  -
SwingCup-porse-without-bonus-1  outdated  -      -      -          -             -                       -                -        -
SwingCup-porse-without-bonus-2  waiting   -      -      -          -             -                       -                -        -
Kettle-human-1                  done      0.160  0.200  undefined  undefined     0.120 (0.080 to 0.240)  0.160            90/2700  -
Kettle-sparse-1                 done      0.160  0.200  undefined  undefined     0.120 (0.080 to 0.240)  0.160            90/2700  -

SwingCup-sparse-2 failed: expected water, found none

task      method         ablation  seeds  score           MTS
SwingCup  human          none      2      0.022 +- 0.003  0.028 +- 0.004
SwingCup  sparse         none      1      0.001           0.001
SwingCup  human-budget   none      1      0.164           0.205
SwingCup  sparse-budget  none      1      0.004           0.005
SwingCup  porse          none      2      0.792 +- 0.006  0.990 +- 0.007
Kettle    human          none      1      0.160           0.200
Kettle    sparse         none      1      0.160           0.200"""
"""By hand: (0.995 - 0.001) / (0.025 - 0.001) = 41.4166..., and with the whole budget (0.995 - 0.005) / (0.205 - 0.005) = 4.95;
(0.025 - 0.005) / 0.2 = 0.1, (0.205 - 0.001) / 0.024 = 8.5, (0.005 - 0.001) / 0.024 = 0.1666..., and (0.001 - 0.005) / 0.2 = -0.02.
Seed 2 has no sparse entry, so that its HNS are the run's own; the Kettle's references are equal. The deviation of 0.995 and 0.985
is sqrt(2 x 0.005^2) = 0.00707, that of their scores 0.796 and 0.788 is sqrt(2 x 0.004^2) = 0.00566, and that of 0.025 and 0.03
is sqrt(2 x 0.0025^2) = 0.00354 about 0.0275, of 0.02 and 0.024 sqrt(2 x 0.002^2) = 0.00283."""


@pytest.fixture
def cups(project, monkeypatch) -> Path:
    """A project whose suite `cups.yaml` has hand-made results: figures where tables would be."""
    for module in ("status", "diff"):
        monkeypatch.setattr(f"porse.suite.{module}.read_figures", lambda folder: read_json(folder / "metrics.json"))
    (project / "cups.yaml").write_text(yaml.safe_dump(CUPS))
    folders = folders_of("cups", project)
    code = code_id(project, tracked_files(project))
    for each in resolve(load_suite(project / "cups.yaml"), project, code, "cups.yaml"):
        folder = folders.result(each.entry.name)
        if each.entry.name in DONE:
            write_json(folder / "metrics.json", DONE[each.entry.name])
            write_json(folder / "done.json", each.ids)
        elif each.entry.name == "SwingCup-sparse-2":
            lines = ["Running stage", "Error: expected water, found none", "ERROR: failed to reproduce 'train'"]
            write_json(folder / "failed.json", {**each.ids, "exit_code": 1, "last_lines": lines})
        elif each.entry.name == "SwingCup-porse-without-bonus-1":
            write_json(folder / "metrics.json", figures(0.5))
            write_json(folder / "done.json", {**each.ids, "code": "other"})
    return project


def test_the_status_of_hand_made_results_is_this_table(cups):
    entries = rows(suite_status(load_suite(cups / "cups.yaml"), cups, "cups.yaml"))
    assert status_text(entries) == TABLE


def test_variants_are_summed_up_apart():
    row = {
        "entry": "a",
        "task": "Kettle",
        "method": "porse",
        "ablation": "none",
        "seed": 1,
        "state": "done",
        "reason": None,
    }
    row |= dict.fromkeys(("hns_lineage", "hns_budget"))
    row |= {"success": 0.5, "success_low": 0.25, "success_high": 0.75}
    row |= dict.fromkeys(f"evaluation_{name}" for name in ("score_mean", "score_std", "mts_mean", "mts_std", "failed"))
    row |= {"epochs_spent": 1, "epochs_allowed": 1, "score": 0.125}
    entries = [row | {"variant": name, "mts": mts, "valid_share": None} for name, mts in (("", 0.25), ("half", 0.75))]
    assert status_text(entries).splitlines()[-2:] == [
        "Kettle  porse   none      -        1      0.125  0.250",
        "Kettle  porse   none      half     1      0.125  0.750",
    ]


def test_the_status_as_json_has_the_unrounded_figures(cups, monkeypatch):
    monkeypatch.chdir(cups)
    done = CliRunner().invoke(main, ["suite", "status", "cups.yaml", "--json"], catch_exceptions=False)
    printed = json.loads(done.output)
    by_name = {row["entry"]: row for row in printed["entries"]}
    assert by_name["SwingCup-porse-1"]["hns_lineage"] == pytest.approx(41.41667, abs=1e-5)
    assert by_name["SwingCup-porse-1"]["hns_budget"] == pytest.approx(4.95)
    assert by_name["SwingCup-porse-1"]["evaluation_score_std"] == 0.01
    assert by_name["SwingCup-porse-2"]["evaluation_failed"] == 1
    assert by_name["Kettle-human-1"]["hns_lineage"] is None
    assert by_name["SwingCup-sparse-2"]["reason"] == "expected water, found none"
    assert printed["summary"][4] == {
        "task": "SwingCup", "method": "porse", "ablation": "none", "variant": "", "seeds": 2,
        "score_mean": pytest.approx(0.792), "score_std": pytest.approx(0.0056569, abs=1e-7),
        "mts_mean": pytest.approx(0.99), "mts_std": pytest.approx(0.0070711, abs=1e-7),
    }  # fmt: skip


def test_what_differs_from_earlier_results_is_this_table(cups, monkeypatch):
    folders = folders_of("cups", cups)
    # Half an MTS and a third of the epochs more; the same; and one that is outdated now.
    for name, before in (
        ("SwingCup-human-1", figures(0.0125, hns=0.25) | {"epochs_spent": 60}),
        ("Kettle-human-1", figures(0.2)),
        ("SwingCup-porse-without-bonus-1", figures(0.25, share=0.5)),
    ):
        write_json(folders.earlier(name) / "metrics.json", before)
        write_json(folders.earlier(name) / "done.json", {})
    # One that had failed has no figures.
    write_json(folders.earlier("Kettle-sparse-1") / "failed.json", {})
    monkeypatch.chdir(cups)
    done = CliRunner().invoke(main, ["suite", "status", "cups.yaml", "--diff"], catch_exceptions=False)
    assert done.output == DIFFERENCES
    done = CliRunner().invoke(main, ["suite", "status", "cups.yaml", "--diff", "--json"], catch_exceptions=False)
    found = json.loads(done.output)
    assert found[1] == {
        "entry": "SwingCup-human-1", "figure": "mts", "before": 0.0125, "now": 0.025, "change": pytest.approx(0.0125),
    }  # fmt: skip
    shutil.rmtree(folders.earlier("").parent / "earlier")
    done = CliRunner().invoke(main, ["suite", "status", "cups.yaml", "--diff"], catch_exceptions=False)
    assert done.output == "nothing differs from earlier results, or no entry has run again\n"


DIFFERENCES = """\
entry                           figure                 before  now    change
SwingCup-human-1                score                  0.010   0.020  0.010
SwingCup-human-1                mts                    0.013   0.025  0.013
SwingCup-human-1                hns_lineage            0.250   1.000  0.750
SwingCup-human-1                success                0.007   0.015  0.007
SwingCup-human-1                evaluation_score_mean  0.010   0.020  0.010
SwingCup-human-1                epochs_spent           60      90     30
SwingCup-porse-without-bonus-1  score                  0.200   -      -
SwingCup-porse-without-bonus-1  mts                    0.250   -      -
SwingCup-porse-without-bonus-1  success                0.150   -      -
SwingCup-porse-without-bonus-1  evaluation_score_mean  0.200   -      -
SwingCup-porse-without-bonus-1  epochs_spent           90      -      -
SwingCup-porse-without-bonus-1  valid_share            0.500   -      -
"""


def test_what_the_code_of_a_stage_no_longer_is_makes_every_result_outdated(cups):
    (cups / "code" / "a.py").write_text("2")
    entries = rows(suite_status(load_suite(cups / "cups.yaml"), cups, "cups.yaml"))
    assert {row["state"] for row in entries if row["entry"] in DONE} == {"outdated"}
    assert "SwingCup-porse-1                outdated  -" in status_text(entries)


def tiny_params() -> dict:
    params = tiny.committed_params()
    params["generate"] |= {"candidates": 2, "elites": 1}
    params["validate"] |= {"probe_envs": 8, "probe_steps": 8}
    params["train"] |= {"num_envs": 4, "steps_per_epoch": 4, "rung_epochs": 1, "hidden": [8], "minibatches": 2}
    params["iterations"] = [{"n": 1, "next": "result"}]
    params["rungs"] = [
        {"rung": 1, "pool": "validate-code", "until": 1, "keep": 1},
        {"rung": "mutants", "pool": "mutate", "until": 1, "keep": 1},
    ]
    params["mutate"] |= {"pool": "eliminate-1", "mutants": 1}
    params["fuse"]["pool"] = "eliminate-mutants"
    params["evaluate"] |= {"seeds": 1, "episodes": 8}
    return params


HOLDING = """#!/bin/sh
case "$*" in "-m stages.fuse "*) if [ -e {hold} ]; then echo $$ > {hold}.pid; mv {hold}.pid {held}; exec sleep 600; fi;; esac
exec {python} "$@"
"""


class Running:
    """A tiny project in which a stage `fuse` waits forever while the file `hold` is there."""

    def __init__(self, folder: Path, venv: Path) -> None:
        self.hold, self.held = folder / "hold", folder / "held"
        python = folder / "venv" / "bin" / "python"
        python.parent.mkdir(parents=True)
        python.write_text(HOLDING.format(hold=self.hold, held=self.held, python=venv / "bin" / "python"))
        python.chmod(0o755)
        self.project = tiny.make_project(folder / "a project", tiny_params(), folder / "venv")
        tiny.run(self.project, "git", "add", "-A")
        self.write("porse", {"task": "Quadcopter", "method": "eureka", "seed": 1, "overrides": {"generator": "model"}})

    def write(self, *methods: str | dict) -> None:
        """Writes the suite: the first method combined, then an entry that fails, if given, then `sparse`."""
        first, *failing = methods
        entries = [*failing, {"task": "Quadcopter", "method": "sparse", "seed": 1}]
        suite = {**PLAIN, "methods": [first], "overrides": {"generator": "grammar"}, "entries": entries}
        (self.project / "a.yaml").write_text(yaml.safe_dump(suite))

    def suite(self, *words: str, **environment: str) -> subprocess.CompletedProcess[str]:
        return tiny.run(self.project, str(tiny.BIN / "porse"), "suite", *words, check=False, **environment)

    def states(self) -> list[str]:
        return [each.state for each in suite_status(load_suite(self.project / "a.yaml"), self.project, "a.yaml")]

    def kill_in_fuse(self) -> list[str]:
        """Starts the suite, kills it when its first entry has come to `fuse`, and returns the states just before."""
        self.hold.touch()
        command = [str(tiny.BIN / "porse"), "suite", "run", "a.yaml"]
        environment = {**os.environ, **tiny.QUIET}
        process = subprocess.Popen(command, cwd=self.project, env=environment, stdout=subprocess.DEVNULL)
        deadline = time.monotonic() + 120
        while not self.held.exists():
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
        states = self.states()
        process.send_signal(signal.SIGKILL)
        process.wait()
        os.kill(int(self.held.read_text()), signal.SIGKILL)
        self.hold.unlink()
        # DVC ends with the suite, a moment later.
        while is_locked(folders_of("a", self.project).lock):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        return states


@pytest.fixture
def running(tmp_path) -> Iterator[Running]:
    (tmp_path / "warm").mkdir()
    with warm_stages(tmp_path / "warm") as venv:
        yield Running(tmp_path, venv)


def test_a_suite_resumes_records_failures_and_skips_what_is_done(running):
    project, folders = running.project, folders_of("a", running.project)
    before = tiny.run(project, "git", "status", "--porcelain").stdout

    assert running.kill_in_fuse() == ["running", "waiting", "waiting"]
    assert running.states() == ["partial", "waiting", "waiting"]

    done = running.suite("run", "a.yaml")
    assert done.returncode == 1
    assert "found 1 that failed: Quadcopter-eureka-1" in done.stderr
    assert running.states() == ["done", "failed", "done"]
    # What was trained before the kill is not trained again.
    ran = re.findall(r"Running stage '([^']+)'", folders.log("Quadcopter-porse-1").read_text())
    assert ran == ["iterations/1/dvc.yaml:fuse", "evaluate", "summarise"]
    result = folders.result("Quadcopter-porse-1")
    figures = read_figures(result)
    assert figures["functions"] > 0
    assert json.loads((result / "metrics.json").read_text())["mts"] == figures["mts"]
    assert yaml.safe_load((result / "params.yaml").read_text())["generator"] == "grammar"
    assert yaml.safe_load((result / "dvc.lock").read_text())["stages"]["summarise"]
    assert (result / "results" / "curves.parquet").is_file()
    assert policy_file(result / "run" / "result" / "start", BEST).is_file()
    record = json.loads((result / "logs" / "environment.json").read_text())
    assert (record["python"], record["MKL_CBWR"]) == (platform.python_version(), "COMPATIBLE")
    failed = json.loads((folders.result("Quadcopter-eureka-1") / "failed.json").read_text())
    assert any("Expected a recorded reply in llm_cache" in line for line in failed["last_lines"])

    # The failed entry alone is tried again; its mode comes from the environment, its questions go to the project.
    again = running.suite("run", "a.yaml", PORSE_LLM_MODE="batch")
    assert again.returncode == 1
    assert again.stdout.count("was done before") == 2
    # Why it failed is one line here.
    assert re.search(r"found none for 2: \w+ .* They are written to \.porse/pending", again.stdout)
    assert len(list((project / ".porse" / "pending").iterdir())) == 2

    running.write("porse")
    skipped = running.suite("run", "a.yaml")
    assert skipped.returncode == 0
    assert skipped.stdout.splitlines() == [
        "[1/2] Quadcopter-porse-1: was done before",
        "[2/2] Quadcopter-sparse-1: was done before",
    ]
    # The project itself is as it was.
    assert tiny.run(project, "git", "status", "--porcelain").stdout == before
    assert not (project / "run").exists()
    assert not (project / "metrics.json").exists()

    # A run in the project finds all of it in the cache, which they share, and ends with the same lock.
    result = folders.result("Quadcopter-sparse-1")
    (project / "params.yaml").write_bytes((result / "params.yaml").read_bytes())
    assert tiny.run(project, str(tiny.BIN / "porse"), "pipeline", "--check").returncode == 0
    assert "Running stage" not in tiny.dvc(project, "repro").stdout
    for lock in ("dvc.lock", "iterations/1/dvc.lock"):
        assert (project / lock).read_bytes() == (result / lock).read_bytes()
    assert (project / "metrics.json").read_bytes() == (result / "metrics.json").read_bytes()

    # With longer epochs it runs again, and what came out before is kept beside it.
    before = json.loads((result / "metrics.json").read_text())
    again = {**PLAIN, "methods": ["sparse"], "overrides": {"generator": "grammar", "train": {"steps_per_epoch": 8}}}
    (project / "a.yaml").write_text(yaml.safe_dump(again))
    assert running.suite("run", "a.yaml").returncode == 0
    found = json.loads(running.suite("status", "a.yaml", "--diff", "--json").stdout)
    now = json.loads((result / "metrics.json").read_text())
    assert {(row["before"], row["now"]) for row in found if row["figure"] == "mts"} == {(before["mts"], now["mts"])}
    assert before["mts"] != now["mts"]
