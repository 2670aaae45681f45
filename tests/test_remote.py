"""Trainings on other machines, without Ray: machines are processes of this one, and some of them are lost."""

import dataclasses
import json
import os
import signal
import sys
import threading
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from pathlib import Path

import pytest

from porse.checkpoint import read_checkpoint, write_checkpoint
from porse.config import document_of, parse_part
from porse.errors import CheckpointError, ParamsError, PorseError
from porse.training import cluster, executor
from porse.training.cluster import machine_environment, run_errand
from porse.training.executor import EXECUTOR_VARIABLE, executor_from_environment
from porse.training.inline import Inline
from porse.training.job import Ended, Job, Outcome, Report
from porse.training.limits import CHECKPOINT_VARIABLE, Limits
from porse.training.local import Local
from porse.training.node import job_document, job_of
from porse.training.parts import FIRST, last_part, part_length, train_in_parts
from porse.training.remote import LOSSES, Errand, LostError, Remote, _Training, stdout_of
from porse.training.start import random_policy
from samples import MAPPING, NOT_FINITE, RAISES, REWARD, program

pytestmark = pytest.mark.timeout(900)

LIMITS = Limits(workers=2, crowd=2, memory_mib=600, silence_s=120)
UNTIL = FIRST + 5
"""More than a part and a half."""


class Threads:
    """Machines that are threads of this process. Each starts a process for its errand, which may be killed.

    Attributes:
        given: the errands, with the epoch of the last whole part when each was given.
    """

    def __init__(self) -> None:
        self.given: list[tuple[Errand, int]] = []

    @contextmanager
    def open(self):
        yield self

    def start(self, errand: Errand) -> Future:
        part = last_part(Path(json.loads(errand.stdin)["folder"]))
        self.given.append((errand, part.epoch if part else 0))
        future: Future = Future()
        thread = threading.Thread(
            target=lambda: future.set_result(run_errand(dataclasses.asdict(errand), 2)), daemon=True
        )
        thread.start()
        return future

    def ended(self, handles, timeout_s):
        return [*wait(handles, timeout_s, FIRST_COMPLETED).done]

    def answer(self, handle):
        return stdout_of(handle.result())

    def stop(self, handle):
        for process in children():
            os.kill(process, signal.SIGKILL)


def children() -> set[int]:
    return {int(p) for path in Path("/proc/self/task").glob("*/children") for p in path.read_text().split()}


@pytest.fixture
def start(small, tmp_path) -> Path:
    path = tmp_path / "start.safetensors"
    write_checkpoint(path, random_policy(small, 1))
    return path


def job(name: str, start: Path, out: Path, seed: int = 1, reward: str = REWARD, until: int = UNTIL) -> Job:
    out.mkdir(exist_ok=True)
    return Job(name, program(reward), program(MAPPING), 1.0, start, out / f"{name}.safetensors", until, seed)


def trained(run, jobs, params) -> tuple[dict[str, Outcome], list[Report]]:
    """Returns the outcomes by name, and what was reported."""
    ends, reports = {}, []

    def tell(event):
        if isinstance(event, Ended):
            assert event.name not in ends
            ends[event.name] = event.outcome
        else:
            reports.append(event)

    run.run(jobs, params, tell)
    return ends, reports


@pytest.mark.parametrize(
    ("left", "pace_s", "every_s", "expected"),
    [
        # Nothing is known: 8; 12 are less than 8 and half of it more.
        (100, 0.0, 600, 8),
        (12, 0.0, 600, 12),
        (13, 0.0, 600, 8),
        # 30 s / 0.7 s are 42 epochs; 63 are done at once.
        (100, 0.7, 30, 42),
        (63, 0.7, 30, 63),
        (64, 0.7, 30, 42),
        # An epoch that takes longer than a part is a part.
        (5, 90.0, 30, 1),
        (1, 90.0, 30, 1),
    ],
)
def test_a_part_is_as_long_as_fits_between_two_checkpoints(left, pace_s, every_s, expected):
    assert part_length(left, pace_s, every_s) == expected


def test_a_training_in_parts_leaves_the_bytes_and_the_rows_of_one_at_once(small, start, tmp_path):
    whole, apart = job("whole", start, tmp_path / "out"), job("apart", start, tmp_path / "out")
    ends, reports = trained(Inline(), [whole], small)
    folder = tmp_path / "parts"
    folder.mkdir()
    lengths = []

    def run(part, params, tell):
        lengths.append((part.begun, part.until))
        # One checkpoint is left at any time, and what it is named after.
        assert len(list(folder.iterdir())) == (0 if part.begun == 0 else 2)
        Inline().run([part], params, tell)

    told = []
    outcome = train_in_parts(apart, small, folder, 0, 1e-9, run, told.append)
    # An epoch takes longer than a nanosecond: after the first part, one at a time.
    assert lengths == [(0, 8), (8, 9), (9, 10), (10, 11), (11, 12), (12, 13)]
    assert outcome == ends["whole"]
    assert apart.finish.read_bytes() == whole.finish.read_bytes()
    assert [(report.epoch, report.fitness) for report in told] == [(r.epoch, r.fitness) for r in reports]


