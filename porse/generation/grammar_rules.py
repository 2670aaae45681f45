"""The words of the model-free grammar: what can be measured from a task's variables, and how likely each measure is.

A rule is typed: it reads shape, unit and frame of the variables, and their names only to tell the robot, its goal and
everything else apart. No state is looked at. What a rule cannot know to move from the first step on, such as an object on a
table, is marked as resting, so that no function reads it alone.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from porse.variables import Variable

Wants = Literal["low", "high", "either"]
Role = Literal["robot", "goal", "still", "object"]
Quantity = Literal["position", "rotation", "velocity", "spin"]

_GOAL = frozenset(("goal", "target"))
_STILL = frozenset(
    ("targets", "default", "limits", "lower", "upper", "gravity", "start", "commands", "prev", "local", "basis")
)
"""What never moves, or means nothing alone. `targets` of Humanoid is a kilometre away: no distance to it is of use."""
_ROBOT = frozenset(("root", "dof", "franka", "shadow", "fingertip"))
"""First words of a robot's own variables; any name with the word `hand` is one too."""
_SIDES = frozenset(("left", "right", "another"))
_ENDINGS = frozenset(
    ("pos", "positions", "rot", "quats", "linvel", "linvels", "angvel", "angvels", "state", "states", "dof", "vel")
)
_WHOLE: dict[tuple[tuple[int, ...], str], Quantity] = {
    ((3,), "m"): "position",
    ((4,), "1"): "rotation",
    ((3,), "m/s"): "velocity",
    ((3,), "rad/s"): "spin",
}
_STATE: tuple[tuple[Quantity, int, int], ...] = (
    ("position", 0, 3),
    ("rotation", 3, 7),
    ("velocity", 7, 10),
    ("spin", 10, 13),
)
"""Columns of a body's state, which has the unit `_STATE_UNIT`."""
_STATE_UNIT = "m, 1, m/s, rad/s"


@dataclass(frozen=True)
class Measure:
    """A number of each environment, float `(num_envs,)`.

    Attributes:
        name: a readable name.
        text: the expression that gives it.
        reads: the variables in the expression.
        wants: the direction that the task most likely wants.
        scale: a usual size of it, in its unit.
        signed: it may be negative.
        rests: it may be one number in every environment until the robot reaches something.
        reach: it is the distance of the robot from an object.
        weight: how likely it is drawn, against the others.
    """

    name: str
    text: str
    reads: tuple[str, ...]
    wants: Wants
    scale: float
    signed: bool = False
    rests: bool = False
    reach: bool = False
    weight: float = 1.0


@dataclass(frozen=True)
class _Part:
    """A position, rotation or velocity: a variable, some columns of it, or the mean of its rows."""

    quantity: Quantity
    variable: Variable
    text: str
    start: int

    @property
    def stem(self) -> str:
        return stem(self.variable.name)

    @property
    def role(self) -> Role:
        return role(self.variable)

    def column(self, index: int) -> str:
        """Returns the expression of one of its columns."""
        rows = self.variable.name if len(self.variable.shape) == 1 else self.text
        return f"{rows}[:, {self.start + index}]"


def stem(name: str) -> str:
    """Returns a variable's name without its last words that only say what is measured: `object_pos` -> `object`."""
    words = name.split("_")
    while len(words) > 1 and words[-1] in _ENDINGS:
        words.pop()
    return "_".join(words)


def role(variable: Variable) -> Role:
    """Returns whose variable this is, by the words of its name."""
    words = variable.name.split("_")
    if _GOAL & set(words):
        return "goal"
    if _STILL & set(words):
        return "still"
    return "robot" if words[0] in _ROBOT or "hand" in words else "object"


def measures(variables: Sequence[Variable]) -> list[Measure]:
    """Returns every measure that the grammar knows for a task, in the order of its variables.

    Some of them never rest; a task whose variables fit no rule gets the columns of its observations.
    """
    tensors = [variable for variable in variables if variable.kind == "tensor"]
    parts = [part for variable in tensors for part in _parts(variable)]
    taken = {variable.name for variable in variables}
    found = [*_distances(parts), *_turns(parts), *_motions(parts), *_joints(tensors), *_lone(tensors)]
    found += _command_errors(tensors, parts)
    found = [measure for measure in found if measure.name not in taken]
    if any(not measure.rests for measure in found):
        return found
    columns = [(v.name, i) for v in tensors if v.name == "obs_buf" for i in range(v.shape[0])]
    return found + [Measure(f"seen_{i}", f"{n}[:, {i}]", (n,), "either", 1.0, signed=True) for n, i in columns]


