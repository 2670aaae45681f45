"""The index `docs/tasks.md`, what tasks learned, and a page of each task with its charts, from the tasks themselves: `python -m porse.report.task_pages docs`."""

import csv
import inspect
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from porse.picture import picture, write_png
from porse.report.charts import Chart, Line
from porse.report.learning import CURVES, TABLE, published_curves
from porse.report.svg import svg
from porse.report.task_layout import layout
from porse.task_names import TAGS, TASK_TAGS
from porse.tasks import TASKS, make_task
from porse.tasks.base import Task

PAGES = "tasks"
PICTURES = "pictures"
TRAINED = "trained"
"""Pictures of trained policies, by `porse.report.trained`, and the curves of their trainings, which are drawn here."""

WIDTH, HEIGHT = 320, 240
COLUMNS = 4

STEPS = "thousand environment steps"

HEAD = """# The tasks

The paper's 24 tasks and `SwitchReachable` are rebuilt in MuJoCo. Names, observations, actions, variables, rewards, ends of
episodes and fitness are those of the Isaac Gym and Bi-DexHands tasks. The scenes are our own, with the originals' dimensions,
masses and joint ranges. If MuJoCo forces a departure, the page of the task says so.

`python -m porse.report.task_pages docs` writes this page, the page of each task and its picture; do not edit them.
"""

COMMON = """## What all tasks share

- The first dimension is `num_envs`. Numbers are float32, in the world frame and in SI units; quaternions are (x, y, z, w).
  The pages name exceptions.
- Actions lie in [-1, 1].
- The *sparse reward* is the fitness of each step. The *human reward* is the original's own reward.
- In Quadcopter, Anymal and Humanoid, the fitness of an epoch is the mean over environments and steps. The other tasks are
  solved or not; their fitness is the original's statistic over episodes, at the end of the epoch.
- A training staggers its episodes: the first ones have head starts, spread evenly over the time limit. If a task is solved
  or not, episodes with a head start have no outcome.
- A simulation that diverges starts again. Its episode ends, and `blown_up` counts it.
- The texts for the model say what the originals' texts say, in our own words. The originals swap the texts of opening and
  closing doors, and speak of a bottle in Switch; ours say what each task is. The text of CatchOver2Underarm keeps the
  original's second egg.
- Functions written for the originals find all their names, with the original's meaning. Two names differ in form:
  `root_state_tensor` is `(num_envs, actors, 13)`, where the originals have one array of all actors; therefore
  `object_indices` and the like are columns, and `root_state_tensor[object_indices, 0:3]` works as intended.
  `fingertip_handles` are tuples of ints.

## What the two-hand tasks share

- Both hands are the right Shadow Hand of `gymnasium-robotics`, without gravity, with 20 position actuators each. A tendon
  with a hard limit of 1 mm couples the last two joints of a finger. The original has a spring there, with stiffness 30 and
  damping 0.1.
- Actions of fixed hands are 20 joint targets for the right hand and 20 for the left; -1 and 1 are the joint's limits. Actions
  of free hands are 3 forces, 3 torques and 20 joint targets for each hand. Forces and torques act on the forearm, in the
  world frame.
- Links of free hands have the original's damping of 100 1/s, those of fixed hands 0.01 1/s (see *How things move*).
- Force and torque sensors sit at the last finger links. A joint torque is the sum of actuator, passive and constraint torques.
  Both come from the last physics step, and are zero when an episode starts.
- Start noise is clipped at the joint's range.
- Some originals start an object inside the table, and the solver pushes it out. Ours start it on the table.
- Contacts have an elliptic friction cone; Newton's method with dense matrices solves them. With sparse matrices, MuJoCo's
  default, it sometimes does not converge, and fingers pressed between two bodies shoot away. An object's friction is the mean
  of the original's pair, as PhysX combines them.
- Weights of objects act as outer forces at their centres of mass, and gravity is off, since the hands are weightless.
- A forearm starts to repel the other hand 6 mm before they touch: under full force, two hands approach by 4.6 mm in one
  physics step.
- The joint springs that the originals set on doors, pen and bottle are off, as their drive mode says. Hinges and slides have a
  little friction instead.
- `goal_pos` of doors, Scissors, Switch, Kettle, Pen and GraspAndPlace lies 10 m above the object's start, as in the originals
  (5 m in DoorOpenOutward, 1 m in SwingCup and BottleCap). It says nothing about the task.
- Kettle, bucket, cup, pot, bottle, pen and scissors look round. They collide as boxes and cylinders that stand for the
  originals' meshes (group 3 in MuJoCo's viewer).
- Rockers, lids and similar parts start every episode in the same place. In the original, Switch and Kettle leave them where
  they are.

## How things move

- **Drag.** PhysX multiplies a damped link's velocity once per physics step, between outer forces and contacts:
  v' = (1 - c dt) (v + F dt / m). With c = 100 1/s and dt = 0.008335 s, a hand keeps a sixth of its velocity, and an action
  of 1 (833 N) moves it at 0.28 m/s. All links of a hand have the same c for linear and angular velocity, and the velocities
  of links are linear in those of joints. So we multiply the velocities of all joints of the hand, and the forces and torques
  of the action, by 1 - c dt before each step, but not contacts and drives. MuJoCo's implicit damping,
  v' = (v + F dt / m) / (1 + c' dt), gives a free body the same motion with c' = c / (1 - c dt): 600 1/s, not 100. This form
  reproduces the published early training of the originals, and c' = 100 does not ([calibration](calibration.csv)). It was
  fitted to these data, not read from PhysX's code.
- **Drives.** The force limit applies to stiffness and damping together, as in PhysX. The Panda's wrist has explicit gains
  that have the effect of an implicit drive within a step, since MuJoCo's own drive would jerk it by 0.9 rad/s in every step.
  The damping of its fingers acts beside the drive, whose limit their highest lead cannot exceed.
- **Highest speeds.** The lead of the Panda's targets over its joints is limited to what drives them at the robot's 2.175,
  2.61 rad/s and 0.2 m/s; blows can still turn its wrist faster. The quadruped's joints begin a physics step at 20 rad/s at
  most and end it at up to 25. Doors (100), pen (1 m/s) and Shadow Hand (none) never come near their bounds.
- **Open questions.** Does PhysX scale the damping as above in all versions? Does a force act in both physics steps of a
  control step (here: yes) or in the first only? Do the originals' objects have Isaac Gym's default damping (here: none)? Do
  joint springs of doors, pen and bottle act (here: no)? The humanoid's link damping of 0.01 1/s is left out.

## Calibration

```sh
python -m porse.report.calibration docs/calibration.csv
```

This command writes [calibration.csv](calibration.csv): return and shortest episode of all tasks, under random actions
N(0, 0.8), clipped, and under zero action. For originals with published figures of their first training, it says whether ours
agree: a return within a factor of 1.5, a shortest episode within a factor of 2. Rows without a published figure are uncalibrated:
all of Quadcopter, FrankaCabinet, Anymal, Humanoid, ReOrientation, Scissors, SwingCup, Switch, Kettle, LiftUnderarm, Pen and
PushBlock, and zero action everywhere.

## What they learn

[What human rewards teach](learning.md) says in words which tasks learn on a CPU with their human reward, and why the rest does not;
[learned](learned.md) has the figures.
"""


