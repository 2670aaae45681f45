"""The schedule as a computation: who trains how long, and what that costs (algorithm 1 of the paper, and its table 17)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from porse.config import Iteration, Params
from porse.errors import ParamsError
from porse.search.elimination import how_many_go_on
from porse.search.lengths import alpha_is_searched, probe_epochs, probe_trainings, rung_epochs

BETA, ALPHA, DRAW = "beta", "alpha", "draw"
"""What mutants may vary: a weight, a share, or nothing but the random draws of their training."""


@dataclass(frozen=True)
class Work:
    """What one rung costs.

    Attributes:
        rung: the rung's name.
        candidates: candidates that are trained in it.
        epochs: epochs over all of them, those of probes included.
    """

    rung: str
    candidates: int
    epochs: int


def is_searched(params: Params, iteration: int) -> bool:
    """Returns whether an iteration has candidates: each has, or the first alone (generate.iterations)."""
    return iteration == 1 or params.generate.iterations == "every"


def asked_kinds(params: Params) -> tuple[Literal["reward", "mapping"], ...]:
    """Returns which kinds of functions a candidate is made of."""
    reward: tuple[Literal["reward"], ...] = ("reward",) if params.candidate.goal == "generated" else ()
    mapping: tuple[Literal["mapping"], ...] = ("mapping",) if params.candidate.bonus == "mapping" else ()
    return (*reward, *mapping)


def first_candidates(params: Params) -> int:
    """Returns how many candidates an iteration starts with: K, or 1 where nothing tells candidates apart."""
    return params.generate.candidates if asked_kinds(params) else 1


def varied(params: Params, iteration: int) -> str:
    """Returns what the mutants of an iteration vary: by default beta in odd, alpha in even ones (algorithm 1, line 21)."""
    return params.mutate.vary[(iteration - 1) % len(params.mutate.vary)]


def mutants(params: Params, iteration: int) -> int:
    """Returns how many mutants are asked for: none where alpha is due and there is no previous winner to fuse."""
    nothing_to_fuse = iteration == 1 or params.fuse.policy == "random"
    return 0 if varied(params, iteration) == ALPHA and nothing_to_fuse else params.mutate.mutants


def work(params: Params, iteration: int) -> list[Work]:
    """Returns what each rung of an iteration costs when no candidate fails and no two candidates are equal.

    With the paper's parameters an iteration of PoRSE takes 500 (6 + 5 + 4) + 5 x 1500 + 500 (3 + 2 + 1) = 18 000 epochs.
    """
    if not is_searched(params, iteration):
        return []
    epochs_of = rung_epochs(params)
    ages = {"validate-code": [0] * first_candidates(params)}
    done: list[Work] = []
    for index, rung in enumerate(params.rungs):
        if rung.pool == "mutate":
            ages["mutate"] = ages[params.mutate.pool] + [0] * mutants(params, iteration)
        pool = ages[rung.pool]
        epochs = [max(0, rung.until - age) * epochs_of for age in pool]
        if index == 0 and alpha_is_searched(params, iteration):
            # The best probe of a candidate goes on to the rung's end; the others cost their own epochs.
            epochs = [cost + (probe_trainings(params) - 1) * probe_epochs(params) for cost in epochs]
        done.append(Work(str(rung.rung), sum(1 for count in epochs if count), sum(epochs)))
        ages[f"eliminate-{rung.rung}"] = [rung.until] * how_many_go_on(params, rung.keep, len(pool))
    return done


def total_epochs(params: Params) -> int:
    """Returns the epochs that the run's method spends in all iterations, the paper's TTE."""
    return sum(cost.epochs for entry in params.iterations for cost in work(params, entry.n))


def allowed_epochs(params: Params) -> int:
    """Returns the epochs that any method may spend: N iterations of K policies, each trained through all rungs."""
    last = max(rung.until for rung in params.rungs)
    return len(params.iterations) * params.generate.candidates * last * params.train.rung_epochs


def find_iteration(iterations: Sequence[Iteration], n: int) -> Iteration:
    """Returns the entry of iteration `n`.

    Raises:
        ParamsError: there is none.
    """
    for iteration in iterations:
        if iteration.n == n:
            return iteration
    raise ParamsError(f"expected an iteration in 1..{len(iterations)}, found {n}; change the stage's --iteration")
