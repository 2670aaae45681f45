"""Trainings on a real Ray cluster, of one machine and of two, one of which is removed in the middle: the same bytes.

`make test-ray`, or `pytest -m ray`; where Ray is not installed they are skipped. Ray takes seconds to start: few tests, much in each.
"""

import contextlib
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest

from porse.checkpoint import write_checkpoint
from porse.errors import ParamsError, PorseError
from porse.training import remote
from porse.training.cluster import LOOPBACK_VARIABLE, MODE_VARIABLE, QUIET, TOKEN_VARIABLE, ray_here, ray_machines
from porse.training.executor import EXECUTOR_VARIABLE, executor_from_environment
from porse.training.job import Ended, Job, Report
from porse.training.limits import CHECKPOINT_VARIABLE, MEMORY_VARIABLE, WORKERS_VARIABLE
from porse.training.parts import FIRST, last_part
from porse.training.population import train_pool
from porse.training.remote import Errand
from porse.training.start import random_policy
from samples import MAPPING, NOT_FINITE, REWARD, program

pytestmark = [
    pytest.mark.ray,
    pytest.mark.skipif(find_spec("ray") is None, reason="Ray is not installed: `make ray` installs it"),
    pytest.mark.timeout(1200),
    # Ray leaves sockets, files and processes to the end of its session.
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]

UNTIL = 200
TOKEN = "0123456789abcdef" * 4
PATIENT = {
    "RAY_raylet_start_wait_time_s": "300",
    "RAY_gcs_rpc_server_connect_timeout_s": "60",
    "RAY_gcs_server_request_timeout_seconds": "300",
    "RAY_health_check_timeout_ms": "60000",
}
"""A machine that is busy with other work takes minutes to start Ray."""
LOOPBACK = {"127.0.0.1", "[::ffff:127.0.0.1]", "[::1]"}


