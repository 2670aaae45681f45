"""What the processes of trainings may use, in which order they start, and what is told of them: real ones, whose work is a stand-in."""

import dataclasses
import fcntl
import json
import os
import re
import signal
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

import porse.training.bar as bar_module
import porse.training.candidate as candidate_module
import porse.training.executor as executor_module
import porse.training.limits as limits_module
import porse.training.local as local_module
from porse.errors import CheckpointError, lacks_memory
from porse.training.bar import PLAN_VARIABLE, PROGRESS_VARIABLE, TENSORBOARD_VARIABLE, RungBar, in_words
from porse.training.executor import EXECUTOR_VARIABLE, executor_from_environment
from porse.training.inline import Inline
from porse.training.job import Job, Outcome, Report
from porse.training.limits import MEMORY_VARIABLE, SILENCE_VARIABLE, WORKERS_VARIABLE, Limits, limits_from_environment
from porse.training.local import Local
from porse.training.population import train_pool
from porse.training.reason import last_words, plain, reason_of

pytestmark = pytest.mark.timeout(30)


@pytest.fixture(autouse=True)
def _nothing_set(monkeypatch):
    for name in (WORKERS_VARIABLE, MEMORY_VARIABLE, SILENCE_VARIABLE, EXECUTOR_VARIABLE):
        monkeypatch.delenv(name, raising=False)


def jobs(folder: Path, names: str) -> list[Job]:
    """Jobs that are told apart by their names, with an epoch more for each."""
    return [
        Job(name, "", "", 0.7, folder / "start", folder / f"{name}.safetensors", 1 + place, 5)
        for place, name in enumerate(names)
    ]


def ended_well(job, params, report):
    job.finish.parent.mkdir(parents=True, exist_ok=True)
    job.finish.write_text(f"trained {job.name}")
    return Outcome([(job.until, "fitness", float(job.until))], "")


@pytest.fixture
def works(monkeypatch):
    """Puts a function in the place of a training."""
    return lambda train: monkeypatch.setattr(candidate_module, "train_candidate", train)


def outcomes_of(executor, given, small):
    """What the executor tells, by name: the epochs with their fitness, and the outcome."""
    reports: dict[str, list[tuple[int, float]]] = {}
    ends: dict[str, Outcome] = {}

    def tell(event):
        if isinstance(event, Report):
            reports.setdefault(event.name, []).append((event.epoch, event.fitness))
        else:
            assert event.name not in ends
            ends[event.name] = event.outcome

    executor.run(given, small, tell)
    with pytest.raises(ChildProcessError):
        os.waitpid(-1, os.WNOHANG)
    return reports, ends


def wait_for(holds):
    deadline = time.monotonic() + 20
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def local(workers=2, crowd=2, memory_mib=500, silence_s=20):
    return Local(Limits(workers, crowd, memory_mib, silence_s))


# Limits.


def test_without_variables_all_cpus_share_the_memory_and_an_epoch_may_take_ten_minutes(monkeypatch):
    asked = []
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: asked.append(process) or {1, 4, 6})
    monkeypatch.setattr(limits_module, "memory_mib", lambda: 1000)
    # 2 x 3 - 1; 1000 / 3, cut
    assert limits_from_environment() == Limits(workers=3, crowd=5, memory_mib=333, silence_s=600)
    assert set(asked) == {0}
    monkeypatch.setattr(limits_module, "memory_mib", lambda: 2)
    assert limits_from_environment().memory_mib == 1


def test_limits_are_what_the_variables_say(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2})
    monkeypatch.setattr(limits_module, "memory_mib", lambda: 1000)
    monkeypatch.setenv(WORKERS_VARIABLE, "2")
    # one of the three CPUs stays free; 1000 / 2
    assert limits_from_environment() == Limits(2, 2, 500, 600)
    monkeypatch.setenv(WORKERS_VARIABLE, "4")
    assert limits_from_environment() == Limits(4, 4, 250, 600)
    monkeypatch.setenv(MEMORY_VARIABLE, "70")
    monkeypatch.setenv(SILENCE_VARIABLE, "999999999")
    assert limits_from_environment() == Limits(4, 4, 70, 999_999_999)
    monkeypatch.setenv(SILENCE_VARIABLE, "1000000000")
    with pytest.raises(limits_module.ParamsError, match="from 1 to 999999999, found '1000000000'"):
        limits_from_environment()


