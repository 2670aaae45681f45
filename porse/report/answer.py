"""What a run was asked and what came out of it, in words and rows that the page shows: pure functions."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from porse.config import ROOT, Params
from porse.methods import ABLATIONS, METHODS
from porse.presets import GIVEN, find_preset, preset_file
from porse.printing import counted
from porse.report import paper
from porse.report.charts import Chart, Line, Mark, Point
from porse.report.detail import STREAMS, series_of
from porse.report.figures import LENGTHS, lineage_fitness
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

NOBODY = "nobody"

_WRITERS = {
    "model": "the model {params.llm.model}",
    "grammar": "a seeded grammar, no model",
    "files": "the files in functions/{params.generate.functions}",
    NOBODY: "nobody: the reward is the task's own",
}
_NOTHING_GIVEN = {section: dict.fromkeys(keys) for section, keys in GIVEN.items()}
"""Parameters of which the preset gives all that it can."""


@dataclass(frozen=True)
class Beside:
    """A name, what it is here, and what it is in the paper."""

    name: str
    here: str
    paper: str


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


def author_of(params: Params) -> str:
    """Returns who writes a run's functions: `model`, `grammar` or `files`, or `nobody` where it has none but the task's own."""
    writes_mappings = params.candidate.bonus == "mapping" and params.generate.mappings == "generator"
    return params.generator if params.candidate.goal == "generated" or writes_mappings else NOBODY


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
    return [
        *facts,
        Fact("Method", params.method, _replaced(METHODS[params.method])),
        Fact("Ablation", params.ablation, _replaced(ABLATIONS[params.ablation])),
        Fact("Functions written by", _WRITERS[author_of(params)].format(params=params)),
        Fact("Seed", str(params.seed), f"numeric profile {params.numerics}"),
    ]


def answers(results: Results) -> list[Fact]:
    """Returns what came out of the run, what matters most first."""
    figures = results.figures
    solved = {row["outcome"] for row in results.evaluation.episodes} <= {0.0, 1.0}
    meaning = "share of whole episodes that it solved" if solved else "mean fitness over whole episodes"
    facts = [
        Fact(
            "Final success",
            f"{figure(figures['success'])} ({figure(figures['success_low'])} to {figure(figures['success_high'])})",
            f"of the winner's mean action: {meaning}, with the 95 % interval, {figures['episodes']} episodes",
        ),
        Fact("Score", figure(figures["score"]), _score_note(results.params)),
        Fact("MTS", figure(figures["mts"]), "the highest fitness of an epoch that any training reached"),
    ]
    facts += [_normalised(length, figures[f"hns_{length}"], results.params) for length in LENGTHS]
    for name, what in (("score", "Score"), ("mts", "MTS")):
        mean, deviation = figures[f"evaluation_{name}_mean"], figures[f"evaluation_{name}_std"]
        if mean is not None:
            spread = "" if deviation is None else f" ± {figure(deviation)}"
            note = "the lineage of winners, trained again; mean" + (" and deviation" if spread else "")
            facts.append(
                Fact(f"{what}, {counted(figures['evaluation_seeds'], 'further seed')}", f"{figure(mean)}{spread}", note)
            )
    facts += [
        Fact(f"Seed {row['seed']}", "failed", row["failure"]) for row in results.evaluation.seeds if row["failure"]
    ]
    return facts


def beside_paper(results: Results) -> list[Beside]:
    """Returns MTS and human normalised score beside those of the paper, then what differs; empty where it has no such task."""
    params, figures = results.params, results.figures
    value = paper.find_mts(params.task, params.method, params.ablation)
    if value is None:
        return []
    own, theirs = params.train, _original(params.task)
    longest = max(sum(1 for row in results.run.curves if _is_fitness_of(row, each)) for each in results.iterations)
    spread = "" if value.std is None else f" ± {figure(value.std)}"
    score = paper.find_score(params.task, params.method, params.ablation)
    hns = figures["hns_lineage"]
    return [
        Beside("MTS", figure(figures["mts"]), f"{figure(value.mean)}{spread} (table {value.table})"),
        Beside("Human normalised score", figure(hns), figure(score)),
        Beside("Seeds", "1", str(paper.SEEDS)),
        Beside("Simulator", "MuJoCo (docs/tasks.md)", paper.SIMULATOR),
        Beside("Model", _WRITERS[author_of(params)].format(params=params), paper.MODEL),
        Beside("Environments", figure(own.num_envs), _given(theirs, "num_envs")),
        Beside("Steps of each in an epoch", figure(own.steps_per_epoch), _given(theirs, "steps_per_epoch")),
        Beside("Epochs of a winner in an iteration", figure(longest), figure(paper.POLICY_EPOCHS)),
        Beside("Epochs of the whole run", figure(figures["epochs_spent"]), figure(paper.EPOCHS)),
        Beside("Network", _network(own.hidden), _network(theirs["hidden"]) if theirs else "not known"),
    ]


def winners_chart(results: Results) -> Chart:
    """Returns the chart of fitness along the lineage of winners, with a mark where a link and where a rung begins, and at the end.

    One with a word stands where a link begins. Every mark but the first says how many mutants came and how many candidates went
    in the rungs since the one before.
    """
    points = lineage_fitness(results.run.curves, results.evaluation.lineage)
    order = [str(rung.rung) for rung in results.params.rungs]
    rungs = {
        (row["iteration"], row["candidate_id"], row["epoch"]): row["rung"]
        for row in results.run.curves
        if row["series"] == "fitness"
    }
    turnover = _turnover(results.run.scores, order)
    marks: list[Mark] = []
    previous: tuple[Any, Any] = (None, None)
    epoch_of_link = ended = 0
    for number, (link, _) in enumerate(points, 1):
        name = (link["iteration"], link["candidate_id"])
        begins = previous[0] != name
        epoch_of_link = 1 if begins else epoch_of_link + 1
        rung = rungs.get((*name, epoch_of_link))
        if begins or previous[1] != rung:
            until = len(order) if begins else order.index(str(rung))
            gone = turnover.get(previous[0][0], [])[ended:until] if previous[0] else []
            ended = 0 if begins else until
            marks.append(Mark(number, f"{name[0]}: {link['origin']}" if begins else "", *_came_and_went(gone)))
        previous = (name, rung)
    if points:
        marks.append(Mark(len(points), "", *_came_and_went(turnover.get(previous[0][0], [])[ended:])))
    line = Line("fitness", [(n, value) for n, (_, value) in enumerate(points, 1)], strong=True)
    return Chart("Fitness along the lineage of winners", "epoch of the lineage", "fitness", [line], marks, wide=True)


def lineage_charts(results: Results) -> list[Chart]:
    """Returns the charts of goal and bonus along the lineage of winners, those that there are."""
    series = series_of(results.run.curves)
    marks: list[Mark] = []
    lines: dict[str, list[Point]] = {}
    before = 0
    for link in results.evaluation.lineage:
        own = series.get((link["iteration"], link["candidate_id"]), {})
        marks.append(Mark(before + 1, str(link["iteration"])))
        epochs = [int(epoch) for epoch, _ in own.get("fitness", [])]
        if not epochs:
            continue
        for name in {name for *_, named in STREAMS for name in named if name in own}:
            points = lines.setdefault(name, [])
            points += [(before + 1 + epoch - epochs[0], value) for epoch, value in own[name]]
        before += epochs[-1] - epochs[0] + 1
    return [
        Chart(
            title,
            "epoch of the lineage",
            unit,
            [Line(word, lines[name]) for name, word in names.items() if name in lines],
            marks,
        )
        for title, unit, names in STREAMS
        if any(name in lines for name in names)
    ]


def _turnover(scores: Sequence[Row], order: Sequence[str]) -> dict[int, list[tuple[int, int]]]:
    """Returns, by iteration, for each of its rungs how many candidates first took part in it, and how many went after it.

    Those of the first rung are none that came: the iteration began with them.
    """
    found: dict[int, list[tuple[int, int]]] = {}
    for iteration in dict.fromkeys(row["iteration"] for row in scores):
        seen: set[str] = set()
        for place, rung in enumerate(order):
            own = [row for row in scores if (row["iteration"], row["rung"]) == (iteration, rung)]
            names = {row["candidate_id"] for row in own}
            came = len(names - seen) if place else 0
            seen |= names
            found.setdefault(iteration, []).append((came, sum(not row["survives"] for row in own)))
    return found


def _came_and_went(rungs: Sequence[tuple[int, int]]) -> tuple[str, str]:
    came, went = (sum(each[place] for each in rungs) for place in (0, 1))
    return f"+{came}" if came else "", f"\u2212{went}" if went else ""


def _is_fitness_of(row: Row, iteration: Row) -> bool:
    """Returns whether a row of the curves is one of the fitness of an iteration's winner."""
    name = (iteration["iteration"], iteration["winner_id"], "fitness")
    return (row["iteration"], row["candidate_id"], row["series"]) == name