@pytest.fixture(scope="module")
def start(small, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("start") / "start.safetensors"
    write_checkpoint(path, random_policy(small, 1))
    return path


@pytest.fixture
def environment(monkeypatch, tmp_path):
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setenv(WORKERS_VARIABLE, "2")
    monkeypatch.setenv(MEMORY_VARIABLE, "600")
    monkeypatch.setenv("SOME_API_KEY", "secret-of-the-driver")
    # Ray reads them when it is imported, and once for a process.
    monkeypatch.setenv(MODE_VARIABLE, "token")
    monkeypatch.setenv(LOOPBACK_VARIABLE, "0")
    monkeypatch.setenv(TOKEN_VARIABLE, TOKEN)
    for name, value in {**QUIET, **PATIENT}.items():
        monkeypatch.setenv(name, value)
    return monkeypatch


@pytest.fixture
def short() -> Iterator[Path]:
    """A folder whose path leaves room for the names of Ray's sockets."""
    with tempfile.TemporaryDirectory(prefix="r", dir="/tmp") as folder:
        yield Path(folder)


def jobs(start: Path, out: Path, until: int) -> list[Job]:
    """Three candidates, one of which fails."""
    out.mkdir()
    rewards = {"good": (1, REWARD), "calm": (3, REWARD), "bad": (2, NOT_FINITE)}
    return [
        Job(name, program(reward), program(MAPPING), 1.0, start, out / f"{name}.safetensors", until, seed)
        for name, (seed, reward) in rewards.items()
    ]


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def local(small, start, tmp_path_factory):
    """Outcomes and files of the local executor."""
    out = tmp_path_factory.mktemp("local") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(EXECUTOR_VARIABLE, raising=False)
        outcomes = train_pool(jobs(start, out, UNTIL), small, lambda event: None)
    assert [bool(outcome.failure) for outcome in outcomes] == [False, False, True]
    return outcomes, files(out)


def started(start):
    """Returns a node or a cluster. Ray gives it 30 seconds and no more, which a busy machine may not have."""
    for _ in range(2):
        with contextlib.suppress(Exception):
            return start()
    return start()


def eventually(holds: Callable[[], bool], seconds: float = 120) -> bool:
    """Returns whether something holds within so many seconds."""
    end = time.monotonic() + seconds
    while not holds():
        if time.monotonic() > end:
            return False
        time.sleep(0.5)
    return True


def of_ray() -> dict[int, str]:
    """Returns the command lines of Ray's processes on this machine that have the test's token, by process."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if f"{TOKEN_VARIABLE}={TOKEN}".encode() in (folder / "environ").read_bytes():
                found[int(folder.name)] = (folder / "cmdline").read_bytes().decode().replace("\0", " ")
    found.pop(os.getpid(), None)
    return found


def listening(processes) -> set[str]:
    """Returns the addresses at which processes of these ids listen, with their ports."""
    lines = subprocess.run(["ss", "-Hltnp"], capture_output=True, text=True).stdout.splitlines()
    owned = [line for line in lines if any(f"pid={number}," in line for number in processes)]
    return {line.split()[3] for line in owned}


def test_ray_on_one_machine_leaves_the_bytes_of_local_processes_and_nothing_else(
    small, start, short, tmp_path, environment, local
):
    environment.setenv(EXECUTOR_VARIABLE, "ray")
    environment.setenv("RAY_TMPDIR", str(short))
    seen: dict[str, object] = {}

    def look(event):
        if isinstance(event, Report) and not seen:
            processes = of_ray()
            seen["processes"] = [*processes.values()]
            seen["keys"] = [
                number
                for number in processes
                if b"secret-of-the-driver" in Path(f"/proc/{number}/environ").read_bytes()
            ]
            seen["listening"] = listening(processes)
            seen["session"] = [path.name[:10] for path in short.iterdir()]

    out = tmp_path / "out"
    outcomes = train_pool(jobs(start, out, UNTIL), small, look)
    assert outcomes == local[0]
    assert files(out) == local[1]
    assert any("raylet" in line for line in seen["processes"])
    assert seen["keys"] == []
    assert {re.sub(r":\d+$", "", address) for address in seen["listening"]} <= LOOPBACK
    assert seen["session"] == ["porse-ray-"]
    assert list(short.iterdir()) == []
    # The page of the dashboard.
    assert not any(address.endswith(":8265") for address in seen["listening"])


def test_two_machines_one_of_which_is_lost_in_the_middle_of_a_rung_leave_the_same_bytes(
    small, start, tmp_path, environment, local
):
    import ray
    from ray.cluster_utils import Cluster

    environment.setenv(EXECUTOR_VARIABLE, "ray")
    environment.setenv(CHECKPOINT_VARIABLE, "10")
    common = {"num_cpus": 1, "object_store_memory": 100 * 2**20, "node_ip_address": "127.0.0.1"}
    cluster = started(lambda: Cluster(initialize_head=True, head_node_args={**common, "include_dashboard": False}))
    try:
        second = started(lambda: cluster.add_node(wait=False, **common))
        ray.init(address=cluster.address, log_to_driver=False, logging_level="error")
        assert sorted(node["Resources"]["CPU"] for node in ray.nodes()) == [1.0, 1.0]
        reports: dict[str, list[int]] = {}
        lost: list[str] = []

        def tell(event):
            if isinstance(event, Ended):
                return
            reports.setdefault(event.name, []).append(event.epoch)
            # Both machines are at work, with a checkpoint behind them: whoever is on the second one loses it.
            alive = [name for name, epochs in reports.items() if FIRST + 1 < epochs[-1] < UNTIL]
            if len(alive) == 2 and not lost:
                lost.extend(alive)
                cluster.remove_node(second, allow_graceful=False)

        orders: list[tuple[int, int]] = []
        errand = remote._Training.errand

        def note(self, *arguments):
            part = last_part(self._folder)
            orders.append((self._attempt, part.epoch if part else 0))
            return errand(self, *arguments)

        environment.setattr(remote._Training, "errand", note)
        out = tmp_path / "out"
        outcomes = train_pool(jobs(start, out, UNTIL), small, tell)
        assert sorted(lost) == ["calm", "good"]
        # Three orders from the start, and one more, from a checkpoint in the middle.
        assert orders[:3] == [(0, 0)] * 3
        assert [attempt for attempt, _ in orders[3:]] == [1]
        assert FIRST <= orders[3][1] < UNTIL
        # The cluster's own record of it follows its health checks.
        assert eventually(lambda: sum(node["Alive"] for node in ray.nodes()) == 1)
        assert outcomes == local[0]
        assert files(out) == local[1]
        # No epoch is told twice.
        assert reports["good"] == reports["calm"] == list(range(1, UNTIL + 1))
        with ray_machines() as machines, pytest.raises(PorseError, match="expected a machine with 1 GPU or more"):
            machines.start(Errand(("true",), ".", {}, "", "stderr", gpus=1))
    finally:
        ray.shutdown()
        cluster.shutdown()


def test_a_cluster_for_a_whole_run_is_found_by_its_stages_and_one_that_is_not_there_is_named(
    small, start, tmp_path, environment
):
    environment.setenv(EXECUTOR_VARIABLE, "ray")
    with ray_here() as found:
        assert set(found.environment) == {"RAY_ADDRESS", MODE_VARIABLE, TOKEN_VARIABLE}
        assert found.cpus == 2
        code = (
            "from porse.training.cluster import ray_machines\n"
            "from porse.training.remote import Errand\n"
            "with ray_machines() as machines:\n"
            "    one = machines.start(Errand(('/bin/cat',), '/', {}, 'hello', '/dev/null'))\n"
            "    while not machines.ended([one], 1): pass\n"
            "    print(machines.answer(one))\n"
        )
        command = [sys.executable, "-c", code]
        done = subprocess.run(
            command, env={**os.environ, **found.environment}, capture_output=True, text=True, timeout=300
        )
        assert done.stdout.strip().endswith("hello"), done.stderr
    environment.setenv("RAY_ADDRESS", "127.0.0.1:1")
    begun = time.monotonic()
    with pytest.raises(ParamsError, match=r"expected a Ray cluster at RAY_ADDRESS=127\.0\.0\.1:1"):
        executor_from_environment().run(jobs(start, tmp_path / "out", 2), small, lambda event: None)
    assert time.monotonic() - begun < 15
