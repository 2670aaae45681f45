"""The file format of policies and checkpoints: one safetensors file, and never a pickle.

Two kinds. A *policy* is the networks with their observation statistics, all that fusion knows. A *checkpoint* is a policy
and the rest of a training: optimizer, generator, simulation, visit counts. Scalars are JSON in the one metadata entry,
since safetensors writes several entries in no fixed order.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from porse.errors import CheckpointError
from porse.identity import canonical_json

VERSION = 1
NETWORKS = ("actor.", "critic.")
"""What the names of a policy's arrays begin with."""


@dataclass(frozen=True)
class Checkpoint:
    """A file's content: arrays by dotted name, and scalars (`kind`: policy or checkpoint)."""

    arrays: Mapping[str, NDArray[np.generic]]
    scalars: Mapping[str, Any]

    def part(self, name: str) -> dict[str, NDArray[np.generic]]:
        """Returns the arrays below `name.`, without that prefix."""
        prefix = f"{name}."
        return {key.removeprefix(prefix): value for key, value in self.arrays.items() if key.startswith(prefix)}

    def policy(self) -> dict[str, NDArray[np.generic]]:
        """Returns the arrays of actor and critic."""
        return {name: array for name, array in self.arrays.items() if name.startswith(NETWORKS)}


def policy_checkpoint(arrays: Mapping[str, NDArray[np.generic]]) -> Checkpoint:
    """Returns a file's content that holds a policy alone."""
    return Checkpoint(arrays, {"kind": "policy"})


def write_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Writes the file whole: an interrupted write leaves no half file at `path`."""
    arrays = {name: np.asarray(array, order="C") for name, array in checkpoint.arrays.items()}
    scalars = canonical_json({"version": VERSION, **checkpoint.scalars})
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    partial.write_bytes(save(arrays, {"porse": scalars}))
    partial.replace(path)


def read_checkpoint(path: Path) -> Checkpoint:
    """Returns the content of the file at `path`.

    Raises:
        CheckpointError: it is missing, damaged or of another version.
    """
    try:
        with safe_open(path, framework="np") as file:
            scalars = json.loads((file.metadata() or {}).get("porse", "{}"))
            arrays = {name: file.get_tensor(name) for name in sorted(file.keys())}
    except FileNotFoundError:
        raise CheckpointError(
            f"expected a checkpoint at {path}, found no such file; run `dvc repro` to make it"
        ) from None
    except (SafetensorError, ValueError) as error:
        raise CheckpointError(
            f"expected a checkpoint at {path}, found a damaged file ({error}); delete it and run `dvc repro`"
        ) from error
    if scalars.get("version") != VERSION:
        raise CheckpointError(
            f"expected a checkpoint of version {VERSION} at {path}, found {scalars.get('version')}; delete it and run `dvc repro`"
        )
    return Checkpoint(arrays, {key: value for key, value in scalars.items() if key != "version"})