@pytest.mark.parametrize("value", ["0", "00", "-1", "two", "1.5", " 1", "\u0663"])
def test_a_limit_is_a_whole_number_from_1_on(monkeypatch, value):
    monkeypatch.setenv(WORKERS_VARIABLE, "1")
    assert limits_module.workers() == 1
    monkeypatch.setenv(WORKERS_VARIABLE, value)
    with pytest.raises(limits_module.ParamsError, match=f"expected {WORKERS_VARIABLE} to be a whole number from 1"):
        limits_module.workers()


@pytest.mark.parametrize(("known", "cpus"), [(7, 7), (None, 1)])
def test_where_the_system_does_not_say_which_cpus_a_process_may_use_all_are_used(monkeypatch, known, cpus):
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: known)
    assert limits_module.workers() == cpus


@pytest.mark.parametrize(("value", "kind"), [("", Local), ("local", Local), ("inline", Inline)])
def test_trainings_have_processes_of_their_own_unless_the_variable_says_inline(monkeypatch, value, kind):
    monkeypatch.setenv(EXECUTOR_VARIABLE, value)
    assert type(executor_from_environment()) is kind


@pytest.mark.parametrize("value", ["a", "k", "process", "zz"])
def test_another_executor_is_refused_wherever_it_lies_in_the_alphabet(monkeypatch, value):
    monkeypatch.setenv(EXECUTOR_VARIABLE, value)
    with pytest.raises(executor_module.ParamsError, match="to be local, inline or ray"):
        executor_from_environment()


# Memory.


@pytest.mark.parametrize(("taken", "failure"), [(70, ""), (700, "refused")])
def test_a_training_may_take_so_much_memory_beyond_what_it_began_with(works, small, tmp_path, taken, failure):
    def train(job, params, report):
        try:
            block = bytearray(taken * 2**20)
        except MemoryError:
            return Outcome([], "refused")
        return Outcome([], "" if len(block) else "empty")

    works(train)
    _, ends = outcomes_of(local(memory_mib=100), jobs(tmp_path, "a"), small)
    assert ends == {"a": Outcome([], failure)}


# Time.


def test_silence_is_what_passed_since_the_last_report_and_may_be_as_long_as_the_limit(works, small, tmp_path):
    started, go = tmp_path / "started", tmp_path / "go"

    def train(job, report):
        report(1, -0.5)
        started.touch()
        wait_for(go.exists)
        report(2, -0.25)
        print("rotor 3 waits", flush=True)
        time.sleep(60)

    training = local_module._start(jobs(tmp_path, "a")[0], train, Limits(1, 1, 500, 1), [])
    told = []
    try:
        training.read_news(told.append)
        wait_for(started.exists)
        # 0.75 + 0.25 = 1 s, which it may take
        assert training.outcome(0.75, 1.0) is None
        assert training.outcome(0.25, 1.0) is None
        go.touch()
        training.read_news(told.append)
        assert [(event.epoch, event.fitness) for event in told] == [(1, -0.5), (2, -0.25)]
        assert training.outcome(1.0, 1.0) is None
        wait_for(lambda: local_module._is_waiting(training.output))
        training.read_output()
        found = training.outcome(0.25, 1.0)
    finally:
        training.end()
    assert found == Outcome(
        [], r"its process made no progress for 1.0 s, after epoch 2; it printed last: rotor 3 waits", outside=True
    )