def _parts(variable: Variable) -> Iterator[_Part]:
    name, shape = variable.name, variable.shape
    if variable.frame != "world":
        return
    if (shape, variable.unit) in _WHOLE:
        yield _Part(_WHOLE[shape, variable.unit], variable, name, 0)
    elif len(shape) == 2 and shape[1] == 3 and variable.unit == "m":
        yield _Part("position", variable, f"{name}.mean(dim=1)", 0)
    elif shape == (13,) and variable.unit == _STATE_UNIT and role(variable) != "goal":
        # The state of a goal says again what its position and rotation say.
        for quantity, start, end in _STATE:
            yield _Part(quantity, variable, f"{name}[:, {start}:{end}]", start)


def _ends(parts: Sequence[_Part], quantity: Quantity) -> list[_Part]:
    """Returns what a distance may go to; a goal at the object's own place says nothing about the task."""
    usable = [p for p in parts if p.quantity == quantity and p.role != "still"]
    return [p for p in usable if p.role != "goal" or "own place" not in p.variable.meaning]


def _pairs(ends: Sequence[_Part], weights: dict[frozenset[Role], float]) -> Iterator[tuple[_Part, _Part, float]]:
    """Yields pairs, robot first and goal last, with their share of the weight of their roles.

    Of equal roles, pairs of the same side are three times as likely: the left hand and the left handle.
    """
    order = ("robot", "object", "goal", "still")
    for roles, weight in weights.items():
        pairs = [
            sorted(pair, key=lambda part: order.index(part.role))
            for pair in itertools.combinations(ends, 2)
            if {part.role for part in pair} == roles and pair[0].variable.meaning != pair[1].variable.meaning
        ]
        likelihoods = [3.0 if _side(a) == _side(b) else 1.0 for a, b in pairs]
        for (a, b), likelihood in zip(pairs, likelihoods, strict=True):
            yield a, b, weight * likelihood / sum(likelihoods)


def _side(part: _Part) -> frozenset[str]:
    return _SIDES & frozenset(part.variable.name.split("_"))


def _distances(parts: Sequence[_Part]) -> Iterator[Measure]:
    """Yields distances in metres: object to goal is the likeliest, or robot to goal without an object."""
    ends = _ends(parts, "position")
    roles = {part.role for part in ends}
    weights: dict[frozenset[Role], float] = {
        frozenset(("object", "goal")): 6.0,
        frozenset(("robot", "goal")): 0.5 if "object" in roles else 6.0,
        frozenset(("robot", "object")): 4.0,
        frozenset(("object",)): 1.0 if "goal" in roles else 3.0,
    }
    for a, b, weight in _pairs(ends, weights):
        rests, reach = a.role == "object", a.role == "robot" and b.role == "object"
        wants: Wants = "either" if b.role == "object" == a.role else "low"
        text = f"torch.norm({a.text} - {b.text}, dim=-1)"
        reads = (a.variable.name, b.variable.name)
        yield Measure(f"{a.stem}_to_{b.stem}", text, reads, wants, 0.5, rests=rests, reach=reach, weight=weight)


def _turns(parts: Sequence[_Part]) -> Iterator[Measure]:
    """Yields angles between two rotations, in radians."""
    weights: dict[frozenset[Role], float] = {
        frozenset(("object", "goal")): 2.0,
        frozenset(("robot", "goal")): 0.25,
        frozenset(("robot", "object")): 0.5,
    }
    for a, b, weight in _pairs(_ends(parts, "rotation"), weights):
        name, text = f"{a.stem}_turn_to_{b.stem}", f"rot_dist({a.text}, {b.text})"
        yield Measure(
            name, text, (a.variable.name, b.variable.name), "low", 1.0, rests=a.role == "object", weight=weight
        )


