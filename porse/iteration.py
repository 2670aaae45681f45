"""The algorithm in one place: a whole run, or one iteration of it, in one process, by the functions that the stages call.

It writes what `dvc repro` writes, where it writes it, byte for byte. It leaves out DVC: it tracks nothing, skips nothing and
cannot resume. It is for reading, for a debugger, for tests, and for short runs. Numbers of lines are those of algorithm 1 of
the paper.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from porse.config import Iteration, Params
from porse.errors import PorseError
from porse.generation.functions import Check
from porse.steps.begin import begin
from porse.steps.eliminate import eliminate
from porse.steps.evaluate import evaluate
from porse.steps.fuse import fuse
from porse.steps.generate import generate
from porse.steps.mutate import mutate
from porse.steps.summarise import summarise
from porse.steps.train_population import train_population
from porse.steps.validate_code import validate_code

OUTPUTS = ("run", "evaluation", "results", "metrics.json", "plots")
"""All that a run writes."""

Say = Callable[[str], None]
"""Takes a line about what was done."""


@dataclass(frozen=True)
class Place:
    """Where a run reads and writes.

    Attributes:
        folder: where the outputs go.
        prompts: the folder of the prompts' templates.
        cache: the folder of recorded replies.
    """

    folder: Path
    prompts: Path
    cache: Path

    @property
    def run(self) -> Path:
        """The folder of the iterations."""
        return self.folder / "run"

    def of(self, iteration: int | str, stage: str) -> Path:
        """Returns the folder that a stage of an iteration writes; `start` is what the iteration starts from."""
        return self.run / str(iteration) / stage


def run(params: Params, place: Place, check: Check, say: Say) -> None:
    """Runs all iterations, the evaluation and the summary.

    Args:
        params: the run's parameters. The numeric profile must have been applied before this module was imported.
        place: where to read and write; there must be no run yet.
        check: tries functions, see `porse.generation.states.checker`.
        say: is given a line or two about each step.

    Raises:
        PorseError: outputs of a run are there already, or a step could not do its work.
    """
    found = [name for name in OUTPUTS if (place.folder / name).exists()]
    if found:
        raise PorseError(
            f"expected a folder without a run in it, found {', '.join(found)} in {place.folder}; name another folder"
        )
    say(begin(params, place.of(1, "start")))
    for entry in params.iterations:
        iterate(params, entry, place, check, say)
    evaluation, metrics = place.folder / "evaluation", place.folder / "metrics.json"
    say(evaluate(params, place.run, evaluation))
    say(summarise(params, place.run, evaluation, place.folder / "results", metrics, place.folder / "plots"))


def iterate(params: Params, entry: Iteration, place: Place, check: Check, say: Say) -> None:
    """Runs one iteration n, from `run/n/start` to the start of the next.

    Args:
        params: the run's parameters.
        entry: the iteration.
        place: where to read and write.
        check: tries functions.
        say: is given a line about each step.

    Raises:
        PorseError: a step could not do its work.
    """
    n, start, generated = entry.n, place.of(entry.n, "start"), place.of(entry.n, "generate")

    def half_time(pool: str) -> None:
        # Lines 20 and 21: variants of the best survivor join a pool, once it is there.
        if pool == params.mutate.pool:
            out = place.of(n, "mutate")
            say(mutate(params, n, place.of(n, pool), start, place.prompts, place.cache, out))

    # Lines 2 to 8: K rewards and K mappings, every one of which runs.
    say(generate(params, n, start, place.prompts, place.cache, generated))
    first = place.of(n, "validate-code")
    say(validate_code(params, n, start, generated, check, place.prompts, place.cache, first))
    half_time("validate-code")
    # Lines 9 to 25: train all, keep the best, rung by rung.
    for rung in params.rungs:
        name, trained, kept = str(rung.rung), place.of(n, f"train-{rung.rung}"), place.of(n, f"eliminate-{rung.rung}")
        train_population(params, n, name, rung.until, place.of(n, rung.pool), trained)
        say(eliminate(params, n, name, rung.keep, trained, kept))
        half_time(kept.name)
    # Line 15 of the next iteration: the winner, fused with a random policy, is where all its candidates start.
    say(fuse(params, n, start, place.of(n, params.fuse.pool), place.of(entry.next, "start")))
