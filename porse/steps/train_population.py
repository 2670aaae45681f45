"""Step train-population: trains every candidate of a pool to the end of a rung."""

from pathlib import Path

from porse.config import Params
from porse.pool import read_pool
from porse.search.lengths import alpha_is_searched, rung_epochs
from porse.training.rung import train_rung


def train_population(params: Params, iteration: int, rung: str, until: int, pool: Path, out: Path) -> None:
    """Writes the trained pool to `out`.

    Args:
        params: the run's parameters.
        iteration: which iteration, from 1.
        rung: the rung's name.
        until: rungs that are done after this one.
        pool: the folder of the pool to train.
        out: the folder to write.

    Raises:
        CheckpointError: a policy to start from is missing or damaged.
    """
    entering = read_pool(pool)
    until_epoch = until * rung_epochs(params)
    if alpha_is_searched(params, iteration) and all(row["epochs"] == 0 for row in entering.candidates):
        # Imported here: the Gaussian process takes a second to import, and one method needs it.
        from porse.training.probing import search_rung

        search_rung(entering, params, iteration, rung, until_epoch, out)
    else:
        train_rung(entering, params, iteration, rung, until_epoch, out)