def test_who_hangs_is_ended_and_the_others_go_on(works, small, tmp_path):
    def train(job, params, report):
        if job.name == "b":
            time.sleep(60)
        return Outcome([], "")

    works(train)
    begun = time.monotonic()
    _, ends = outcomes_of(local(silence_s=1), jobs(tmp_path, "ab"), small)
    assert ends == {
        "a": Outcome([], ""),
        "b": Outcome([], "its process made no progress for 1 s, before it had done an epoch", outside=True),
    }
    assert 1.0 < time.monotonic() - begun < 25


@pytest.mark.parametrize(("between", "counted"), [(3600.0, 1.0), (0.25, 0.25)])
def test_a_pause_of_this_process_is_nobodys_silence(works, small, tmp_path, monkeypatch, between, counted):
    class Clock:
        """So much time passes between any two looks at it."""

        now = 8.0 - between

        def monotonic(self):
            self.now += between
            return self.now

    passed = []
    real = local_module._Training.outcome

    def outcome(training, passed_s, silence_s):
        passed.append(passed_s)
        return real(training, passed_s, silence_s)

    works(lambda job, params, report: Outcome([], ""))
    monkeypatch.setattr(local_module, "time", Clock())
    monkeypatch.setattr(local_module._Training, "outcome", outcome)
    outcomes_of(local(), jobs(tmp_path, "a"), small)
    # an hour counts as two ticks of half a second
    assert set(passed) == {counted}


# Order.


def test_three_share_two_cpus_where_no_more_are_left_than_may():
    assert [local(workers=2, crowd=3).room(left) for left in (6, 5, 4, 3, 2, 1)] == [2, 2, 2, 3, 2, 1]


def test_trainings_start_in_their_order_and_as_many_run_at_once_as_there_is_room_for(
    works, small, tmp_path, monkeypatch
):
    book = tmp_path / "book"

    def note(text):
        with book.open("a") as file:
            file.write(text)

    def alone(job, params, report):
        note(f"+{job.name}")
        time.sleep(0.1)
        note(f"-{job.name}")
        return Outcome([], "")

    works(alone)
    outcomes_of(local(workers=1, crowd=1), jobs(tmp_path, "bca"), small)
    assert book.read_text() == "+b-b+c-c+a-a"
    book.unlink()

    def together(job, params, report):
        note(f"+{job.name}")
        beside = "ed" if job.name in "ed" else "cba"
        wait_for(lambda: all(f"+{name}" in book.read_text() for name in beside))
        time.sleep(0.2)
        note(f"-{job.name}")
        return Outcome([], "")

    asked = []
    room = Local.room
    monkeypatch.setattr(Local, "room", lambda self, left: asked.append(left) or room(self, left))
    # two of five, two of four, and the last three at once
    works(together)
    _, ends = outcomes_of(local(workers=2, crowd=3), jobs(tmp_path, "edcba"), small)
    assert {name for name, outcome in ends.items() if outcome == Outcome([], "")} == set("edcba")
    assert asked[:3] == [5, 5, 5]
    text = book.read_text()
    running = [text[: end + 1].count("+") - text[: end + 1].count("-") for end in range(len(text))]
    assert max(running[: text.index("+c") + 1]) == 2
    assert max(running) == 3
    assert sorted(text[1:4:2]) == ["d", "e"]


def test_outcomes_are_in_the_order_of_the_jobs_whoever_ends_first(works, small, tmp_path, monkeypatch):
    after = {"a": "", "c": "a", "b": "c"}

    def train(job, params, report):
        before = tmp_path / f"{after[job.name]}.done"
        wait_for(lambda: not after[job.name] or before.exists())
        time.sleep(0.1)
        (tmp_path / f"{job.name}.done").touch()
        return ended_well(job, params, report)

    works(train)
    monkeypatch.setenv(WORKERS_VARIABLE, "3")
    found = train_pool(jobs(tmp_path, "bca"), small, lambda event: None)
    assert [outcome.rows for outcome in found] == [[(n, "fitness", float(n))] for n in (1, 2, 3)]
    assert {path.name: path.read_text() for path in tmp_path.glob("*.safetensors")} == {
        f"{name}.safetensors": f"trained {name}" for name in "abc"
    }