def test_another_attempt_goes_on_after_the_last_whole_part(small, start, tmp_path):
    whole, apart = job("whole", start, tmp_path / "out"), job("apart", start, tmp_path / "out")
    ends, _ = trained(Inline(), [whole], small)
    folder = tmp_path / "parts"
    folder.mkdir()

    class Gone(Exception):
        pass

    def run(part, params, tell):
        if part.until == 10:
            # Cut off in the middle of its writing: no part.
            (folder / "0-10.partial").write_text('{"epoch": 10, "ro')
            (folder / "0-10.safetensors").write_bytes(b"half")
            raise Gone
        Inline().run([part], params, tell)

    with pytest.raises(Gone):
        train_in_parts(apart, small, folder, 0, 1e-9, run, lambda event: None)
    assert last_part(folder).epoch == 9
    told = []

    def again(part, params, tell):
        Inline().run([part], params, tell)

    outcome = train_in_parts(apart, small, folder, 1, 600, again, told.append)
    assert [report.epoch for report in told] == [10, 11, 12, 13]
    assert outcome == ends["whole"]
    assert apart.finish.read_bytes() == whole.finish.read_bytes()


def test_a_part_that_fails_says_what_the_whole_would_say(small, start, tmp_path):
    folder = tmp_path / "parts"
    folder.mkdir()

    def run(part, params, tell):
        if part.begun == 0:
            Inline().run([part], params, tell)
            return
        # It waits for its start forever, and reports nothing; the whole training had reported 8 epochs.
        os.mkfifo(tmp_path / "never")
        silent = Local(dataclasses.replace(LIMITS, silence_s=1))
        silent.run([dataclasses.replace(part, start=tmp_path / "never")], params, tell)

    outcome = train_in_parts(job("one", start, tmp_path / "out"), small, folder, 0, 1e-9, run, lambda event: None)
    assert outcome == Outcome([], "its process made no progress for 1 s, after epoch 8", outside=True)


def test_on_other_machines_candidates_end_as_they_end_here_failures_word_by_word(small, start, tmp_path):
    def jobs(folder: Path) -> list[Job]:
        return [
            job("good", start, folder, 1),
            job("bad", start, folder, 2, NOT_FINITE),
            job("worse", start, folder, 4, RAISES),
        ]

    here, reports = trained(Local(LIMITS), jobs(tmp_path / "here"), small)
    machines = Threads()
    there, told = trained(Remote(LIMITS, 600, machines.open), jobs(tmp_path / "there"), small)
    assert there == here
    assert there["bad"].failure.startswith("its reward was not finite")
    assert sorted(told, key=str) == sorted(reports, key=str)
    for folder in ("here", "there"):
        assert [path.name for path in (tmp_path / folder).iterdir()] == ["good.safetensors"]
    assert (tmp_path / "there" / "good.safetensors").read_bytes() == (
        tmp_path / "here" / "good.safetensors"
    ).read_bytes()
    assert len(machines.given) == 3


def test_a_machine_that_is_lost_is_replaced_and_the_candidate_goes_on_after_its_last_checkpoint(small, start, tmp_path):
    until = 120
    here, _ = trained(Local(LIMITS), [job("one", start, tmp_path / "here", until=until)], small)
    machines, killed = Threads(), []
    reports: list[Report] = []
    ends = {}

    def tell(event):
        if isinstance(event, Ended):
            ends[event.name] = event.outcome
            return
        reports.append(event)
        if not killed and event.epoch > FIRST + 1:
            killed.append(children().pop())
            os.kill(killed[0], signal.SIGKILL)

    one = job("one", start, tmp_path / "there", until=until)
    Remote(LIMITS, 10, machines.open).run([one], small, tell)
    assert ends == here
    assert one.finish.read_bytes() == (tmp_path / "here" / "one.safetensors").read_bytes()
    # The first order began at the start, the second after a checkpoint; and every epoch was told once, in order.
    assert len(machines.given) == 2
    assert machines.given[0][1] == 0
    assert FIRST <= machines.given[1][1] < until
    assert [report.epoch for report in reports] == list(range(1, until + 1))


def test_who_loses_machine_after_machine_stops_with_a_sentence(small, start, tmp_path):
    class Never(Threads):
        def ended(self, handles, timeout_s):
            return handles

        def answer(self, handle):
            raise LostError("NodeDiedError: gone")

        def start(self, errand):
            self.given.append((errand, 0))
            return len(self.given)

        def stop(self, handle):
            raise AssertionError("nothing is left")

    machines = Never()
    with pytest.raises(PorseError, match="6 were lost under it, the last one so: NodeDiedError: gone"):
        Remote(LIMITS, 600, machines.open).run([job("one", start, tmp_path / "out")], small, lambda event: None)
    assert len(machines.given) == LOSSES + 1
    assert [json.loads(errand.stdin)["attempt"] for errand, _ in machines.given] == [0, 1, 2, 3, 4, 5]
    assert list((tmp_path / "out").iterdir()) == []


