"""What a run was asked and what came out of it, in words and rows that the page shows: pure functions."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from porse.config import Params
from porse.methods import ABLATIONS, METHODS
from porse.report.charts import Chart, Line, Mark
from porse.report.figures import LENGTHS, chain_fitness
from porse.report.results import Results
from porse.search.schedule import mutants, varied
from porse.tables import Row
from porse.task_names import is_own
from porse.tasks import find_task

_MEASURED = {
    "lineage": "policies trained as long as the lineage of winners",
    "budget": "policies trained with the whole budget",
}
"""What each human normalised score is measured against."""


@dataclass(frozen=True)
class Fact:
    """A name, its value in words, and a note on it; empty for none."""

    name: str
    value: str
    note: str = ""


def figure(value: float | None) -> str:
    """Returns a number as people read it: three digits behind the point, or three that count; "undefined" for None."""
    if value is None:
        return "undefined"
    if not math.isfinite(value):
        return "not a number" if math.isnan(value) else "infinite"
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.3f}" if value == 0 or 0.01 <= abs(value) < 100_000 else f"{value:.3g}"


def asked(params: Params) -> list[Fact]:
    """Returns what was asked for. The text of a task of one's own is left out: to show it, its code would have to run."""
    facts = [Fact("Task", params.task, f"size {params.size}")]
    if is_own(params.task):
        facts.append(Fact("Task text", "not shown", "the task is one of its author's own"))
    else:
        task = find_task(params.task)
        texts = {
            "Task text": task.DESCRIPTION,
            "An episode starts": task.STARTS,
            "An episode ends": task.ENDS,
            "Fitness": task.FITNESS,
        }
        facts += [Fact(name, text) for name, text in texts.items() if text]
    writer = {
        "model": f"the model {params.llm.model}",
        "grammar": "a seeded grammar, no model",
        "files": f"the files in functions/{params.generate.functions}",
    }
    return [
        *facts,
        Fact("Method", params.method, _replaced(METHODS[params.method])),
        Fact("Ablation", params.ablation, _replaced(ABLATIONS[params.ablation])),
        Fact("Functions written by", writer[params.generator]),
        Fact("Seed", str(params.seed), f"numeric profile {params.numerics}"),
    ]


def answers(results: Results) -> list[Fact]:
    """Returns what came out of the run, what matters most first."""
    metrics, evaluation = results.metrics, results.metrics["evaluation"]
    success = metrics["final_success"]
    solved = {row["outcome"] for row in results.evaluation.episodes} <= {0.0, 1.0}
    meaning = "share of whole episodes that it solved" if solved else "mean fitness over whole episodes"
    facts = [
        Fact(
            "Final success",
            f"{figure(success['mean'])} ({figure(success['low'])} to {figure(success['high'])})",
            f"of the winner's mean action: {meaning}, with the 95 % interval, {success['episodes']} episodes",
        ),
        Fact("Score", figure(metrics["score"]), _score_note(results.params)),
        Fact("MTS", figure(metrics["mts"]), "the highest fitness of an epoch that any training reached"),
    ]
    facts += [_normalised(length, metrics["hns"][length], results.params) for length in LENGTHS]
    for name, what in (("score", "Score"), ("mts", "MTS")):
        mean, deviation = evaluation[f"{name}_mean"], evaluation[f"{name}_std"]
        if mean is not None:
            spread = "" if deviation is None else f" ± {figure(deviation)}"
            note = "the lineage of winners, trained again; mean" + (" and deviation" if spread else "")
            facts.append(
                Fact(f"{what}, {_count(evaluation['seeds'], 'further seed')}", f"{figure(mean)}{spread}", note)
            )
    facts += [
        Fact(f"Seed {row['seed']}", "failed", row["failure"]) for row in results.evaluation.seeds if row["failure"]
    ]
    return facts