def _motions(parts: Sequence[_Part]) -> Iterator[Measure]:
    """Yields heights, speeds and tilts of single bodies: of a robot's root, and of objects."""
    for part in parts:
        of, reads, rests = part.stem, (part.variable.name,), part.role == "object"
        if part.role in ("goal", "still") or (not rests and part.stem != "root"):
            continue
        found: list[Measure] = []
        if part.quantity == "position":
            found = [Measure(f"{of}_height", part.column(2), reads, "high", 1.0, signed=True)]
        elif part.quantity == "velocity":
            found = [
                Measure(f"{of}_speed", f"torch.norm({part.text}, dim=-1)", reads, "either", 1.0),
                Measure(f"{of}_forward_speed", part.column(0), reads, "high", 1.0, signed=True),
            ]
        elif part.quantity == "spin":
            found = [Measure(f"{of}_spin", f"torch.norm({part.text}, dim=-1)", reads, "low", 4.0)]
        elif not rests:
            sideways = f"{part.variable.name}[:, {part.start}:{part.start + 2}]"
            text = f"1.0 - 2.0 * torch.sum(torch.square({sideways}), dim=-1)"
            found = [Measure(f"{of}_uprightness", text, reads, "high", 1.0, signed=True)]
        for measure in found:
            yield dataclasses.replace(measure, rests=rests, weight=0.3 if rests else 1.0)


def _joints(tensors: Sequence[Variable]) -> Iterator[Measure]:
    """Yields values of joints, their distance from the default ones where a task has these, and the robot's speeds."""
    joints = [v for v in tensors if v.frame == "joint" and len(v.shape) == 1 and role(v) in ("robot", "object")]
    names = {v.name: v for v in tensors}
    for v in joints:
        of, rests = stem(v.name), role(v) == "object"
        weight = 3.0 if rests else 0.25
        if v.unit in ("rad", "rad, m"):
            for i in range(v.shape[0]):
                share = weight / v.shape[0]
                name, text = f"{of}_joint_{i}", f"{v.name}[:, {i}]"
                yield Measure(name, text, (v.name,), "either", 0.5, signed=True, rests=rests, weight=share)
            usual = names.get(f"default_{v.name}")
            if usual is not None and usual.shape == v.shape:
                text = f"torch.norm({v.name} - {usual.name}, dim=-1)"
                yield Measure(f"{of}_off_default", text, (v.name, usual.name), "low", 1.0, weight=2.0)
        elif v.unit in ("rad/s", "rad/s, m/s") and not rests:
            text = f"torch.norm({v.name}, dim=-1)"
            yield Measure(f"{of}_joint_speed", text, (v.name,), "low", 20.0, weight=0.5)


def _lone(tensors: Sequence[Variable]) -> Iterator[Measure]:
    """Yields single coordinates of axes, and how much a number rose in the last step where a task keeps both."""
    names = {v.name: v for v in tensors}
    for v in tensors:
        before = names.get(f"prev_{v.name}")
        if before is not None and v.shape == before.shape == ():
            text, reads = f"{v.name} - {before.name}", (v.name, before.name)
            yield Measure(f"{stem(v.name)}_gain", text, reads, "high", 2.0, signed=True, weight=6.0)
        elif (v.shape, v.unit, v.frame) == ((3,), "1", "world") and role(v) not in ("goal", "still"):
            upward = "up" in v.name.split("_")
            name, text = f"{v.name}_{'z' if upward else 'x'}", f"{v.name}[:, {2 if upward else 0}]"
            yield Measure(name, text, (v.name,), "high", 1.0, signed=True)


def _command_errors(tensors: Sequence[Variable], parts: Sequence[_Part]) -> Iterator[Measure]:
    """Yields how far the root's velocity in its own frame is from a commanded one, in m/s."""
    root = {part.quantity: part for part in parts if part.role == "robot" and part.stem == "root"}
    for v in tensors:
        if (v.unit, v.frame) == ("m/s, m/s, rad/s", "body") and {"rotation", "velocity"} <= root.keys():
            turn, velocity = root["rotation"], root["velocity"]
            text = f"torch.norm({v.name}[:, 0:2] - quat_rotate_inverse({turn.text}, {velocity.text})[:, 0:2], dim=-1)"
            reads = (v.name, turn.variable.name, velocity.variable.name)
            yield Measure(f"{stem(v.name)}_error", text, reads, "low", 1.0, weight=6.0)