def test_a_damaged_start_ends_the_run_and_stops_the_other_machines(small, start, tmp_path):
    (tmp_path / "bad.safetensors").write_bytes(b"{}")
    jobs = [
        job("good", start, tmp_path / "out", until=10**6),
        job("bad", tmp_path / "bad.safetensors", tmp_path / "out"),
    ]
    with pytest.raises(CheckpointError, match="a damaged file"):
        Remote(LIMITS, 600, Threads().open).run(jobs, small, lambda event: None)
    assert list((tmp_path / "out").iterdir()) == []


def test_a_machine_without_the_project_says_so(small, start, tmp_path):
    errand = Errand((str(tmp_path / "python"),), str(tmp_path), {}, "", str(tmp_path / "stderr"))
    assert "expected" in run_errand(dataclasses.asdict(errand), 1)["refused"]
    order = {
        "params": document_of(small), "folder": str(tmp_path / "nowhere"), "job": job_document(job("a", start, tmp_path)),
    }  # fmt: skip
    command = (sys.executable, "-m", "porse.training.node")
    errand = Errand(command, str(Path.cwd()), {}, json.dumps(order), str(tmp_path / "stderr"))
    answer = json.loads(run_errand(dataclasses.asdict(errand), 1)["stdout"])
    assert (answer["error"], "to be shared by all machines" in answer["text"]) == ("PorseError", True)


def test_a_process_on_a_machine_sees_no_key_and_its_share_of_the_memory(tmp_path, monkeypatch):
    monkeypatch.setenv("SOME_API_KEY", "secret")
    monkeypatch.setenv("RAY_AUTH_TOKEN", "secret")
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3")
    code = "import os, json; print(json.dumps(dict(os.environ)))"
    errand = Errand((sys.executable, "-c", code), str(tmp_path), {"PORSE_SILENCE_S": "7"}, "", str(tmp_path / "stderr"))
    seen = json.loads(run_errand(dataclasses.asdict(errand), 5)["stdout"])
    assert "secret" not in seen.values()
    assert (seen["CUDA_VISIBLE_DEVICES"], seen["PORSE_SILENCE_S"], seen["PORSE_WORKERS"]) == ("3", "7", "5")
    assert machine_environment({"PATH": "a", "OPENAI_API_KEY": "b", "WARP_CACHE_PATH": "c", "PORSE_LLM_MODE": "d"}) == {
        "PATH": "a", "WARP_CACHE_PATH": "c",
    }  # fmt: skip


def test_parameters_and_jobs_travel_as_json(params, start, tmp_path):
    assert parse_part(json.loads(json.dumps(document_of(params))), "x") == params
    part = parse_part({"seed": 3, "exploration": {"lambda": 0.7}, "rungs": [
        {"rung": "mutants", "pool": "mutate", "until": 3, "keep": 2},
    ]}, "x")  # fmt: skip
    assert document_of(part) == {
        "seed": 3, "exploration": {"lambda": 0.7},
        "rungs": [{"rung": "mutants", "pool": "mutate", "until": 3, "keep": 2}],
    }  # fmt: skip
    one = dataclasses.replace(job("a", start, tmp_path), begun=5, start=Path("start.safetensors"))
    back = job_of(json.loads(json.dumps(job_document(one))))
    assert back == dataclasses.replace(one, start=Path.cwd() / "start.safetensors")


def test_a_training_has_a_gpu_to_itself_where_its_device_is_one(small, start, tmp_path):
    training = _Training(job("one", start, tmp_path), tmp_path)
    orders = [training.errand(dataclasses.replace(small, device=on), 600) for on in ("cpu", "warp-cpu", "cuda:0")]
    assert [order.gpus for order in orders] == [0, 0, 1]


def test_ray_is_refused_where_it_is_not_installed_and_its_checkpoints_where_they_are_no_number(monkeypatch):
    monkeypatch.setenv(EXECUTOR_VARIABLE, "ray")
    monkeypatch.setattr(cluster.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ParamsError, match=r"expected the package ray .* requirements-ray\.lock"):
        executor_from_environment()
    monkeypatch.setattr(executor, "check_ray", lambda: None)
    assert isinstance(executor_from_environment(), Remote)
    monkeypatch.setenv(CHECKPOINT_VARIABLE, "often")
    with pytest.raises(ParamsError, match="expected PORSE_CHECKPOINT_S to be a whole number"):
        executor_from_environment()


def test_what_a_training_leaves_is_a_checkpoint_of_its_last_epoch(small, start, tmp_path):
    one = job("one", start, tmp_path / "out")
    Remote(LIMITS, 600, Threads().open).run([one], small, lambda event: None)
    assert read_checkpoint(one.finish).scalars["epoch"] == UNTIL


def test_a_folder_that_leaves_no_room_for_rays_sockets_is_refused_and_not_left_behind(tmp_path, monkeypatch):
    class Never:
        def shutdown(self):
            pass

    long = tmp_path / ("a" * 40)
    long.mkdir()
    monkeypatch.setenv("RAY_TMPDIR", str(long))
    with (
        pytest.raises(ParamsError, match=r"at most 42 bytes, .* set RAY_TMPDIR to a short path"),
        cluster._started(Never()),
    ):
        pytest.fail("it started")
    assert list(long.iterdir()) == []
