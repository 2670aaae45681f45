"""What every test may lean on: the numeric profile, no network beyond loopback, and small parameters."""

import dataclasses
import socket
from pathlib import Path

import pytest

from porse import numerics

# Before any test imports torch.
numerics.apply("portable")

from porse.config import Params, load_params  # noqa: E402

ROOT = Path(__file__).resolve().parent.parent
_LOOPBACK = ("127.", "::1", "localhost", "0.0.0.0")
_connect = socket.socket.connect


@pytest.fixture(autouse=True)
def _no_network(monkeypatch):
    def connect(self, address):
        if isinstance(address, tuple) and not str(address[0]).startswith(_LOOPBACK):
            raise AssertionError(f"a test tried to reach {address}")
        return _connect(self, address)

    monkeypatch.setattr(socket.socket, "connect", connect)


@pytest.fixture(scope="session")
def root() -> Path:
    """The project's root."""
    return ROOT


@pytest.fixture(scope="session")
def params() -> Params:
    """The committed parameters."""
    return load_params(ROOT / "params.yaml", ROOT)


@pytest.fixture(scope="session")
def small(params: Params) -> Params:
    """The committed parameters with tiny trainings."""
    train = dataclasses.replace(params.train, num_envs=8, steps_per_epoch=8, rung_epochs=2, hidden=(8,), minibatches=2)
    return dataclasses.replace(params, train=train)
