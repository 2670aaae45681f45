"""`porse estimate`: the arithmetic worked out by hand, the measurement's plumbing, and the paper's size of every task."""

import dataclasses
import json

import pytest
from click.testing import CliRunner

from porse import estimate
from porse.cli import main
from porse.config import load_document, parse_params
from porse.errors import ParamsError
from porse.estimate import Effort, Measured, changed, effort_of, measure, measured_size, rung_s
from porse.pipeline import check_pipeline
from porse.search.schedule import total_epochs, work
from porse.task_names import TASK_CLASSES
from tiny import ROOT

MEASURED = Measured(step_s=0.002, fixed_bytes=1000, env_bytes=10.0, series=13, observations=17, actions=5)


@pytest.fixture(scope="module")
def document():
    return load_document(ROOT / "params.yaml")


def paper(document, task: str):
    return parse_params(changed(document, [f"task={task}", "size=paper"]), "params.yaml", ROOT)


@pytest.mark.parametrize(
    ("candidates", "at_once", "crowd", "rounds"),
    [
        # Two CPUs that three may share: 5 are a round of two, and three in one and a half.
        (5, 2, 3, 2.5),
        (6, 2, 3, 3.0),
        (4, 2, 3, 2.0),
        (3, 2, 3, 1.5),
        (1, 2, 3, 1.0),
        (0, 2, 3, 0.0),
        # Four that nobody shares: 6 are four and two.
        (6, 4, 4, 2.0),
        (4, 4, 4, 1.0),
    ],
)
def test_a_rung_takes_rounds_and_the_last_ones_share(candidates, at_once, crowd, rounds):
    assert rung_s(candidates, 7.0, at_once, crowd) == rounds * 7.0


def test_a_run_of_the_default_schedule_by_hand(params):
    train = dataclasses.replace(params.train, rung_epochs=7, num_envs=3, steps_per_epoch=11)
    found = effort_of(dataclasses.replace(params, train=train), MEASURED, 2, 3, 52, 30)
    # An iteration: 6 + 5 + 4 + 5 x 3 + 3 + 2 + 1 = 36 rungs; an evaluation of 2 seeds x 5 links x 6.
    assert (found.search_epochs, found.evaluation_epochs) == (5 * 36 * 7, 2 * 5 * 6 * 7)
    assert found.steps == 240 * 7 * 33
    # Rounds: 3 + 2.5 + 2 + 2.5 x 3 + 1.5 + 1 + 1 = 18.5 of an iteration, and 6 of each link.
    assert found.seconds == pytest.approx((5 * 18.5 + 5 * 6) * 7 * 33 * 0.002)
    # Checkpoints of 1030 bytes, of an iteration: new 6 + 5 + 4 + 5 + 3 + 2 + 1 = 26 in the cache; in the folders of trained pools
    # 6 + 5 + 4 + 9 + 3 + 2 + 1 = 30, of survivors 5 + 4 + 4 + 3 + 2 + 1 + 1 = 20, and 4 in that of the mutants.
    # Epochs in the tables: 6 + 10 + 12 + 27 + 12 + 10 + 6 = 83 rungs, 5 + 8 + 12 + 9 + 8 + 5 + 6 = 53, and 4 x 3 = 12.
    assert found.disk_bytes == 5 * (80 * 1030 + 2 * 148 * 7 * 13 * 10)
    # 3 x 11 steps x 4 bytes x (2 x 17 + 3 x 5 + 8), and the rest, are less than a MiB.
    assert (found.memory_mib, found.steps_per_second) == (0, 500.0)
    assert (found.replies, found.recorded, found.at_once) == (52, 30, 2)


def test_alphas_that_are_searched_cost_probes_and_leave_them_in_the_pool(params):
    probe = dataclasses.replace(params.probe, trainings=4, share=0.4, least_epochs=1)
    train = dataclasses.replace(params.train, rung_epochs=10, num_envs=3, steps_per_epoch=11)
    some = dataclasses.replace(params, probe=probe, train=train, iterations=params.iterations[:2])
    # From iteration 2 on, each of 6 candidates has 3 probes more, of 4 epochs.
    assert [cost.epochs for cost in (work(some, 1)[0], work(some, 2)[0])] == [60, 60 + 6 * 3 * 4]
    first, second = estimate._pools(some, 1)[0], estimate._pools(some, 2)[0]
    assert (first, second) == ((6, 6, 60), (24, 24, 240))


