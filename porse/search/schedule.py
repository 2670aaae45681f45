"""The schedule of an iteration as a computation: who trains how long, and what that costs (algorithm 1 of the paper)."""

from collections.abc import Sequence
from dataclasses import dataclass

from porse.config import Iteration, Params, Rung
from porse.errors import ParamsError
from porse.tables import Row

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


def target_epoch(params: Params, rung: str) -> int:
    """Returns the epoch that every candidate of a rung is trained to."""
    return find_rung(params.rungs, rung).until * params.train.rung_epochs


def find_rung(rungs: Sequence[Rung], name: str) -> Rung:
    """Returns the rung with this name.

    Raises:
        ParamsError: there is none.
    """
    for rung in rungs:
        if str(rung.rung) == name:
            return rung
    raise ParamsError(
        f"expected a rung of params.yaml ({', '.join(str(rung.rung) for rung in rungs)}), found {name!r}; change the stage's --rung"
    )


def work(params: Params) -> list[Work]:
    """Returns what each rung of one iteration costs when no candidate fails.

    The paper's parameters give 18 000 epochs: 500 (6 + 5 + 4) + 5 x 1500 + 500 (3 + 2 + 1).

    Raises:
        ParamsError: a rung keeps more candidates than it has, reads an unknown pool, or the last keeps more than one.
    """
    pools: dict[str, list[int]] = {"validate-code": [0] * params.generate.candidates}
    done: list[Work] = []
    for rung in params.rungs:
        if rung.pool == "mutate":
            _require(
                params.mutate.pool in pools,
                f"mutate.pool to be the elimination of an earlier rung, found {params.mutate.pool!r}",
            )
            pools["mutate"] = pools[params.mutate.pool] + [0] * params.mutate.mutants
        _require(
            rung.pool in pools, f"the pool of rung {rung.rung} to be one of {', '.join(pools)}, found {rung.pool!r}"
        )
        ages = pools[rung.pool]
        _require(
            rung.keep <= len(ages),
            f"rung {rung.rung} to keep at most its {len(ages)} candidates, found keep: {rung.keep}",
        )
        epochs = [max(0, rung.until - age) * params.train.rung_epochs for age in ages]
        done.append(Work(str(rung.rung), sum(1 for count in epochs if count), sum(epochs)))
        pools[f"eliminate-{rung.rung}"] = [rung.until] * rung.keep
    _require(
        len(pools.get(params.fuse.pool, [])) == 1,
        f"fuse.pool to be an elimination that keeps one candidate, found {params.fuse.pool!r}",
    )
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


def _require(condition: bool, expected: str) -> None:
    if not condition:
        raise ParamsError(f"expected {expected} in params.yaml; change the rungs so that they fit each other")


def environment_steps(params: Params, rows: Sequence[Row]) -> int:
    """Returns the environment steps behind the fitness rows of curves: one row is one epoch of one candidate."""
    epochs = sum(1 for row in rows if row["series"] == "fitness")
    return epochs * params.train.num_envs * params.train.steps_per_epoch