def test_only_who_failed_from_outside_is_tried_once_more_and_only_who_ends_well_leaves_a_file(
    works, small, tmp_path, monkeypatch
):
    seen = []

    def train(job, params, report):
        seen.append(job.name)
        done = ended_well(job, params, report)
        first = seen.count(job.name) == 1
        return {
            "a": done,
            "b": Outcome([], "its reward was not finite"),
            "c": Outcome([], "killed", outside=True) if first else done,
            "d": Outcome([], f"killed {seen.count('d')}", outside=True),
        }[job.name]

    works(train)
    monkeypatch.setenv(EXECUTOR_VARIABLE, "inline")
    found = train_pool(jobs(tmp_path, "abcd"), small, lambda event: None)
    assert seen == ["a", "b", "c", "d", "c", "d"]
    assert [outcome.failure for outcome in found] == ["", "its reward was not finite", "", "killed 2"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.safetensors", "c.safetensors"]
    assert train_pool([], small, lambda event: None) == []
    assert not Outcome([], "").outside


# What is told.


@pytest.mark.parametrize("executor", [local(), Inline()])
def test_reports_and_outcomes_arrive_whole(works, small, tmp_path, executor):
    # more than one read's 65 536 bytes
    rows = [(epoch, "fitness", epoch / 3) for epoch in range(1, 5001)]

    def train(job, params, report):
        for epoch in (1, 2, 3):
            report(epoch, epoch / 3 if job.name == "a" else -epoch / 7)
        return Outcome(rows, "it failed" if job.name == "b" else "", outside=False)

    works(train)
    reports, ends = outcomes_of(executor, jobs(tmp_path, "ab"), small)
    assert reports == {"a": [(1, 1 / 3), (2, 2 / 3), (3, 1.0)], "b": [(1, -1 / 7), (2, -2 / 7), (3, -3 / 7)]}
    assert ends == {"a": Outcome(rows, ""), "b": Outcome(rows, "it failed")}


def ends_with(code):
    def end():
        print("one\n\ntwo", flush=True)
        print("  three\nfour", file=sys.stderr, flush=True)
        os._exit(code)

    return end


def raises():
    raise ValueError("rotor 3")


def terminated():
    # Whoever runs the tests may have asked for something else.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.kill(os.getpid(), signal.SIGTERM)


@pytest.mark.parametrize(
    ("end", "says"),
    [
        (
            ends_with(3),
            r"its process ended by itself with code 3, after epoch 1; it printed last: two \| three \| four",
        ),
        (
            ends_with(0),
            r"its process ended by itself with code 0, after epoch 1; it printed last: two \| three \| four",
        ),
        (terminated, r"its process was ended by SIGTERM, after epoch 1"),
        (lambda: os.kill(os.getpid(), 40), r"its process was ended by signal 40, after epoch 1"),
        (raises, r"its process ended by itself with code 1, after epoch 1; it printed last: .*ValueError: rotor 3"),
    ],
)
def test_how_a_process_ended_is_said(works, small, tmp_path, end, says):
    def train(job, params, report):
        report(1, 0.0)
        end()

    works(train)
    # Where nothing else is running, nobody's end is taken for another's.
    _, ends = outcomes_of(local(), jobs(tmp_path, "a"), small)
    assert ends["a"].rows == []
    assert ends["a"].outside
    assert re.fullmatch(says, ends["a"].failure)


def test_code_of_ones_own_runs_in_the_trainings_alone(works, small, tmp_path):
    works(lambda job, params, report: Outcome([], ""))
    mine = dataclasses.replace(small, task="nowhere_to_be_found:Task")
    assert outcomes_of(local(), jobs(tmp_path, "a"), mine)[1] == {"a": Outcome([], "")}


def test_one_that_ends_before_an_epoch_says_so_and_what_it_printed_last_is_cut(works, small, tmp_path):
    def train(job, params, report):
        sys.stdout.write("x" * 300_000 + "\nlast " + "y" * 5000)
        sys.stdout.flush()
        os._exit(2)

    works(train)
    _, ends = outcomes_of(local(), jobs(tmp_path, "a"), small)
    # of 5 005 letters the last 4 096 are kept, and of those a sentence has 400
    says = "its process ended by itself with code 2, before it had done an epoch; it printed last: "
    assert ends["a"].failure == says + "y" * 397 + "..."


def ended(training):
    """What is told of a training whose process ends, of which nothing was read yet."""
    found = None

    def look():
        nonlocal found
        training.closed = True
        found = training.outcome(0.0, 99.0)
        return found

    try:
        wait_for(look)
    finally:
        training.end()
    return found.failure


@pytest.mark.skipif(not hasattr(fcntl, "F_SETPIPE_SZ"), reason="only Linux makes a pipe larger")
def test_what_a_process_left_in_its_pipe_is_read_when_it_has_ended(tmp_path):
    def train(job, report):
        # The most that an unprivileged process may ask for, of which it leaves 300 000 bytes: several reads.
        fcntl.fcntl(1, fcntl.F_SETPIPE_SZ, 1 << 20)
        sys.stdout.write("x" * 300_000 + "y" * 5000)
        sys.stdout.flush()
        os._exit(2)

    says = "its process ended by itself with code 2, before it had done an epoch; it printed last: "
    training = local_module._start(jobs(tmp_path, "a")[0], train, Limits(1, 1, 500, 1), [])
    # the last 4 096 letters are kept, and of those a sentence has 400
    assert ended(training) == says + "y" * 397 + "..."


def test_who_else_writes_to_the_pipe_of_one_that_ended_is_not_waited_for(tmp_path):
    def train(job, report):
        if os.fork():
            os._exit(2)
        try:
            while True:
                os.write(1, b"more and more\n" * 4000)
        finally:
            os._exit(0)

    training = local_module._start(jobs(tmp_path, "a")[0], train, Limits(1, 1, 500, 1), [])
    begun = time.monotonic()
    assert ended(training).startswith(
        "its process ended by itself with code 2, before it had done an epoch; it printed"
    )
    assert time.monotonic() - begun < 25


def test_an_error_of_the_program_is_raised_here_and_the_others_are_ended(works, small, tmp_path):
    def train(job, params, report):
        if job.name == "a":
            time.sleep(20)
        raise CheckpointError("it is damaged")

    works(train)
    with pytest.raises(CheckpointError, match=r"^it is damaged$"):
        outcomes_of(local(), jobs(tmp_path, "ab"), small)
    with pytest.raises(ChildProcessError):
        os.waitpid(-1, os.WNOHANG)


@pytest.mark.parametrize("executor", ["local", "inline"])
def test_an_error_of_the_program_ends_a_pool_and_leaves_no_file(works, small, tmp_path, monkeypatch, executor):
    def train(job, params, report):
        if job.name == "b":
            raise CheckpointError("it is damaged")
        return ended_well(job, params, report)

    works(train)
    monkeypatch.setenv(EXECUTOR_VARIABLE, executor)
    monkeypatch.setenv(WORKERS_VARIABLE, "1")
    with pytest.raises(CheckpointError, match=r"^it is damaged$"):
        train_pool(jobs(tmp_path, "abc"), small, lambda event: None)
    assert list(tmp_path.iterdir()) == []


def test_a_reason_is_cut_beyond_400_letters_and_shows_three_lines():
    assert plain("x" * 400) == "x" * 400
    assert plain("x" * 401) == "x" * 397 + "..."
    assert last_words("one\n two \n\nthree\nfour\n") == "two | three | four"
    assert reason_of(ValueError("odd")) == "ValueError: odd"
    assert reason_of(ValueError()) == "ValueError"
    assert [lacks_memory(error) for error in (MemoryError(), RuntimeError("DefaultCPUAllocator: not enough memory"), RuntimeError("odd"))] == [True, True, False]  # fmt: skip


# The bar.


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands still until it is moved."""
    hands = SimpleNamespace(now=5.0, time=time.time)
    hands.monotonic = lambda: hands.now
    monkeypatch.setattr(bar_module, "time", hands)
    for name in (PROGRESS_VARIABLE, PLAN_VARIABLE, TENSORBOARD_VARIABLE):
        monkeypatch.delenv(name, raising=False)
    return hands


def told(label, monkeypatch, tmp_path, clock, reports):
    """A rung of 3 candidates and 3 epochs of 100 steps, the third of 9 stages, with 20 epochs after it; seen 10 s after its start."""
    plan = {"bars": {"rung 1": {"stage": 3, "epochs_after": 20}}, "stages": 9, "epochs": 30}
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    monkeypatch.setenv(PLAN_VARIABLE, str(tmp_path / "plan.json"))
    with RungBar(label, 3, 3, 100) as bar:
        clock.now = 15.0
        for report in reports:
            bar.tell(report)


FALLING = [Report("a", 1, -0.5), Report("b", 1, -0.2), Report("a", 2, -0.7), Report("b", 2, -0.9)]


def test_the_time_left_is_that_of_all_epochs_to_come_at_this_rungs_speed(monkeypatch, tmp_path, clock, capsys):
    monkeypatch.setenv(PROGRESS_VARIABLE, "json")
    told("rung 1", monkeypatch, tmp_path, clock, FALLING)
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    names = ("event", "epochs_done", "steps_per_second", "best_fitness", "seconds_left")
    assert [tuple(line[name] for name in names) for line in lines] == [
        ("rung", 0, 0.0, None, None),
        # (2 + 20) x 10 / 1, (1 + 20) x 10 / 2, 20 x 10 / 3; and an epoch more than was planned takes nothing off
        ("epoch", 1, 10.0, -0.5, 220.0),
        ("epoch", 2, 20.0, -0.2, 105.0),
        ("epoch", 3, 30.0, -0.2, 66.7),
        ("epoch", 4, 40.0, -0.2, 50.0),
        ("done", 4, 40.0, -0.2, 50.0),
    ]
    assert [(line["stage"], line["stages"], line["candidates"], line["epochs"]) for line in lines] == [(3, 9, 3, 3)] * 6


@pytest.mark.parametrize(("label", "head"), [("rung 1", "[3/9] rung 1"), ("another", "another")])
def test_a_rungs_line_says_stage_speed_and_best_fitness(monkeypatch, tmp_path, clock, capsys, label, head):
    told(label, monkeypatch, tmp_path, clock, FALLING[:3])
    assert capsys.readouterr().out == f"{head}: 3 candidates, 3 epochs, 30 steps/s, best fitness -0.200\n"


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(59.4, "59 s"), (60.0, "1 min"), (3569.0, "59 min"), (3571.0, "1 h 0 min"), (7500.0, "2 h 5 min")],
)
def test_a_length_of_time_is_in_its_own_units(seconds, words):
    assert in_words(seconds) == words


@pytest.mark.parametrize(
    ("candidates", "lines", "own"),
    [(1, 40, False), (2, 40, True), (12, 40, True), (13, 40, False), (5, 10, True), (6, 10, False)],
)
def test_each_of_a_few_candidates_has_a_bar_where_the_terminal_has_room(monkeypatch, candidates, lines, own):
    monkeypatch.setenv("LINES", str(lines))
    bars = bar_module._Bars("[3/9]", 40, 4, "rung", candidates, 9)
    for fitness in (-0.5, -0.2, -0.9):
        bars.advance("a", "said", "left", fitness)
    run, rung, *each = bars._progress.tasks
    assert (run.description, run.total, run.completed, run.fields["said"]) == ("[3/9]", 40, 7, "left")
    assert (rung.description, rung.total, rung.completed, rung.fields["said"]) == ("rung", 9, 3, "said")
    assert [(bar.description, bar.total, bar.completed, bar.fields["said"]) for bar in each] == (
        [("  a", 9 / candidates, 3, "best fitness -0.200")] if own else []
    )
