"""The machines of a Ray cluster: that of RAY_ADDRESS, or one on this machine for as long as it is needed.

Ray hands a text to a machine and a text back; the work itself is a process of its own there, which knows nothing of Ray, and of
the environment only what is named here. Ray is asked to send no usage statistics, to start no dashboard, and, where it is started
here, to listen on this machine alone.
"""

import importlib.util
import json
import os
import secrets
import shutil
import socket
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from porse.errors import ParamsError, PorseError
from porse.processes import PARENT_VARIABLE
from porse.training.limits import WORKERS_VARIABLE, workers
from porse.training.reason import last_words
from porse.training.remote import Errand, LostError, Machines, stdout_of

ADDRESS_VARIABLE, FOLDER_VARIABLE = "RAY_ADDRESS", "RAY_TMPDIR"
MODE_VARIABLE, TOKEN_VARIABLE = "RAY_AUTH_MODE", "RAY_AUTH_TOKEN"
"""Ray's own names: the cluster to connect to, where its files of a session go; whether a token is asked for, and which."""

LOOPBACK_VARIABLE = "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"
"""Ray's own name, too: with 0, a machine is 127.0.0.1 to itself. Otherwise Ray reads 127.0.0.1 in an address as the machine's own
address in the network, at which a cluster that listens on this machine alone does not answer."""

QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",
    # What Ray will do by itself one day, and warns of until then.
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    # Ray's own choice is 15: trainings would wait for whatever else runs, as those of `local` do not.
    "RAY_worker_niceness": "0",
}
"""Settings of Ray that hold where the environment does not say otherwise."""
_LONGEST_FOLDER = 42
"""Bytes of a path that leave room for the names of Ray's sockets below it: the system takes 107 in all."""

_CONNECT_S = 10
"""How long a cluster may take to accept a connection."""

_STORE_BYTES = 100 * 2**20
"""Ray's memory for what tasks hand each other, on a machine of our own: orders and answers, some hundred kilobytes each."""

_OWN = (
    "PATH",
    "HOME",
    "USER",
    "LOGNAME",
    "LANG",
    "LC_ALL",
    "TZ",
    "TMPDIR",
    "LD_LIBRARY_PATH",
    "XDG_CACHE_HOME",
    "VIRTUAL_ENV",
)
_OWN_PREFIXES = ("CUDA_", "NVIDIA_", "MUJOCO_", "WARP_")
"""Variables that a process on a machine gets of the machine's own: no key is among them."""


def check_ray() -> None:
    """Checks that Ray is installed.

    Raises:
        ParamsError: it is not.
    """
    if importlib.util.find_spec("ray") is None:
        raise ParamsError(
            "expected the package ray for PORSE_EXECUTOR=ray, found none in this environment; `pip install --no-deps -r "
            "requirements-ray.lock` adds it (docs/cluster.md)"
        )


@contextmanager
def ray_machines() -> Iterator[Machines]:
    """Connects to the cluster that RAY_ADDRESS names, or starts one on this machine, while the block runs.

    Raises:
        ParamsError: there is no cluster at that address, or PORSE_WORKERS is not a number.
    """
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)
    address = os.environ.get(ADDRESS_VARIABLE, "")
    # All of them are read when Ray is imported.
    if not address or address.startswith("127."):
        os.environ.setdefault(LOOPBACK_VARIABLE, "0")
    if not address:
        # Without one, Ray would write a token into the home folder.
        os.environ.setdefault(MODE_VARIABLE, "token")
        os.environ.setdefault(TOKEN_VARIABLE, secrets.token_hex(32))
    import ray

    if ray.is_initialized():
        yield _Ray(ray)
        return
    with _connected(ray) if address else _started(ray):
        yield _Ray(ray)


@dataclass(frozen=True)
class Here:
    """A cluster that this process is connected to.

    Attributes:
        environment: the variables by which other processes of this machine connect to it.
        cpus: CPUs of all machines.
        gpus: GPUs of all machines.
    """

    environment: Mapping[str, str]
    cpus: int
    gpus: int


@contextmanager
def ray_here() -> Iterator[Here]:
    """Connects to the cluster that RAY_ADDRESS names, or starts one on this machine, for a run of many stages.

    Raises:
        ParamsError: as for `ray_machines`.
    """
    check_ray()
    with ray_machines():
        import ray

        found, address = ray.cluster_resources(), ray.get_runtime_context().gcs_address
        environment = {name: os.environ[name] for name in (MODE_VARIABLE, TOKEN_VARIABLE) if name in os.environ}
        environment[ADDRESS_VARIABLE] = address
        yield Here(environment, int(found.get("CPU", 0)), int(found.get("GPU", 0)))


@contextmanager
def _connected(ray: Any) -> Iterator[None]:
    address = os.environ[ADDRESS_VARIABLE]
    try:
        _check_listens(ray, address)
        ray.init(address=address, log_to_driver=False, logging_level="error")
    except (OSError, RuntimeError, ValueError, ray.exceptions.RayError) as error:
        raise ParamsError(
            f"expected a Ray cluster at {ADDRESS_VARIABLE}={address[:100]}, found none that answers ({last_words(str(error))}); "
            "start it with `ray start --head`, or unset the variable, which starts Ray on this machine alone"
        ) from error
    try:
        yield
    finally:
        ray.shutdown()


def _check_listens(ray: Any, address: str) -> None:
    """Checks that something listens where Ray will look for a cluster.

    Ray itself tries 20 times (its RAY_NUM_REDIS_GET_RETRIES), 40 seconds each.

    Raises:
        OSError: nothing does.
        ValueError: it is not an address.
    """
    if "://" in address:
        return  # not the cluster itself, but a server in front of it
    place = urlsplit(f"//{ray._private.services.canonicalize_bootstrap_address(address) or ''}")
    if place.port:
        socket.create_connection((place.hostname, place.port), _CONNECT_S).close()