def _original(task: str) -> Mapping[str, Any]:
    """Returns the numbers of the original's training, which the preset of size `paper` holds; none outside a project."""
    if not (ROOT / preset_file(task)).is_file():
        return {}
    preset = find_preset({**_NOTHING_GIVEN, "task": task, "size": "paper"}, task, ROOT)
    return preset.values["train"] if preset else {}


def _given(values: Mapping[str, Any], key: str) -> str:
    return figure(values[key]) if key in values else "not known"


def _network(hidden: Sequence[int]) -> str:
    return " x ".join(map(str, hidden))


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
    figures = results.figures
    spent, allowed = figures["epochs_spent"], figures["epochs_allowed"]
    share = f"{100 * spent / allowed:.0f} % of the {figure(allowed)} that any method may spend" if allowed else ""
    return [
        Fact("Epochs spent", figure(spent), share),
        Fact("Environment steps", figure(figures["environment_steps"])),
        Fact("Epochs to the threshold", *_threshold(results)),
    ]


def _threshold(results: Results) -> tuple[str, str]:
    threshold = results.params.summarise.thresholds.get(results.params.task)
    reached = results.figures["epochs_to_threshold"]
    if threshold is None:
        return "undefined", f"no threshold is given for {results.params.task} (summarise.thresholds)"
    note = f"until a fitness first reached {figure(threshold)}"
    return ("never reached", note) if reached is None else (figure(reached), note)


def _score_note(params: Params) -> str:
    if params.eliminate.score == "max":
        return "the winner's highest fitness, by which it was ranked"
    return (
        f"the winner's mean fitness over its last {counted(params.eliminate.window, 'epoch')}, by which it was ranked"
    )


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
