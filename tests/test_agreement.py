"""A row that is missing from a table of a finished run is noticed, whichever it is."""

import hashlib
import shutil

import pytest
import yaml
from click.testing import CliRunner

import kills
from at_once import run_at_once
from porse import tables
from porse.cli import main
from porse.config import parse_params
from porse.errors import PorseError
from porse.generation.states import checker
from porse.inputs.resolve import resolve_inputs
from porse.outdated import changed_parameters
from porse.report.results import read_results
from tiny import ROOT


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A tiny run of one iteration, with mutants and one further seed."""
    folder = tmp_path_factory.mktemp("agreement") / "run"
    with checker(parse_params(kills.tiny_params(), "a test")) as check:
        run_at_once(folder, kills.tiny_params(), check)
    return folder


@pytest.fixture
def copied(finished, tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    shutil.copy(finished / "params.yaml", folder)
    shutil.copytree(finished / "results", folder / "results")
    return folder


WRITTEN = [
    table for table in tables.TABLES.values() if table not in (tables.FEEDBACK, tables.MEMBERS, tables.MEMBER_FEEDBACK)
]


def test_a_finished_run_agrees_with_itself(copied):
    assert {path.stem for path in (copied / "results").iterdir()} == {table.name for table in WRITTEN}
    assert read_results(copied).iterations


@pytest.mark.parametrize("table", WRITTEN, ids=lambda table: table.name)
def test_a_missing_row_is_noticed_whichever_it_is(table, copied):
    path = copied / "results" / f"{table.name}.parquet"
    rows = tables.read(path, table)
    # All of a short table, some of a long one; an episode without an end has no length, so that such a row may be missing.
    rows_to_lose = [row for row in rows if row.get("series") != "episode_length"]
    step = max(1, len(rows_to_lose) // 12)
    for lost in [*rows_to_lose[::step], rows_to_lose[-1]]:
        tables.write(path, table, [row for row in rows if row is not lost])
        with pytest.raises(PorseError, match=r"agree with each other|among the candidates|expected an iteration"):
            read_results(copied)


def leave_inputs(folder, names, where):
    """Leaves the inputs that stages of the run in `folder` read, and a lock in `where` that names them, as DVC does."""
    deps = []
    for name in names:
        text = resolve_inputs(ROOT, yaml.safe_load((folder / "params.yaml").read_text()), "a test")[name].render()
        digest = hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()
        cached = folder / ".dvc" / "cache" / "files" / "md5" / digest[:2] / digest[2:]
        cached.parent.mkdir(parents=True, exist_ok=True)
        cached.write_text(text)
        deps.append({"path": f"inputs/{name}.json", "md5": digest})
    where.mkdir(parents=True, exist_ok=True)
    (where / "dvc.lock").write_text(yaml.safe_dump({"stages": {"a": {"cmd": "", "deps": deps}}}))


@pytest.mark.parametrize(
    "change",
    [
        {"evaluate": {"episodes": 9, "seeds": 2}},
        {"rungs": [{"rung": "only", "pool": "validate-code", "until": 1, "keep": 1}]},
        {"task": "Over", "method": "human", "train": {"rung_epochs": 7}},
    ],
    ids=lambda change: "-".join(change),
)
def test_results_are_read_with_what_the_run_was_made_with_and_a_warning(copied, change):
    then = read_results(copied)
    leave_inputs(copied, ("train-population", "evaluate", "summarise"), copied)
    original = yaml.safe_load((copied / "params.yaml").read_text())
    changed = {key: {**original[key], **value} if isinstance(value, dict) else value for key, value in change.items()}
    (copied / "params.yaml").write_text(yaml.safe_dump({**original, **changed}))
    now = read_results(copied)
    assert (now.figures, now.params.task) == (then.figures, "Quadcopter")
    assert (now.params.evaluate, now.params.rungs) == (then.params.evaluate, then.params.rungs)
    done = CliRunner().invoke(main, ["results", str(copied)], catch_exceptions=False)
    assert done.exit_code == 0
    assert "warning: these results are another run's" in done.stderr
    assert ("Over" in done.stderr) is ("task" in change)


def test_a_run_that_was_stopped_on_its_way_has_the_results_of_the_one_before(copied):
    original = (copied / "params.yaml").read_text()
    leave_inputs(copied, ("evaluate", "summarise"), copied)
    (copied / "params.yaml").write_text(original.replace("seed: ", "seed: 1", 1))
    # Of the new run, an iteration has been computed.
    leave_inputs(copied, ("generate", "train-population"), copied / "iterations" / "1")
    seed = yaml.safe_load(original)["seed"]
    assert read_results(copied).params.seed == seed
    assert changed_parameters(copied) == {"seed": (seed, int(f"1{seed}"))}


def test_a_row_of_another_run_is_noticed(copied):
    path = copied / "results" / "scores.parquet"
    first, *others = tables.read(path, tables.SCORES)
    tables.write(path, tables.SCORES, [{**first, "candidate_id": "stranger"}, *others])
    with pytest.raises(PorseError, match="found candidate stranger of iteration 1 in scores and not in candidates"):
        read_results(copied)


def test_episodes_of_another_candidate_than_the_winner_are_noticed(copied):
    winner = read_results(copied).evaluation.lineage[-1]["candidate_id"]
    candidates = tables.read(copied / "results" / "candidates.parquet", tables.CANDIDATES)
    other = next(row["candidate_id"] for row in candidates if row["candidate_id"] != winner)
    path = copied / "results" / "episodes.parquet"
    first, *others = tables.read(path, tables.EPISODES)
    tables.write(path, tables.EPISODES, [{**first, "candidate_id": other}, *others])
    with pytest.raises(PorseError, match=f"found candidate {other} in episodes, where {winner} is the run's winner"):
        read_results(copied)


def test_commands_that_read_a_run_say_so(copied, root, monkeypatch):
    monkeypatch.chdir(root)
    path = copied / "results" / "curves.parquet"
    rows = tables.read(path, tables.CURVES)
    lost = next(row for row in rows if row["series"] == "fitness")
    tables.write(path, tables.CURVES, [row for row in rows if row is not lost])
    for words in (["report", str(copied), "--out", str(copied / "page.html")], ["trends", str(copied)]):
        done = CliRunner().invoke(main, words, catch_exceptions=False)
        assert done.exit_code == 1
        assert "epochs of iteration 1 in iterations and" in done.output
        assert "rows of fitness in curves; rows were lost" in done.output
    assert not (copied / "page.html").exists()