HUMAN = """# What the human rewards teach, in figures

`python -m porse.report.task_pages docs` writes this page from two tables; do not edit it.

```sh
porse suite run suites/learning.yaml
python -m porse.report.learning .porse/suites/learning/results docs
python -m porse.report.trained .porse/suites/learning/results docs/trained
```

These commands train each task with its human reward for as many epochs as a winning lineage of its preset has, and six tasks for
up to three times as many. They write [learning.csv](learning.csv), [learning-curves.csv](learning-curves.csv), and pictures of
the trained policies. The page of each task shows its pictures and curves; [what human rewards teach](learning.md) says in words
what learns, and why the rest does not.

Fitness is that of zero action, of random actions N(0, 0.8), and of training: the mean over the first ten epochs, where the policy
is about random, over the last ten, and the highest of any epoch (MTS). *Final* is what the trained policy's mean action is worth
in 256 whole episodes. A task *learns* if its last epochs beat both policies that know nothing by at least a tenth of the gap
between the better one and the best possible fitness. The best possible fitness is 0 where fitness is minus a distance, the
paper's figure for Humanoid, and 1 for all other tasks. The paper's MTS with the same reward took 1.5e9 steps.
"""

RETURNS = """Success can be rare although a policy has learned much of what the reward pays for. The table below has the mean return with the
human reward: of whole episodes of zero action and of random actions, and of the last epochs of the training. A return *improves*
where it is above that of both policies by twice the deviation of the better one's episodes. Nine tasks have published learning
curves: the return of Bi-DexHands' PPO, mean and deviation of ten seeds, here between two points of the curve at our number of
steps.
"""


