"""The schedule of an iteration as a computation: who trains how long, and what that costs (algorithm 1 of the paper)."""

from collections.abc import Sequence
from dataclasses import dataclass

from porse.config import Iteration, Params
from porse.errors import ParamsError

BETA, ALPHA = "beta", "alpha"


@dataclass(frozen=True)
class Work:
    """What one rung costs.

    Attributes:
        rung: the rung's name.
        candidates: candidates that are trained in it.
        epochs: epochs over all of them.
    """

    rung: str
    candidates: int
    epochs: int


def varied(iteration: int) -> str:
    """Returns what mutants of an iteration vary: beta in odd, alpha in even iterations (algorithm 1, line 21)."""
    return BETA if iteration % 2 else ALPHA


def work(params: Params) -> list[Work]:
    """Returns what each rung of one iteration costs when no candidate fails.

    The paper's parameters give 18 000 epochs: 500 (6 + 5 + 4) + 5 x 1500 + 500 (3 + 2 + 1).
    """
    ages = {"validate-code": [0] * params.generate.candidates}
    done: list[Work] = []
    for rung in params.rungs:
        if rung.pool == "mutate":
            ages["mutate"] = ages[params.mutate.pool] + [0] * params.mutate.mutants
        epochs = [max(0, rung.until - age) * params.train.rung_epochs for age in ages[rung.pool]]
        done.append(Work(str(rung.rung), sum(1 for count in epochs if count), sum(epochs)))
        ages[f"eliminate-{rung.rung}"] = [rung.until] * rung.keep
    return done


def total_epochs(params: Params) -> int:
    """Returns the epochs of all iterations, the paper's TTE."""
    return len(params.iterations) * sum(entry.epochs for entry in work(params))


def find_iteration(iterations: Sequence[Iteration], n: int) -> Iteration:
    """Returns the entry of iteration `n`.

    Raises:
        ParamsError: there is none.
    """
    for iteration in iterations:
        if iteration.n == n:
            return iteration
    raise ParamsError(f"expected an iteration in 1..{len(iterations)}, found {n}; change the stage's --iteration")