def winners_chart(results: Results) -> Chart:
    """Returns the chart of fitness along the lineage of winners, with a mark where each link and each rung begins."""
    points = chain_fitness(results.run.curves, results.evaluation.chain)
    lines, marks = [], []
    rungs = {
        (row["iteration"], row["candidate_id"], row["epoch"]): row["rung"]
        for row in results.run.curves
        if row["series"] == "fitness"
    }
    previous: tuple[Any, Any] = (None, None)
    epoch_of_link = 0
    for number, (link, _) in enumerate(points, 1):
        name = (link["iteration"], link["candidate_id"])
        epoch_of_link = epoch_of_link + 1 if previous[0] == name else 1
        rung = rungs.get((*name, epoch_of_link))
        if previous[0] != name:
            marks.append(Mark(number, f"{link['iteration']}: {link['origin']}"))
        elif previous[1] != rung:
            marks.append(Mark(number))
        previous = (name, rung)
    lines.append(Line("fitness of the winner", [(n, value) for n, (_, value) in enumerate(points, 1)], strong=True))
    return Chart("Fitness along the lineage of winners", "epoch of the lineage", "fitness", lines, marks)


def weights(results: Results) -> list[dict[str, Any]]:
    """Returns, for each iteration, beta and alpha of its winner, what mutants varied, and the values that they took."""
    found = []
    for row in results.iterations:
        n = row["iteration"]
        own = [mutant for mutant in results.run.mutants if mutant["iteration"] == n]
        kind = varied(results.params, n) if mutants(results.params, n) else ""
        found.append(
            {
                "iteration": n,
                "winner": row["winner_id"],
                "beta": row["beta"],
                "alpha": row["alpha"],
                "varied": kind if own else "",
                "values": [mutant["value"] for mutant in own],
            }
        )
    return found


def weights_chart(results: Results) -> Chart:
    """Returns the chart of the winners' beta and alpha by iteration."""
    lines = [
        Line(name, [(row["iteration"], row[name]) for row in results.iterations], strong=True)
        for name in ("beta", "alpha")
    ]
    return Chart("Weights of the winners", "iteration", "weight", lines)


def repliers(replies: Sequence[Row]) -> list[dict[str, Any]]:
    """Returns a row for each of those who answered: replies by kind, tokens, cost when recorded; the most replies first."""
    names = sorted({row["answered_by"] for row in replies})
    found = []
    for name in names:
        own = [row for row in replies if row["answered_by"] == name]
        kinds = sorted({row["kind"] for row in own})
        found.append(
            {
                "name": name or "not said",
                "replies": len(own),
                "kinds": ", ".join(f"{sum(row['kind'] == kind for row in own)} {kind}" for kind in kinds),
                "prompt_tokens": sum(row["prompt_tokens"] for row in own),
                "completion_tokens": sum(row["completion_tokens"] for row in own),
                "usd": math.fsum(row["recorded_usd"] for row in own),
            }
        )
    return sorted(found, key=lambda row: (-row["replies"], row["name"]))


def budget(results: Results) -> list[Fact]:
    """Returns what was spent, of what was allowed."""
    metrics = results.metrics
    spent, allowed = metrics["epochs_spent"], metrics["epochs_allowed"]
    share = f"{100 * spent / allowed:.0f} % of the {figure(allowed)} that any method may spend" if allowed else ""
    return [
        Fact("Epochs spent", figure(spent), share),
        Fact("Environment steps", figure(metrics["environment_steps"])),
        Fact("Epochs to the threshold", *_threshold(results)),
    ]


def _threshold(results: Results) -> tuple[str, str]:
    threshold = results.params.summarise.thresholds.get(results.params.task)
    reached = results.metrics.get("epochs_to_threshold")
    if threshold is None:
        return "undefined", f"no threshold is given for {results.params.task} (summarise.thresholds)"
    note = f"until a fitness first reached {figure(threshold)}"
    return ("never reached", note) if reached is None else (figure(reached), note)


def _score_note(params: Params) -> str:
    if params.eliminate.score == "max":
        return "the winner's highest fitness, by which it was ranked"
    return f"the winner's mean fitness over its last {_count(params.eliminate.window, 'epoch')}, by which it was ranked"


def _normalised(length: str, value: float | None, params: Params) -> Fact:
    name = f"Human normalised score, by {length}"
    if value is not None:
        return Fact(name, figure(value), f"0: sparse reward, 1: human reward; against {_MEASURED[length]}")
    if params.task not in params.summarise.references:
        return Fact(name, "undefined", f"no reference is given for {params.task} (summarise.references)")
    return Fact(name, "undefined", "human and sparse reward reach the same fitness in the references")


def _replaced(sections: Mapping[str, Mapping[str, Any]]) -> str:
    values = [f"{s}.{key}: {json.dumps(value)}" for s, own in sections.items() for key, value in own.items()]
    return ", ".join(values)


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"
