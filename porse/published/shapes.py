"""The names and shapes of a policy's arrays, from sizes alone: what a published policy is held against, without torch."""

import itertools
import json

from porse.checkpoint import Shapes
from porse.config import Params
from porse.task_names import TASK_ROWS


def policy_shapes(params: Params) -> Shapes:
    """Returns what the networks of a run on a task of the package consist of."""
    rows = {row["task"]: row for row in json.loads(TASK_ROWS.read_text(encoding="utf-8"))}
    observations, actions = rows[params.task]["observations"], rows[params.task]["actions"]
    shapes: dict[str, tuple[int, ...]] = {"actor.distribution.std_param": (actions,)}
    for network, outputs in (("actor", actions), ("critic", 1)):
        widths = [observations, *params.train.hidden, outputs]
        for number, (inputs, width) in enumerate(itertools.pairwise(widths)):
            # Between two layers of weights is one of activations.
            shapes[f"{network}.mlp.{2 * number}.weight"] = (width, inputs)
            shapes[f"{network}.mlp.{2 * number}.bias"] = (width,)
        if params.train.normalise_observations:
            statistics = dict.fromkeys(("_mean", "_var", "_std"), (1, observations))
            shapes |= {f"{network}.obs_normalizer.{name}": shape for name, shape in statistics.items()}
            shapes[f"{network}.obs_normalizer.count"] = ()
    return shapes