def pages(folder: Path) -> dict[str, str]:
    """Returns the index, what all tasks learned, and of every task the page as Markdown and the charts as SVG, by their paths below `folder`.

    Args:
        folder: the documents, with the tables of `porse.report.learning`.
    """
    learned = {row["task"]: row for row in _read(folder / TABLE)}
    curves: dict[str, list[Mapping[str, str]]] = {}
    for row in _read(folder / CURVES):
        curves.setdefault(row["task"], []).append(row)
    figures = "\n".join([HUMAN, *_learned(list(learned.values())), ""])
    written = {"tasks.md": _index(), "learned.md": figures}
    for name, task in TASKS.items():
        drawn = charts(name, curves[name]) if name in curves else {}
        written[f"{PAGES}/{name}.md"] = _page(task, learned.get(name), drawn)
        written |= {f"{TRAINED}/{place}": svg(chart) for place, chart in drawn.items()}
    return written


def _read(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def charts(task: str, rows: Sequence[Mapping[str, str]]) -> dict[str, Chart]:
    """Returns the charts of a task by the names of their files: of its fitness, and of its return beside a published one.

    Args:
        task: its name.
        rows: of the curves of its runs, one after the other.
    """
    found = {f"{task}.svg": Chart(f"{task}: fitness", STEPS, "fitness", _lines(rows, "fitness"))}
    published = published_curves().get(task)
    if published:
        last = max(int(row["steps"]) for row in rows)
        # One point beyond our last one, so that the line passes it.
        before = [point for point in published if point[0] <= last]
        points = [(steps / 1000, mean, std) for steps, mean, std in published[: len(before) + 1]]
        theirs = Line(
            "Bi-DexHands' PPO",
            [(x, mean) for x, mean, _ in points],
            strong=True,
            band=[(x, mean - std, mean + std) for x, mean, std in points],
        )
        lines = [*_lines(rows, "return"), theirs]
        found[f"{task}-return.svg"] = Chart(f"{task}: return of an episode", STEPS, "return", lines)
    return found


def _lines(rows: Sequence[Mapping[str, str]], value: str) -> list[Line]:
    points: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        points.setdefault(row["seed"], []).append((int(row["steps"]) / 1000, float(row[value] or "nan")))
    return [Line(f"seed {seed}", line) for seed, line in points.items()]


def _index() -> str:
    rows = [
        "| task | tags | observations | actions | steps per episode |",
        "| --- | --- | --- | --- | --- |",
        *(
            f"| [{name}]({PAGES}/{name}.md) | {_tags(name)} | {task.NUM_OBSERVATIONS} | {task.NUM_ACTIONS} "
            f"| {task.EPISODE_LENGTH} |"
            for name, task in TASKS.items()
        ),
    ]
    tags = [f"- *{tag}*: {meaning}." for tag, meaning in TAGS.items()]
    gallery = ["## Gallery", "", *_gallery(list(TASKS)), ""]
    return "\n".join([HEAD, *rows, "", *tags, "", *gallery, COMMON, ""])


def _gallery(names: Sequence[str]) -> Iterator[str]:
    """Yields a table of the tasks' pictures, each a link to its page."""
    cells = [f"[![{name}]({PICTURES}/{name}.png)<br>{name}]({PAGES}/{name}.md)" for name in names]
    yield "|" + " |" * COLUMNS
    yield "|" + " --- |" * COLUMNS
    for start in range(0, len(cells), COLUMNS):
        row = cells[start : start + COLUMNS]
        yield f"| {' | '.join(row + [''] * (COLUMNS - len(row)))} |"


def _tags(name: str) -> str:
    return ", ".join(TASK_TAGS[name])


def _learned(rows: Sequence[Mapping[str, str]]) -> list[str]:
    """Returns two tables: the fitness that every task learned, and its return beside the published one."""
    fitness = ("zero_action", "random", "start", "end", "mts", "final", "paper")
    lines = [
        "| task | seeds | steps | zero action | random | first epochs | last epochs | MTS | final | paper's MTS | learns |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        *(_line(row, row["seeds"], _millions(row), *(row[name] for name in fitness), row["holds"]) for row in rows),
    ]
    lines += [
        "",
        RETURNS,
        "| task | steps | zero action | random | last epochs | improves | published at equal steps | at or above |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        ours = (row[name] for name in ("zero_return", "random_return", "return", "improves"))
        theirs = f"{row['published_return']} ± {row['published_std']}" if row["published_return"] else ""
        lines.append(_line(row, _millions(row), *ours, theirs, row["return_holds"]))
    return lines


def _line(row: Mapping[str, str], *cells: str) -> str:
    name = row["task"]
    return f"| [{name}]({PAGES}/{name}.md) | {' | '.join(cells)} |"


def _millions(row: Mapping[str, str]) -> str:
    return f"{int(row['steps']) / 1e6:.2f} M"


def _page(task: type[Task], learned: Mapping[str, str] | None, drawn: Mapping[str, Chart]) -> str:
    module = inspect.getmodule(task)
    assert module is not None
    about = inspect.cleandoc(module.__doc__ or "").removeprefix(f"{task.NAME}: ")
    words = {"isaac": "Isaac Gym", "bidex": "Bi-DexHands"}
    sizes = f"{task.NUM_OBSERVATIONS} observations, {task.NUM_ACTIONS} actions, control step {task.CONTROL_DT:g} s"
    tags = f" Tags: {_tags(task.NAME)}." if TASK_TAGS[task.NAME] else ""
    lines = [
        f"# {task.NAME}",
        "",
        f"![{task.NAME}](../{PICTURES}/{task.NAME}.png)",
        "",
        about[0].upper() + about[1:],
        "",
        f"Original: {words[task.FAMILY]}. {sizes}.{tags} [What all tasks share](../tasks.md)",
        "",
        "## The task",
        "",
        f"- **Text for the model**: *{task.DESCRIPTION}*.",
        f"- **An episode starts**: {task.STARTS}.",
        f"- **An episode ends**: {task.ENDS}. Time limit: {task.TIME_LIMIT} steps.",
        f"- **Fitness**: {task.FITNESS}.",
        f"- **{'Success' if hasattr(task, 'succeeded') else 'Sparse reward'}**: "
        f"{_first(task, 'succeeded', 'sparse_reward')}",
        f"- **Human reward**: {_first(task, 'human_reward')}",
        "",
        *(_taught(learned, drawn) if learned else ()),
        "## Observations",
        "",
        "| observation | entries | variable |",
        "| --- | --- | --- |",
        *_observations(task),
        "",
        "## Variables",
        "",
        "| name | shape | unit | frame | meaning |",
        "| --- | --- | --- | --- | --- |",
    ]
    for v in task.VARIABLES:
        shape = "num_envs" + "".join(f" x {n}" for n in v.shape) if v.kind == "tensor" else v.kind
        if v.kind == "tuple":
            shape = f"tuple of {v.shape[0]}"
        lines.append(f"| `{v.name}` | {shape} | {v.unit} | {v.frame} | {v.meaning} |")
    return "\n".join([*lines, ""])


def _taught(row: Mapping[str, str], drawn: Mapping[str, Chart]) -> Iterator[str]:
    """Yields the section about the training with the human reward."""
    seeds = "one seed" if row["seeds"] == "1" else f"{row['seeds']} seeds"
    paper = f" The paper's MTS is {row['paper']}, after 1.5e9 steps." if row["paper"] else ""
    yield "## What its human reward teaches"
    yield ""
    yield f"![{row['task']} after training](../{TRAINED}/{row['task']}.png)"
    yield ""
    yield (
        f"The best of 16 episodes of the trained policy's mean action: its start, after one third and two thirds of it, and its end. "
        f"After {_millions(row)} steps ({seeds}) the fitness is {row['end']}. Zero action has {row['zero_action']}, and "
        f"random actions have {row['random']}.{paper} [What all tasks learn](../learned.md)"
    )
    yield ""
    for place, chart in drawn.items():
        yield f"![{chart.title}](../{TRAINED}/{place})"
        yield ""


def _observations(task: type[Task]) -> Iterator[str]:
    """Yields a row of the table for each block of the observations."""
    start = 0
    for block in layout(task):
        end = start + block.width
        scale = "" if block.scale == 1.0 else f"{block.scale:g} * "
        columns = "" if block.columns is None else f"[{block.columns[0]}:{block.columns[1]}]"
        source = f"{scale}`{block.variable}`{columns}" if block.variable else ""
        yield f"| {block.meaning} | {start}-{end - 1} | {source} |"
        start = end


def _first(task: type[Task], *methods: str) -> str:
    """Returns the first line of the first of these methods that the task has."""
    for method in methods:
        found = getattr(task, method, None)
        if found is not None and found.__doc__:
            line = inspect.cleandoc(found.__doc__).splitlines()[0]
            return line.removeprefix("Returns ").strip()
    raise AttributeError(f"{task.NAME} has no documented {' or '.join(methods)}")


def main(folder: Path) -> None:
    """Writes the pages and their pictures into `folder`."""
    for name in (PAGES, PICTURES, TRAINED):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for name, text in pages(folder).items():
        (folder / name).write_text(text, encoding="utf-8")
    for name in TASKS:
        write_png(folder / PICTURES / f"{name}.png", picture(make_task(name, 1, seed=0), WIDTH, HEIGHT))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
