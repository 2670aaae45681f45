"""The winning lineage: the candidates whose trainings make up the final policy, and how an evaluation names its draws."""

from collections.abc import Sequence

from porse.config import Params
from porse.identity import seed_for
from porse.tables import Row


def lineage(incumbents: Sequence[Row], scores: Sequence[float], params: Params) -> list[Row]:
    """Returns the candidates that were trained one on top of the other, the first one first.

    Args:
        incumbents: the row of the candidate that each iteration handed on.
        scores: the score of each of their trainings.
        params: the run's parameters; where iterations start from a random policy, the lineage is the best one alone.
    """
    links: dict[str, Row] = {}
    for row in incumbents:
        # An incumbent that stays is trained once.
        links.setdefault(f"{row['iteration']}/{row['candidate_id']}", row)
    if params.fuse.policy == "random":
        best = max(range(len(incumbents)), key=lambda index: (scores[index], -index))
        return [incumbents[best]]
    return list(links.values())


def evaluation_seed(params: Params, number: int) -> int:
    """Returns the run's seed in the place of which evaluation `number` (1 and up) draws."""
    return seed_for(params.seed, "evaluate", number)


def episodes_seed(params: Params) -> int:
    """Returns the seed of the task on which the winner plays its final episodes."""
    return seed_for(params.seed, "episodes")
