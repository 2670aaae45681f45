"""Replies without a model: functions and values drawn at random from a small grammar, for tests and as a baseline.

The same variables and the same seed give the same text. A reply looks like a model's: a sentence, then one block. What
the grammar can measure is in `porse.generation.grammar_rules`; here measures are drawn, squashed, weighed and written.
"""

import itertools
import json
import math
from bisect import bisect
from collections.abc import Iterable, Sequence

import numpy as np

from porse.errors import TaskError
from porse.generation.grammar_rules import Measure, measures, role, stem
from porse.search.schedule import ALPHA
from porse.variables import Variable

_SPREAD = 0.8
"""Share of its part of the range that a drawn value may lie in, so that no two values meet."""


def reward_text(variables: Sequence[Variable], seed: int) -> str:
    """Returns a reply with a reward of two to four components.

    In half of the replies the last one is a penalty on the size of the actions; where none is, one does not rest.

    Args:
        variables: what the task offers.
        seed: decides every draw.

    Raises:
        TaskError: the task offers nothing to write about.
    """
    rng = np.random.default_rng(seed)
    rest = _known(variables)
    count = int(rng.integers(2, 5))
    penalised = rng.random() < 0.5 and any(variable.name == "actions" for variable in variables)
    drawn: list[Measure] = []
    while rest and len(drawn) < count - penalised:
        must_move = len(drawn) == count - 1 and all(measure.rests for measure in drawn)
        drawn.append(_draw(rng, [measure for measure in rest if not (must_move and measure.rests)]))
        rest = [measure for measure in rest if measure is not drawn[-1]]
    settings: list[str] = []
    lines: list[str] = []
    weights: dict[str, float] = {}
    for measure in drawn:
        wanted = _wanted(rng, measure)
        squashed, weights[f"{measure.name}_reward"], temperature = _squash(rng, measure, wanted)
        if temperature:
            settings.append(f"{measure.name}_temp: float = {temperature}")
        lines += [f"{measure.name} = {measure.text}", f"{measure.name}_reward = {squashed}"]
    if penalised:
        lines.append("action_penalty = -torch.norm(actions, dim=-1)")
        weights["action_penalty"] = _rounded(0.02 * 2.0 ** rng.uniform(-1.0, 1.0))
    total = " + ".join(f"{weight} * {name}" for name, weight in weights.items())
    components = ", ".join(f'"{name}": {name}' for name in weights)
    body = [*settings, *lines, f"total_reward = {total}", f"return total_reward, {{{components}}}"]
    reads = [*itertools.chain.from_iterable(m.reads for m in drawn), *(["actions"] if penalised else [])]
    result = "Tuple[torch.Tensor, Dict[str, torch.Tensor]]"
    return _reply(
        "This reward weighs",
        [name.removesuffix("_reward") for name in weights],
        _function("compute_reward", reads, result, body),
    )


def mapping_text(variables: Sequence[Variable], seed: int) -> str:
    """Returns a reply with a mapping to one to three progress variables.

    To what may rest the robot's distance from an object is added, from the same one where there is such a distance: the
    stage before it, at a fifth of the weight.

    Args:
        variables: what the task offers.
        seed: decides every draw.

    Raises:
        TaskError: the task offers nothing to write about.
    """
    rng = np.random.default_rng(seed)
    known = _known(variables)
    reaching = [measure for measure in known if measure.reach]
    rest = known if reaching else [measure for measure in known if not measure.rests]
    body: list[str] = []
    reads: list[str] = []
    progress: dict[str, bool] = {}
    for _ in range(1 + bisect([0.5, 0.85], rng.random())):
        if not rest:
            break
        measure = _draw(rng, rest)
        rest = [other for other in rest if other is not measure]
        rises = _wanted(rng, measure) == "high"
        name, text = measure.name, measure.text
        if measure.rests:
            reach = _draw(rng, [other for other in reaching if _bodies(other) & _bodies(measure)] or reaching)
            name, text = f"reach_and_{name}", f"{text} {'-' if rises else '+'} 0.2 * {reach.text}"
            reads += reach.reads
        reads += measure.reads
        progress[name] = rises
        body.append(f"{name} = {text}")
    return _mapping("This mapping follows", reads, body, progress)


def spliced_mapping_text(variables: Sequence[Variable], seed: int) -> str:
    """Returns a reply with a mapping of two or three entries of the state that have nothing to do with the goal.

    Each is an entry of a tensor variable drawn at random, with a direction drawn at random: the ablation of section
    A.2.6 of the paper. One that may never change is averaged with an entry of the robot's own state, which does.

    Args:
        variables: what the task offers.
        seed: decides every draw.

    Raises:
        TaskError: the task offers no tensor that moves.
    """
    rng = np.random.default_rng(seed)
    tensors = [variable for variable in variables if variable.kind == "tensor" and variable.unit != "steps"]
    states = [variable for variable in tensors if variable.name != "actions"]
    moving = [v for v in states if _moves(v)] or [variable for variable in tensors if variable.name == "actions"]
    if not states or not moving:
        raise _nothing(variables)
    count = min(int(rng.integers(2, 4)), sum(math.prod(variable.shape) for variable in states))
    body: list[str] = []
    reads: list[str] = []
    progress: dict[str, bool] = {}
    while len(progress) < count:
        variable = states[int(rng.integers(len(states)))]
        name, text = _entry(rng, variable)
        if name in progress:
            continue
        reads.append(variable.name)
        if not _moves(variable):
            other = moving[int(rng.integers(len(moving)))]
            text = f"0.5 * ({text} + {_entry(rng, other)[1]})"
            reads.append(other.name)
        progress[name] = bool(rng.random() < 0.5)
        body.append(f"{name} = {text}")
    return _mapping("This mapping takes", reads, body, progress)


