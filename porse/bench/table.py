"""The table of the bench: every figure, what it is compared with, and its bar.

The bars of ratios are what the project wants of itself, "close to the floor": they are not parameters, and no measurement of
this machine set them. That of a look-up is the one of docs/llm-cache.md.
"""

from collections.abc import Iterable

from porse.bench.figure import Bar, Figure, Measure, Suite

ENVIRONMENTS = 256
"""Of the suite `sim`."""
FEW_ENVIRONMENTS = 16
"""As many as gymnasium has processes for."""

_SHARES = {
    "Quadcopter": 0.88,
    "Humanoid": 0.95,
    "Anymal": 0.93,
    "Over": 0.92,
    "DoorCloseInward": 0.92,
    "LiftUnderarm": 0.92,
    "FrankaCabinet": 0.85,
    "Kettle": 0.85,
}
"""Shares of the physics in a control step, by task. What moves more has more physics to hide the rest behind."""

SHARE = "{task}: physics' share of a control step"
BARE = "Over: bare physics"
OVER_ENVPOOL = "same humanoid: speed over EnvPool's"
OVER_GYMNASIUM = "same humanoid: speed over gymnasium's"
RUNNER = "{task}: stock runner's epoch over ours, {profile}"
FLOOR = "{task}: epoch over its floor, {profile}"
PORTABLE = "Quadcopter: epoch, portable over fast"
WORKERS = "Quadcopter: 6 candidates, 2 workers over 1"
MEMORY = "Quadcopter: memory of a training"
MTS, SECONDS = "Quadcopter: MTS after 90 epochs", "Quadcopter: 90 epochs"
HELP, TASKS, CHECK, DVC = "porse --help", "porse tasks", "porse check-code, one file", "dvc status"
LOOK_UP, VERIFY, KEY = "look-up of a recorded reply", "porse llm verify, each reply", "key of a question"

_BATCH = f"Batch.step alone, {ENVIRONMENTS} environments, one thread"
_FLOOR = "Batch.step and matrix products of the same epoch alone"
_TRAINED = "a training with the human reward, portable; each round another seed"

TABLE: tuple[Measure, ...] = (
    *(Measure("sim", SHARE.format(task=task), "ratio", _BATCH, Bar(">=", share)) for task, share in _SHARES.items()),
    # The scene before the change of its solver is gone, so there is nothing to compare it with: no bar.
    Measure("sim", BARE, "steps/s", f"environment steps of {_BATCH}"),
    Measure(
        "sim", OVER_ENVPOOL, "ratio", f"EnvPool's Humanoid-v5, {ENVIRONMENTS} environments, one thread", Bar(">=", 1.2)
    ),
    Measure(
        "sim", OVER_GYMNASIUM, "ratio", f"gymnasium's AsyncVectorEnv of {FEW_ENVIRONMENTS} Humanoid-v5", Bar(">=", 3.0)
    ),
    *(
        Measure(
            "train", RUNNER.format(task="Quadcopter", profile=profile), "ratio",
            "rsl_rl's OnPolicyRunner, same task, reward and settings", Bar(">=", 1.35),
        )
        for profile in ("fast", "portable")
    ),
    *(
        Measure("train", FLOOR.format(task=task, profile=profile), "ratio", _FLOOR, Bar("<=", limit))
        for task, profile, limit in (("Quadcopter", "fast", 2.0), ("Quadcopter", "portable", 1.8), ("Over", "fast", 1.2))
    ),
    Measure("train", PORTABLE, "ratio", "the same epochs in profile fast", Bar("<=", 1.08)),
    Measure("train", WORKERS, "ratio", "the same trainings one after the other, on the clock", Bar(">=", 1.85)),
    Measure("train", MEMORY, "MB", "beyond what it shares with the process it is forked from", Bar("<=", 60.0)),
    Measure("train", MTS, "fitness", _TRAINED, Bar(">=", -0.33)),
    Measure("train", SECONDS, "s", f"processor time of {_TRAINED}", Bar("<=", 10.0)),
    Measure("pipeline", HELP, "s", "processor time", Bar("<=", 0.15)),
    Measure("pipeline", TASKS, "s", "processor time", Bar("<=", 0.3)),
    Measure("pipeline", CHECK, "s", "processor time", Bar("<=", 1.5)),
    Measure("pipeline", DVC, "s", "processor time, in this project as it is"),
    Measure("llm", LOOK_UP, "ms", "processor time, mean over the records here", Bar("<=", 1.0)),
    Measure("llm", VERIFY, "ms", "processor time, mean over the records here"),
    Measure("llm", KEY, "ms", "processor time, mean over the records here"),
)  # fmt: skip
"""Every figure."""


def share_tasks() -> list[str]:
    """Returns the tasks whose share of physics is measured."""
    return [*_SHARES]


def found(suite: Suite, name: str, rounds: Iterable[float]) -> Figure:
    """Returns the figure of that name, from what its rounds measured."""
    return Figure(_measure(suite, name), rounds=tuple(rounds))


def missing(suite: Suite, name: str, why: str) -> Figure:
    """Returns the figure of that name, not measured.

    Args:
        suite: its suite.
        name: its name.
        why: why it was not, and what to do.
    """
    return Figure(_measure(suite, name), missing=why)


def _measure(suite: Suite, name: str) -> Measure:
    [measure] = [measure for measure in TABLE if (measure.suite, measure.name) == (suite, name)]
    return measure
