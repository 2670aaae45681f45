"""The file format of policies and checkpoints: one safetensors file, and never a pickle.

Two kinds. A *policy* is the networks with their observation statistics, all that fusion knows. A *checkpoint* is a policy
and the rest of a training: optimizer, generator, simulation, visit counts. Scalars are JSON in the one metadata entry,
since safetensors writes several entries in no fixed order.
"""

import contextlib
import json
import math
import re
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
    """Writes the file whole: an interrupted write leaves no half file at `path`.

    Raises:
        CheckpointError: the system did not let it: the disk is full, say.
    """
    arrays = {name: np.asarray(array, order="C") for name, array in checkpoint.arrays.items()}
    scalars = canonical_json({"version": VERSION, **checkpoint.scalars})
    content = save(arrays, {"porse": scalars})
    partial = path.with_suffix(".partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(content)
        partial.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            partial.unlink()
        raise CheckpointError(
            f"expected to write {len(content)} bytes to {path}, found that the system refuses it ({error.strerror}); make room or give the right to write there, then run this again"
        ) from error


def read_checkpoint(path: Path) -> Checkpoint:
    """Returns the content of the file at `path`.

    Raises:
        CheckpointError: it is missing, damaged, of another version, or holds weights that are not finite.
    """
    try:
        with safe_open(path, framework="np") as file:
            scalars = json.loads((file.metadata() or {}).get("porse", "{}"))
            arrays = {name: file.get_tensor(name) for name in sorted(file.keys())}
    except FileNotFoundError:
        raise CheckpointError(
            f"expected a checkpoint at {path}, found no such file; run `porse repro` to make it"
        ) from None
    except (SafetensorError, ValueError, TypeError, AttributeError, OSError, RecursionError) as error:
        raise _damaged(path, f"a damaged file ({error})") from error
    if not isinstance(scalars, dict):
        raise _damaged(path, f"{type(scalars).__name__} where its scalars should be")
    if scalars.get("version") != VERSION:
        raise CheckpointError(
            f"expected a checkpoint of version {VERSION} at {path}, found {scalars.get('version')!r}; delete it and run `porse repro`"
        )
    checkpoint = Checkpoint(arrays, {key: value for key, value in scalars.items() if key != "version"})
    _check(checkpoint, path)
    return checkpoint


Shapes = Mapping[str, tuple[int, ...]]
"""The shape of each array of a policy, by its name."""


def check_networks(checkpoint: Checkpoint, expected: Shapes, task: str, path: Path) -> None:
    """Checks that the arrays of a file's policy have these names and shapes.

    Args:
        checkpoint: the file's content.
        expected: the names and shapes.
        task: of the policy, for the error.
        path: names the file in the error.

    Raises:
        CheckpointError: a name or a shape differs.
    """
    found: Shapes = {name: array.shape for name, array in checkpoint.policy().items()}
    wrong = [name for name in sorted(expected.keys() | found.keys()) if expected.get(name) != found.get(name)]
    if not wrong:
        return
    own, others = _sizes(expected), _sizes(found)
    if own == others:
        name = wrong[0]
        others = f"{_said(found.get(name))} for {name} in place of {_said(expected.get(name))}"
    raise CheckpointError(
        f"expected a policy of {task} with {own}, found {others} in {path}; name the task and the parameters "
        "(train.hidden, train.normalise_observations) that it was trained with"
    )


def _sizes(shapes: Shapes) -> str:
    """Returns the sizes of an actor in words."""
    layers = {
        int(match[1]): shape
        for name, shape in shapes.items()
        if (match := re.fullmatch(r"actor\.mlp\.(\d{1,9})\.weight", name)) and len(shape) == 2
    }
    if not layers:
        return "no actor"
    widths = [layers[min(layers)][1], *(layers[number][0] for number in sorted(layers))]
    return f"{widths[0]} observations, hidden layers of {'-'.join(map(str, widths[1:-1]))} and {widths[-1]} actions"


def _said(shape: tuple[int, ...] | None) -> str:
    return "no array" if shape is None else f"the shape {shape}"


def _check(checkpoint: Checkpoint, path: Path) -> None:
    """Raises a CheckpointError where scalars are not as a training writes them, or weights are not weights."""
    scalars = checkpoint.scalars
    if scalars.get("kind") not in ("policy", "checkpoint"):
        raise _damaged(path, f"the kind {scalars.get('kind')!r}, which is neither policy nor checkpoint")
    if scalars["kind"] == "checkpoint":
        epoch, rate = scalars.get("epoch"), scalars.get("learning_rate")
        if type(epoch) is not int or epoch < 0:
            raise _damaged(path, f"the epoch {epoch!r}, which is not a count")
        if type(rate) is not float or not 0.0 < rate < math.inf:
            raise _damaged(path, f"the learning rate {rate!r}, which is not a positive number")
    for name, array in checkpoint.arrays.items():
        is_weight = name.startswith((*NETWORKS, "optimizer."))
        if is_weight and array.dtype.kind not in "fiu":
            raise _damaged(path, f"{name} of {array.dtype}, which is not a number")
        if is_weight and not np.isfinite(array).all():
            raise _damaged(path, f"{name} with values that are not finite")


def _damaged(path: Path, found: str) -> CheckpointError:
    return CheckpointError(f"expected a checkpoint at {path}, found {found}; delete it and run `porse repro`")