def values_text(varied: str, count: int, scale: float, seed: int) -> str:
    """Returns a reply with `count` values of beta or alpha, one in each of as many equal parts of the range.

    Args:
        varied: "beta" for pairs of weights that add up to `scale`, "alpha" for numbers in [0, 1].
        count: how many.
        scale: sum of a pair of weights.
        seed: decides every draw.
    """
    rng = np.random.default_rng(seed)
    places = rng.permutation(count)
    margins = (1.0 - _SPREAD) / 2.0 + _SPREAD * rng.random(count)
    shares = [float((place + margin) / count) for place, margin in zip(places, margins, strict=True)]
    found: list[float] | list[dict[str, float]] = [round(share, 6) for share in shares]
    if varied != ALPHA:
        weights = [round(scale * share, 6) for share in shares]
        found = [{"goal": round(scale - weight, 6), "bonus": weight} for weight in weights]
    return f"These values are spread over the range.\n\n```json\n{json.dumps(found)}\n```\n"


def _known(variables: Sequence[Variable]) -> list[Measure]:
    known = measures(variables)
    if all(measure.rests for measure in known):
        raise _nothing(variables)
    return known


def _nothing(variables: Sequence[Variable]) -> TaskError:
    names = ", ".join(variable.name for variable in variables) or "no variable at all"
    return TaskError(
        f"expected variables that a function can be drawn from, found {names}; a task offers at least obs_buf and actions"
    )


def _draw(rng: np.random.Generator, choices: Sequence[Measure]) -> Measure:
    sums = list(itertools.accumulate(measure.weight for measure in choices))
    return choices[min(bisect(sums, rng.random() * sums[-1]), len(choices) - 1)]


def _bodies(measure: Measure) -> set[str]:
    return {stem(name) for name in measure.reads}


def _wanted(rng: np.random.Generator, measure: Measure) -> str:
    return ("low", "high")[int(rng.integers(2))] if measure.wants == "either" else measure.wants


def _squash(rng: np.random.Generator, measure: Measure, wanted: str) -> tuple[str, float, float]:
    """Returns the expression of a component, its weight, and its temperature, 0 for none.

    What may be negative never stands in an exponential, which would overflow where a body falls for long.
    """
    name, sign = measure.name, "-" if wanted == "low" else ""
    ratio = f"{name} / {name}_temp"
    weight = _rounded(rng.uniform(0.5, 2.0))
    temperature = _rounded(measure.scale * 2.0 ** rng.uniform(-1.0, 1.0))
    form = rng.random()
    if form < 0.15:
        return f"{sign}{name}", _rounded(weight / measure.scale), 0.0
    if measure.signed or wanted == "high":
        return f"{sign}torch.tanh({ratio})", weight, temperature
    if form < 0.65:
        return f"torch.exp(-{ratio})", weight, temperature
    if form < 0.85:
        return f"1.0 / (1.0 + torch.square({ratio}))", weight, temperature
    return f"1.0 - torch.tanh({ratio})", weight, temperature


def _moves(variable: Variable) -> bool:
    """Whether every entry of a variable moves with the robot from the first step on."""
    return role(variable) == "robot" and len(variable.shape) == 1


def _entry(rng: np.random.Generator, variable: Variable) -> tuple[str, str]:
    """Returns name and expression of one number of a variable."""
    index = [str(int(rng.integers(size))) for size in variable.shape]
    name = "_".join(["spliced", variable.name, *index])
    return name, f"{variable.name}[:, {', '.join(index)}]" if index else variable.name


def _rounded(value: float) -> float:
    """Returns a number with two digits, as a person would write it."""
    return float(f"{value:.2g}")


def _mapping(sentence: str, reads: Sequence[str], body: Sequence[str], progress: dict[str, bool]) -> str:
    names = ", ".join(f'"{name}"' for name in progress)
    last = f"return [{', '.join(progress)}], [{', '.join(map(str, progress.values()))}], [{names}]"
    result = "Tuple[List[torch.Tensor], List[bool], List[str]]"
    return _reply(sentence, progress, _function("mapping_function", reads, result, [*body, last]))


def _function(name: str, reads: Sequence[str], result: str, body: Sequence[str]) -> str:
    arguments = ", ".join(f"{variable}: torch.Tensor" for variable in dict.fromkeys(reads))
    return "\n".join([f"def {name}({arguments}) -> {result}:", *(f"    {line}" for line in body)])


def _reply(sentence: str, names: Iterable[str], source: str) -> str:
    return f"{sentence} {', '.join(name.replace('_', ' ') for name in names)}.\n\n```python\n{source}\n```\n"