@contextmanager
def _started(ray: Any) -> Iterator[None]:
    """Starts Ray on this machine, with a folder that is removed at the end, and ends it.

    Raises:
        ParamsError: the folder's path is too long for the sockets that Ray makes in it.
    """
    folder = tempfile.mkdtemp(prefix="porse-ray-", dir=os.environ.get(FOLDER_VARIABLE) or None)
    try:
        if len(os.fsencode(folder)) > _LONGEST_FOLDER:
            raise ParamsError(
                f"expected a folder for Ray of at most {_LONGEST_FOLDER} bytes, since sockets lie in it, found {folder}; "
                f"set {FOLDER_VARIABLE} to a short path, such as /tmp"
            )
        with _environment({**machine_environment(os.environ), **_rays_own(os.environ)}):
            ray.init(
                address="local",
                num_cpus=workers(),
                include_dashboard=False,
                log_to_driver=False,
                logging_level="error",
                object_store_memory=_STORE_BYTES,
                _node_ip_address="127.0.0.1",
                _temp_dir=folder,
            )
        yield
    finally:
        ray.shutdown()
        shutil.rmtree(folder, ignore_errors=True)


def _rays_own(environment: Mapping[str, str]) -> dict[str, str]:
    return {name: value for name, value in environment.items() if name.startswith("RAY_")}


@contextmanager
def _environment(wanted: Mapping[str, str]) -> Iterator[None]:
    """Gives processes that are started in the block these variables and no others: Ray hands on all that it was given."""
    before = dict(os.environ)
    os.environ.clear()
    os.environ.update(wanted)
    try:
        yield
    finally:
        added = {name: value for name, value in os.environ.items() if name not in wanted}
        os.environ.clear()
        os.environ.update({**added, **before})


def machine_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """Returns what a process gets of a machine's own environment."""
    return {name: value for name, value in environment.items() if name in _OWN or name.startswith(_OWN_PREFIXES)}


class _Ray:
    """See `porse.training.remote.Machines`.

    Args:
        ray: the package, connected.
    """

    def __init__(self, ray: Any) -> None:
        self._ray = ray

    def start(self, errand: Errand) -> Any:
        found = self._ray.cluster_resources()
        for name, wanted in (("CPU", errand.cpus), ("GPU", errand.gpus)):
            largest = max(
                (node["Resources"].get(name, 0.0) for node in self._ray.nodes() if node["Alive"]), default=0.0
            )
            if wanted > largest:
                raise PorseError(
                    f"expected a machine with {wanted} {name} or more in the Ray cluster, found {found.get(name, 0.0):g} in all "
                    f"and at most {largest:g} on one; add such a machine (docs/cluster.md), or ask for less"
                )
        task = self._ray.remote(
            num_cpus=errand.cpus, num_gpus=errand.gpus, max_retries=0, scheduling_strategy="SPREAD"
        )(_run_on_a_node)
        return task.remote(json.dumps(asdict(errand)))

    def ended(self, handles: Sequence[Any], timeout_s: float) -> Sequence[Any]:
        done, _ = self._ray.wait([*handles], num_returns=len(handles), timeout=timeout_s, fetch_local=False)
        return done

    def answer(self, handle: Any) -> str:
        try:
            answer = json.loads(self._ray.get(handle))
        except self._ray.exceptions.RayTaskError as error:
            raise PorseError(
                f"expected Ray's worker to start a training, found {last_words(str(error))}; `porse doctor` there checks the machine"
            ) from error
        except self._ray.exceptions.RayError as error:
            raise LostError(f"{type(error).__name__}: {last_words(str(error))}") from error
        return stdout_of(answer)

    def stop(self, handle: Any) -> None:
        self._ray.cancel(handle, force=True)


def _run_on_a_node(text: str) -> str:
    """Runs an errand on the machine that this process of Ray's is on, and returns what became of it, as JSON."""
    import ray

    errand = json.loads(text)
    node = ray.get_runtime_context().get_node_id()
    resources = next(found["Resources"] for found in ray.nodes() if found["NodeID"] == node)
    room = resources["GPU"] / errand["gpus"] if errand["gpus"] else resources["CPU"] / errand["cpus"]
    return json.dumps(run_errand(errand, max(1, int(room))))


def run_errand(errand: Mapping[str, Any], room: int) -> dict[str, str]:
    """Runs an errand on this machine, and returns an answer for `porse.training.remote.stdout_of`.

    Args:
        errand: an `Errand` as JSON has it.
        room: how many like it this machine runs at once: it may take that share of the memory.
    """
    environment = {
        **machine_environment(os.environ),
        WORKERS_VARIABLE: str(room),
        **errand["environment"],
        PARENT_VARIABLE: str(os.getpid()),
    }
    try:
        with Path(errand["stderr"]).open("wb") as stderr:
            process = subprocess.Popen(
                errand["command"],
                cwd=errand["folder"],
                env=environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=stderr,
            )
    except OSError as error:
        return {
            "refused": f"expected {errand['command'][0]} and {errand['folder']} on every machine of the cluster, found on "
            f"{os.uname().nodename}: {error.strerror} ({error.filename}); put the project and its environment where every machine sees "
            "them under the same path (docs/cluster.md)"
        }
    stdout, _ = process.communicate(errand["stdin"].encode())
    if process.returncode or not stdout.strip():
        file = Path(errand["stderr"])
        # Who gave the order may be gone, and the folder with it.
        printed = file.read_text(encoding="utf-8", errors="replace") if file.is_file() else ""
        return {
            "lost": f"its process ended with code {process.returncode} and without an answer: {last_words(printed)}"
        }
    return {"stdout": stdout.decode()}
