"""The probe's child process: what it may do, that functions cannot spoil each other, and that it comes back."""

import json
import os
import signal
import subprocess
import sys
import textwrap
import time

import pytest

from code_cases import VARIABLES, reward, traced, values
from porse.functions.read import probe
from porse.functions.read.confine import Limits
from porse.functions.read.sandbox import ProbeError, Sandbox, _verdict
from porse.functions.read.states import packed

GOOD = reward("x = a[:, 0] + b[:, 0]")
SLOW = reward(
    "x = a[:, 0]",
    "m = torch.ones(1500, 1500)",
    "for i in range(900):\n    m = torch.mm(m, m) / 1500",
    "x = x + m[0, 0]",
)
LARGE = reward("x = a[:, 0] + torch.zeros(a.shape[0], 300, 3000).sum()")


@pytest.fixture(scope="module")
def sandbox():
    with Sandbox(Limits(wall_s=30.0, cpu_s=1)) as running:
        running.prepare(packed(values()))
        yield running


def test_a_bad_function_spoils_no_other():
    with Sandbox(Limits(wall_s=3.0)) as running:
        running.prepare(packed(values()))
        found = [running.judge(reply, "reward") for reply in (GOOD, SLOW, GOOD, "no code", LARGE, GOOD)]
    assert [verdict.check for verdict, _ in found] == ["ok", "time", "ok", "extract", "memory", "ok"]
    assert [bool(source) for _, source in found] == [True, False, True, False, False, True]


def test_processor_time_is_limited_where_the_clock_is_not(sandbox):
    assert sandbox.judge(SLOW, "reward")[0].check == "time"


def test_the_same_function_gets_the_same_verdict_again(sandbox):
    assert sandbox.judge(GOOD, "reward") == sandbox.judge(GOOD, "reward")


def test_further_functions_take_a_fraction_of_a_second(sandbox):
    sandbox.judge(GOOD, "reward")[0]
    started = time.perf_counter()
    for _ in range(5):
        sandbox.judge(GOOD, "reward")[0]
    assert (time.perf_counter() - started) / 5 < 0.5  # 0.03 on an idle machine


def test_states_that_cannot_be_read_are_an_error(sandbox):
    with pytest.raises(ProbeError, match="Error while deserializing"):
        sandbox.prepare(packed(values()) | {"tensors": ""})
    sandbox.prepare(packed(values()))


def test_a_child_that_is_killed_is_replaced(sandbox):
    assert sandbox.judge(GOOD, "reward")[0].passed
    os.kill(sandbox._process.pid, signal.SIGKILL)
    assert sandbox.judge(GOOD, "reward")[0].check == "crash"
    assert sandbox.judge(GOOD, "reward")[0].passed


def test_the_child_has_a_scrubbed_environment_and_leaves_nothing_behind(monkeypatch):
    monkeypatch.setenv("PORSE_SECRET", "canary")
    with Sandbox(Limits()) as running:
        running.prepare(packed(values()))
        process = running._process
        folder = os.readlink(f"/proc/{process.pid}/cwd")
        with open(f"/proc/{process.pid}/environ", "rb") as file:
            assert b"canary" not in file.read()
        assert os.getsid(process.pid) == process.pid
        assert os.path.basename(folder).startswith("porse-probe-")
        assert os.listdir(folder) == []
    assert process.returncode is not None
    assert not os.path.exists(folder)


LIST = traced(GOOD, "reward", VARIABLES).text


@pytest.mark.parametrize(
    ("answer", "check"),
    [
        ({"passed": True, "check": "ok", "message": "", "program": "{"}, "static"),
        ({"program": f" {LIST}", "source": GOOD}, "static"),
        ({"passed": True, "check": "ok", "message": "trust me"}, "ok"),
        ({}, "crash"),
        ([LIST], "crash"),
    ],
)
def test_who_ran_a_function_is_not_trusted_with_the_verdict(monkeypatch, answer, check):
    monkeypatch.setattr(probe, "_answer", lambda request, states: answer)
    found = probe._judged({"reply": GOOD, "kind": "reward"}, values(), Limits())
    assert (found["check"], _verdict(found).passed) == (check, False)


def test_names_and_directions_are_those_of_the_list(monkeypatch):
    forged = {"program": LIST, "source": GOOD, "warning": "", "names": ["other"], "rises": [True], "passed": False}
    monkeypatch.setattr(probe, "_answer", lambda request, states: forged)
    found = _verdict(probe._judged({"reply": GOOD, "kind": "reward"}, values(), Limits()))
    assert (found.passed, found.check, found.names, found.rises) == (True, "ok", ("x",), ())


_ESCAPES = """
    import json, os, socket, sys
    from porse.functions.read.confine import Limits, confine

    secret = os.open("/etc/hostname", os.O_RDONLY)
    read_end, write_end = os.pipe()
    if os.fork() == 0:
        tries = {
            "open a file": lambda: open("/etc/hostname"),
            "make a file": lambda: os.open(sys.argv[1], os.O_CREAT | os.O_WRONLY),
            "open a socket": lambda: socket.socket(),
            "start a process": os.fork,
            "run a program": lambda: os.execv("/bin/true", ["true"]),
            "signal its parent": lambda: os.kill(os.getppid(), 0),
            "read an inherited file": lambda: os.read(secret, 1),
            "take memory": lambda: bytearray(2**31),
            "remove a file": lambda: os.unlink(sys.argv[1]),
            "copy its pipe": lambda: os.dup(write_end),
        }
        kind = confine(Limits(memory_mib=256), keep=write_end)
        done = []
        for name, attempt in tries.items():
            try:
                attempt()
                done.append(name)
            except (OSError, MemoryError):
                pass
        os.write(write_end, json.dumps([kind, done]).encode())
        os._exit(0)
    os.close(write_end)
    print(os.read(read_end, 10000).decode())
"""


def test_a_confined_process_can_do_nothing_but_answer(tmp_path, root):
    command = [sys.executable, "-c", textwrap.dedent(_ESCAPES), str(tmp_path / "made")]
    result = subprocess.run(command, env=os.environ | {"PYTHONPATH": str(root)}, capture_output=True, check=True)
    kind, done = json.loads(result.stdout)
    if kind == "filtered":
        assert done == []
    else:  # no filter on this kind of machine: the limits of resources still hold
        assert not {"make a file", "read an inherited file", "take memory", "open a socket"} & set(done)
    assert not (tmp_path / "made").exists()