def test_a_run_without_a_search_and_one_candidate_counts_its_one_training(document):
    params = parse_params(changed(document, ["method=human-budget"]), "params.yaml", ROOT)
    found = effort_of(params, MEASURED, 4, 4, 0, 0)
    # One policy, six rungs of 16 epochs, times 5 iterations, times 6 candidates; two further seeds, side by side.
    assert (found.search_epochs, found.evaluation_epochs) == (16 * 6 * 30, 2 * 16 * 6 * 30)
    assert found.seconds == pytest.approx(2 * 16 * 6 * 30 * 4096 * 0.002)


def test_more_than_a_day_is_said(params):
    found = Effort(1, 1, 1, 1.0, 3, 86_400.0, 1, 1, 1, 1)
    assert found.warning == ""
    assert "about 62 h 0 min with 3 at once, more than a day" in dataclasses.replace(found, seconds=62 * 3600.0).warning


@pytest.mark.parametrize("task", TASK_CLASSES)
def test_the_papers_size_of_every_task_has_the_papers_schedule(task, document):
    params = paper(document, task)
    # Algorithm 1 with H = 500: 500 (6 + 5 + 4) + 5 x 1500 + 500 (3 + 2 + 1), five times.
    assert [sum(cost.epochs for cost in work(params, entry.n)) for entry in params.iterations] == [18_000] * 5
    assert total_epochs(params) == 90_000
    # The committed pipeline is this one's, too: `dvc exp run -S task=... -S size=paper` starts it.
    check_pipeline(ROOT, params)
    found = effort_of(params, MEASURED, 2, 3, 0, 0)
    assert found.steps == 120_000 * params.train.num_envs * params.train.steps_per_epoch
    # An epoch that is measured is a short one, of whole minibatches.
    count = measured_size(params)
    assert params.train.num_envs % count == 0
    assert count * params.train.steps_per_epoch <= 4096
    assert count * params.train.steps_per_epoch % params.train.minibatches == 0


def test_a_measurement_counts_steps_bytes_and_series_of_a_real_training(small):
    one = measure(small, 0.0)
    train = dataclasses.replace(small.train, num_envs=16)
    two = measure(dataclasses.replace(small, train=train), 0.0)
    assert 0.0 < one.step_s < 1.0
    assert (one.observations, one.actions) == (21, 12)
    assert one.series >= 4
    # What grows with the environments is counted by the environment; the networks do not.
    assert two.env_bytes == pytest.approx(one.env_bytes, rel=0.1)
    assert two.fixed_bytes == pytest.approx(one.fixed_bytes, rel=0.02)


@pytest.mark.parametrize(
    ("assignment", "says"),
    [
        ("task", r"expected NAME=VALUE after -S, found 'task'"),
        (
            "train.gama=3",
            r"expected a parameter of params\.yaml after -S, found train\.gama; did you mean train\.gamma",
        ),
        ("taks=3", r"found taks; did you mean task\?"),
        ("trian.gamma=3", r"found trian\.gamma; did you mean train\.gamma"),
        ("seed.x.yz.xyz=3", r"found seed\.x\.yz\.xyz; `porse params` prints all"),
        ("task=[", r"expected YAML in the value of task after -S"),
    ],
)
def test_what_is_no_parameter_is_refused(assignment, says, document):
    with pytest.raises(ParamsError, match=says):
        changed(document, [assignment])
    before = json.dumps(document)
    assert changed(document, ["train.gamma=0.9", "seed=3"])["train"]["gamma"] == 0.9
    assert json.dumps(document) == before


def test_the_command_says_all_of_it_and_warns(root, monkeypatch):
    monkeypatch.setattr(estimate, "measure", lambda params, seconds: MEASURED)
    monkeypatch.chdir(root)
    words = ["estimate", "-S", "task=Over", "-S", "size=paper", "-S", "generator=grammar", "--workers", "3"]
    done = CliRunner().invoke(main, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert done.stdout.splitlines()[:3] == [
        "Over, size paper, method porse",
        "epochs   120,000: 90,000 of the search, 30,000 of the evaluation",
        "steps    1,966,080,000 environment steps",
    ]
    assert "replies  0 questions to a model" in done.stdout
    assert "warning: the trainings alone take about" in done.stderr
    done = CliRunner().invoke(main, ["estimate", "--json"], catch_exceptions=False)
    found = json.loads(done.stdout)
    # The default run: K = 6 rewards and mappings, an elite from iteration 2 on, a question at each half time; all recorded.
    assert (found["replies"], found["recorded"]) == (57, 57)
    assert (found["search_epochs"], found["steps_per_second"], found["warning"]) == (2880, 500.0, "")
