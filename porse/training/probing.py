"""The search of alpha by short trainings (ROSKA's short-cut Bayesian optimisation), as an iteration's first rung.

Each candidate is trained for a few epochs from fusions with several alphas: first evenly spread ones, then those that a
Gaussian process over the scores expects most of. The best of these *probes* takes the candidate's place; the others stay
in the pool as what they are, candidates that were trained for a few epochs, so that every epoch spent is accounted for.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from porse.checkpoint import policy_checkpoint, read_checkpoint, write_checkpoint
from porse.config import Params
from porse.identity import candidate_id
from porse.pool import BEST, RANDOM, Pool, policy_file
from porse.search.bayes import best_alpha, initial_alphas, next_alpha
from porse.search.fusion import Policy, fuse
from porse.search.lengths import probe_epochs, probe_trainings, spread_trainings
from porse.tables import Row
from porse.training.job import Outcome
from porse.training.population import train_pool
from porse.training.rung import curve_rows, job_for, row_after, rung_bar, write_trained

Train = Callable[[Sequence[Row], Sequence[Path], int], list[Outcome]]
"""Candidates, the policies that they start from, and the epoch to train to -> their outcomes."""


@dataclass(frozen=True)
class Probe:
    """One short training.

    Attributes:
        row: its row of the candidates table, after the training.
        outcome: what the training left.
        chosen: whether it takes its candidate's place.
    """

    row: Row
    outcome: Outcome
    chosen: bool = False

    @property
    def alpha(self) -> float:
        """Its share of the previous winner."""
        return self.row["alpha"]

    @property
    def score(self) -> float:
        """The highest fitness that it reached."""
        return max(value for _, series, value in self.outcome.rows if series == "fitness")


@dataclass(frozen=True)
class _Search:
    """One candidate and its probes so far."""

    entering: Row
    probes: list[Probe] = field(default_factory=list)

    def next(self, params: Params) -> float:
        """Returns the alpha to try next; a probe that failed counts as the worst of the others."""
        alive = [probe.score for probe in self.probes if not probe.outcome.failure]
        worst = min(alive, default=0.0)
        scores = [worst if probe.outcome.failure else probe.score for probe in self.probes]
        return next_alpha([probe.alpha for probe in self.probes], scores, params.probe)

    def result(self) -> list[Probe]:
        """Returns the probes, the chosen one first: that of the highest score, or any when all failed."""
        alive = [probe for probe in self.probes if not probe.outcome.failure] or self.probes[:1]
        best = alive[0].alpha
        if not alive[0].outcome.failure:
            best = best_alpha([probe.alpha for probe in alive], [probe.score for probe in alive])
        chosen = next(probe for probe in alive if probe.alpha == best)
        return [replace(chosen, chosen=True), *(probe for probe in self.probes if probe is not chosen)]


def search_rung(pool: Pool, params: Params, iteration: int, rung: str, until: int, out: Path) -> None:
    """Trains an iteration's first pool to epoch `until` and writes it to `out`, searching every candidate's alpha first.

    The probes that another one beat are in the written pool, too, younger than the rung.
    """
    short = min(probe_epochs(params), until)
    epochs = len(pool.candidates) * (probe_trainings(params) * short + until - short)
    with rung_bar(params, f"iteration {iteration} rung {rung}", len(pool.candidates), epochs) as bar:

        def train(rows: Sequence[Row], starts: Sequence[Path], to: int) -> list[Outcome]:
            jobs = [job_for(row, start, to, params, out) for row, start in zip(rows, starts, strict=True)]
            return train_pool(jobs, params, bar.tell)

        probes = search_alphas(pool, params, short, out, train)
        going = [probe.row for probe in probes if probe.chosen and not probe.row["failure"]]
        outcomes = train(going, [policy_file(out, row["policy"]) for row in going], until)
    results = {row["candidate_id"]: outcome for row, outcome in zip(going, outcomes, strict=True)}
    candidates = [row_after(probe.row, results.get(probe.row["candidate_id"]), until) for probe in probes]
    probed = curve_rows({probe.row["candidate_id"]: probe.outcome for probe in probes}, iteration, rung)
    write_trained(pool, candidates, [*probed, *curve_rows(results, iteration, rung)], out)


def search_alphas(pool: Pool, params: Params, until: int, out: Path, train: Train) -> list[Probe]:
    """Returns every probe of every candidate of the pool; a candidate's chosen one has its slot, the others count on.

    Args:
        pool: candidates that were not trained yet, with theta_best and theta_random.
        params: the run's parameters.
        until: the epoch to which a probe is trained.
        out: the folder of the pool that is written, for the fused policies.
        train: trains candidates side by side.
    """
    best, random = (read_checkpoint(policy_file(pool.folder, stem)).policy() for stem in (BEST, RANDOM))
    searches = [_Search(row) for row in pool.candidates]

    def probe(wanted: Sequence[tuple[_Search, float]]) -> None:
        rows = [_probe_row(search.entering, params.task, alpha) for search, alpha in wanted]
        starts = [_fused(best, random, alpha, out) for _, alpha in wanted]
        for (search, _), row, outcome in zip(wanted, rows, train(rows, starts, until), strict=True):
            search.probes.append(Probe(row_after(row, outcome, until), outcome))

    spread = initial_alphas(spread_trainings(params))
    probe([(search, alpha) for search in searches for alpha in spread])
    for _ in range(probe_trainings(params) - len(spread)):
        probe([(search, search.next(params)) for search in searches])
    return _numbered([search.result() for search in searches], 1 + max(row["slot"] for row in pool.candidates))


def _probe_row(entering: Row, task: str, alpha: float) -> Row:
    identity = candidate_id(task, entering["reward_source"], entering["mapping_source"], entering["beta"], alpha)
    changed = {"alpha": alpha, "candidate_id": identity, "policy": _stem(alpha)}
    return {**entering, **changed, "origin": "probe", "parent_id": entering["candidate_id"]}


def _stem(alpha: float) -> str:
    return f"alpha-{alpha:.6f}"


def _fused(best: Policy, random: Policy, alpha: float, out: Path) -> Path:
    """Returns the file of theta_f with this alpha, written where it is not there yet."""
    path = policy_file(out, _stem(alpha))
    if not path.exists():
        write_checkpoint(path, policy_checkpoint(fuse(best, random, alpha)))
    return path


def _numbered(results: Sequence[Sequence[Probe]], first: int) -> list[Probe]:
    """Returns all probes in one list, those not chosen in slots from `first` on."""
    chosen = [probe for probes in results for probe in probes if probe.chosen]
    others = [probe for probes in results for probe in probes if not probe.chosen]
    slots = range(first, first + len(others))
    return chosen + [replace(probe, row={**probe.row, "slot": slot}) for slot, probe in zip(slots, others, strict=True)]
