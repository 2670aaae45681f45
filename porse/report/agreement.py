"""Whether the tables of a finished run agree with each other: counts, ids and ranks. A lost row is noticed here.

`porse.tables` checks each table by itself. DVC keeps those in the workspace whole; a run in a folder, a suite's or somebody
else's, has nobody who does.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from porse.config import Params
from porse.errors import TableError
from porse.report.run import Evaluation, Run
from porse.search.schedule import DRAW
from porse.tables import Row

_SOMETIMES = frozenset({"episode_length"})
"""Series without a row at some epochs: no episode ended there."""


def check_agreement(run: Run, iterations: Sequence[Row], evaluation: Evaluation, params: Params, where: str) -> None:
    """Checks that all tables of a run agree.

    Args:
        run: its rows.
        iterations: rows of its iterations table.
        evaluation: what `evaluate` found.
        params: its parameters.
        where: names the folder of the tables in errors.

    Raises:
        TableError: they do not.
    """
    _refuse(
        (
            *_iterations(iterations, run.curves),
            *_replies(iterations, run.replies, run.verdicts, run.mutants),
            *_candidates(run),
            *_curves(run),
            *_ranks(run),
            *_evaluation(run, evaluation, params),
        ),
        where,
    )


def check_epochs(iterations: Sequence[Row], curves: Sequence[Row], where: str) -> None:
    """Checks that the iterations table counts the epochs that the curves table has.

    Raises:
        TableError: it does not.
    """
    _refuse(_iterations(iterations, curves), where)


def _refuse(complaints: Iterable[str], where: str) -> None:
    found = next(iter(complaints), None)
    if found is not None:
        raise TableError(
            f"expected the tables in {where} to agree with each other, found {found}; rows were lost, or the tables are of "
            "different runs: take the run's folder again from where it was made, or run `porse repro` there"
        )


def _iterations(iterations: Sequence[Row], curves: Sequence[Row]) -> Iterator[str]:
    numbers = [row["iteration"] for row in iterations]
    if numbers != [*range(1, len(numbers) + 1)]:
        yield f"the iterations {numbers} in iterations"
    trained = Counter(row["iteration"] for row in curves if row["series"] == "fitness")
    for row in iterations:
        if row["epochs"] != trained[row["iteration"]]:
            yield (
                f"{row['epochs']} epochs of iteration {row['iteration']} in iterations and {trained[row['iteration']]} rows of "
                "fitness in curves"
            )
    if others := sorted({*trained} - {*numbers}):
        yield f"iteration {others[0]} in curves and not in iterations"


def _replies(
    iterations: Sequence[Row], replies: Sequence[Row], verdicts: Sequence[Row], mutants: Sequence[Row]
) -> Iterator[str]:
    asked = {_place(row) for row in replies if row["kind"] in ("reward", "mapping")}
    judged = {_place(row) for row in verdicts}
    for lacking, has, has_not in ((asked - judged, "replies", "verdicts"), (judged - asked, "verdicts", "replies")):
        if lacking:
            iteration, kind, slot, attempt, _ = min(lacking)
            yield f"the {kind} of iteration {iteration}, slot {slot}, attempt {attempt} in {has} and not in {has_not}"
    # A reply of values has no verdict: its first is there, and each further attempt follows one.
    values = {(row["iteration"], row["varied"]) for row in mutants if row["varied"] != DRAW}
    attempts: defaultdict[tuple[int, str], list[int]] = defaultdict(list, {name: [] for name in sorted(values)})
    for row in replies:
        if row["kind"] not in ("reward", "mapping"):
            attempts[row["iteration"], row["kind"]].append(row["attempt"])
    for (iteration, kind), own in attempts.items():
        if sorted(own) != [*range(max(len(own), 1))]:
            yield f"attempts {sorted(own)} to get values of {kind} in replies of iteration {iteration}"
    for row in iterations:
        of = [verdict for verdict in verdicts if verdict["iteration"] == row["iteration"]]
        counts = {"replies": len(of), "valid_replies": sum(verdict["passed"] for verdict in of)}
        for name, count in counts.items():
            if row[name] != count:
                yield f"{row[name]} {name} of iteration {row['iteration']} in iterations and {count} in verdicts"


def _place(row: Row) -> tuple[Any, ...]:
    return row["iteration"], row["kind"], row["slot"], row["attempt"], row["key"]


def _candidates(run: Run) -> Iterator[str]:
    known = {_name(row) for row in run.candidates}
    tables = (("curves", run.curves), ("scores", run.scores), ("survivors", run.survivors), ("mutants", run.mutants))
    for table, rows in tables:
        if strangers := {_name(row) for row in rows} - known:
            yield f"candidate {_said(min(strangers))} in {table} and not in candidates"
    if unranked := known - {_name(row) for row in run.scores}:
        yield f"candidate {_said(min(unranked))} in candidates and not in scores"
    mutants = {_name(row) for row in run.mutants}
    if lost := {_name(row) for row in run.candidates if row["origin"] == "mutant"} - mutants:
        yield f"the mutant {_said(min(lost))} in candidates and not in mutants"


def _name(row: Row) -> tuple[int, str]:
    return row["iteration"], row["candidate_id"]


def _said(name: tuple[int, str]) -> str:
    return f"{name[1]} of iteration {name[0]}"


def _curves(run: Run) -> Iterator[str]:
    epochs: defaultdict[tuple[int, str], defaultdict[str, list[int]]] = defaultdict(lambda: defaultdict(list))
    for row in run.curves:
        epochs[_name(row)][row["series"]].append(row["epoch"])
    for row in run.candidates:
        own = epochs[_name(row)]
        for series in ("fitness", *own):
            count, last = len(own[series]), max(own[series], default=0)
            if series not in _SOMETIMES and (count != row["epochs"] or last != row["epochs"]):
                yield f"{row['epochs']} epochs of {_said(_name(row))} in candidates and {count} rows of its {series} in curves"


def _ranks(run: Run) -> Iterator[str]:
    scores, kept, trained = (_by_rung(rows) for rows in (run.scores, run.survivors, run.curves))
    for (iteration, rung), rows in scores.items():
        where = f"iteration {iteration}, rung {rung}"
        if sorted(row["rank"] for row in rows) != [*range(len(rows))]:
            yield f"a rank missing in scores of {where}"
        surviving = [row["candidate_id"] for row in sorted(rows, key=lambda row: row["rank"]) if row["survives"]]
        listed = sorted(kept.get((iteration, rung), []), key=lambda row: row["rank"])
        if surviving != [row["candidate_id"] for row in listed]:
            yield f"{len(surviving)} survivors in scores of {where} and {len(listed)} in survivors, or others"
    for (iteration, rung), rows in [*trained.items(), *kept.items()]:
        ranked = {row["candidate_id"] for row in scores.get((iteration, rung), [])}
        if unranked := sorted({row["candidate_id"] for row in rows} - ranked):
            yield f"candidate {unranked[0]} at work in iteration {iteration}, rung {rung}, and not in scores"


def _by_rung(rows: Sequence[Row]) -> dict[tuple[int, str], list[Row]]:
    found: defaultdict[tuple[int, str], list[Row]] = defaultdict(list)
    for row in rows:
        found[row["iteration"], row["rung"]].append(row)
    return found


def _evaluation(run: Run, evaluation: Evaluation, params: Params) -> Iterator[str]:
    episodes = [row["episode"] for row in evaluation.episodes]
    if episodes != [*range(params.evaluate.episodes)]:
        yield f"{len(episodes)} episodes of evaluate.episodes = {params.evaluate.episodes} in episodes"
    winner = evaluation.lineage[-1]["candidate_id"]
    if others := sorted({row["candidate_id"] for row in evaluation.episodes} - {winner}):
        yield f"candidate {others[0]} in episodes, where {winner} is the run's winner"
    seeds = [row["seed"] for row in evaluation.seeds]
    if seeds != [*range(1, params.evaluate.seeds + 1)]:
        yield f"the seeds {seeds} in seeds, with evaluate.seeds = {params.evaluate.seeds}"
    wanted = {_name(row): row["epochs"] for row in run.candidates}
    points = Counter((row["seed"], *_name(row)) for row in evaluation.rows)
    for row in evaluation.seeds:
        for link in evaluation.lineage[: row["links"]]:
            count = points[row["seed"], *_name(link)]
            if count != wanted[_name(link)]:
                yield (
                    f"{wanted[_name(link)]} epochs of {_said(_name(link))} in candidates and {count} in evaluation, seed "
                    f"{row['seed']}"
                )
