"""Several processes record at once, and processes are killed while they record."""

import json
import os
import random
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from porse.llm.ask import ask
from porse.llm.index import summaries
from porse.llm.store import Store
from porse.llm.verify import verify
from tests.llm_cases import new_store, params, questions, record
from tests.llm_server import ChatServer

ROOT = Path(__file__).parents[1]

ASK_IN_THREADS = """
import sys, threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from porse.llm.ask import ask
from tests.llm_cases import params, questions

url, cache, threads, keys = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
asked = questions(keys)
barrier = threading.Barrier(threads)

def one(number):
    barrier.wait()
    return ask([asked[number % keys]], params(url), cache)[0].key

with ThreadPoolExecutor(threads) as pool:
    found = list(pool.map(one, range(threads)))
assert found == [asked[number % keys].request.key for number in range(threads)]
"""

ASK_AT_ONCE = """
import sys
from pathlib import Path
from porse.llm.ask import ask
from tests.llm_cases import params, questions

url, cache, count, keys = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
asked = [questions(keys)[number % keys] for number in range(count)]
assert [reply.key for reply in ask(asked, params(url), cache)] == [item.request.key for item in asked]
"""

# A process that has loaded everything forks one recorder after the other: a recorder then starts in milliseconds. Each
# prints the key of a reply after `ask` has returned it.
RECORDERS = """
import os, sys
from pathlib import Path
from porse.llm.ask import ask
import porse.llm.recording
from tests.llm_cases import params, questions

url, cache = sys.argv[1], Path(sys.argv[2])
for line in sys.stdin:
    first = int(line)
    child = os.fork()
    if child == 0:
        os.write(1, f"{os.getpid()}\\n".encode())
        for question in questions(first + 1000)[first:]:
            (reply,) = ask([question], params(url), cache)
            os.write(1, f"{reply.key}\\n".encode())
        os._exit(0)
    os.waitpid(child, 0)
    os.write(1, b"over\\n")
"""


@pytest.fixture(autouse=True)
def recording(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PORSE_LLM_MODE", "record")
    monkeypatch.setenv("PORSE_LLM_CONCURRENCY", "20")
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.delenv("PORSE_LLM_BASE_URL", raising=False)


@pytest.fixture
def server() -> Iterator[ChatServer]:
    with ChatServer() as server:
        yield server


def start(script: str, *arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", script, *map(str, arguments)]
    return subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


@pytest.mark.parametrize(
    ("script", "requests"),
    [(ASK_IN_THREADS, 20), pytest.param(ASK_IN_THREADS, 100, marks=pytest.mark.slow), (ASK_AT_ONCE, 100)],
)
def test_two_processes_and_many_requests_over_20_keys_are_20_calls(
    server: ChatServer, tmp_path: Path, script: str, requests: int
) -> None:
    server.delay_s = 0.2
    store = new_store(tmp_path)
    both = [start(script, server.url, store.cache_dir, requests, 20) for _ in range(2)]
    for process in both:
        process.communicate()
    assert [process.returncode for process in both] == [0, 0]
    assert len(server.requests) == 20
    assert len(list(store.all_keys())) == 20
    assert verify(store.cache_dir) == []


def test_a_killed_recorder_does_not_block_the_next_one(server: ChatServer, tmp_path: Path) -> None:
    store = new_store(tmp_path)
    server.delay_s = 30.0
    process = start(ASK_AT_ONCE, server.url, store.cache_dir, 1, 1)
    deadline = time.monotonic() + 20
    while not server.requests:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.kill()
    process.communicate()
    server.delay_s = 0.0
    started = time.monotonic()
    assert len(ask(questions(1), params(server.url), store.cache_dir)) == 1
    assert time.monotonic() - started < 5


@pytest.mark.parametrize("kills", [12, pytest.param(200, marks=pytest.mark.slow)])
def test_killed_at_random_moments_while_recording(server: ChatServer, tmp_path: Path, kills: int) -> None:
    store = new_store(tmp_path)
    draw = random.Random(7)
    recorders = start(RECORDERS, server.url, store.cache_dir)
    assert recorders.stdin is not None
    assert recorders.stdout is not None
    promised: set[str] = set()
    longest_s = 0.4
    for number in range(kills + 1):
        recorders.stdin.write(f"{len(list(store.all_keys()))}\n")
        recorders.stdin.flush()
        child = int(recorders.stdout.readline())
        if number == 0:
            # On a busy machine a recorder takes longer to its first reply: kills must hit all that it does.
            started = time.monotonic()
            promised.add(recorders.stdout.readline().strip())
            longest_s = max(longest_s, 2 * (time.monotonic() - started))
        else:
            time.sleep(draw.uniform(0.0, longest_s))
        os.kill(child, signal.SIGKILL)
        for line in iter(recorders.stdout.readline, "over\n"):
            promised.add(line.strip())
        # What is there is whole, and what a recorder has returned is there.
        assert verify(store.cache_dir) == []
        assert promised <= set(store.all_keys())
    recorders.stdin.close()
    recorders.wait()
    recorders.stdout.close()
    count = len(list(store.all_keys()))
    assert count > kills // 10, "kills must hit processes that have recorded something"
    calls = len(server.requests)
    assert len(ask(questions(count), params(server.url), store.cache_dir)) == count
    assert len(server.requests) - calls <= 1


def seconds_of_lookup(store: Store, keys: list[str]) -> float:
    """Returns the seconds of one look-up of a recorded reply: the median over the keys, the best of five rounds."""
    medians = []
    for _ in range(5):
        times = []
        for key in keys:
            started = time.perf_counter()
            assert store.read(key) is not None
            times.append(time.perf_counter() - started)
        medians.append(statistics.median(times))
    return min(medians)


@pytest.mark.parametrize(
    ("few", "many"), [(200, 2000), pytest.param(1000, 100_000, marks=[pytest.mark.slow, pytest.mark.timeout(1800)])]
)
def test_look_up_does_not_grow_with_the_records(
    tmp_path: Path, few: int, many: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)  # 100 000 records by fsync take minutes of waiting
    store = new_store(tmp_path)
    draw, figures = random.Random(1), []
    for start_at, count in ((0, few), (few, many)):
        for sample in range(start_at, count):
            store.write(record(f"reply {sample}\n" + "line of a reply\n" * 60, sample=sample))
        keys = [record(sample=draw.randrange(count)).key for _ in range(500)]
        figures.append(seconds_of_lookup(store, keys))
    print(json.dumps({"records": [few, many], "seconds": figures}))
    assert figures[1] < 0.001
    assert figures[1] < 2 * figures[0]


@pytest.mark.parametrize(("records", "limit_s"), [(500, 2.0), pytest.param(10_000, 5.0, marks=pytest.mark.slow)])
def test_opening_without_an_index(
    tmp_path: Path, records: int, limit_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)
    store = new_store(tmp_path)
    for sample in range(records):
        store.write(record(f"reply {sample}\n" + "line of a reply\n" * 60, sample=sample))
    started = time.perf_counter()
    assert len(summaries(store)) == records
    first = time.perf_counter() - started
    started = time.perf_counter()
    assert len(summaries(store)) == records
    again = time.perf_counter() - started
    print(json.dumps({"records": records, "seconds": first, "seconds with the index": again}))
    assert first < limit_s
