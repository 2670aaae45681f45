"""The tasks of the package by name, as text: which module holds each. Naming a task loads none of them.

No stage's result depends on this file: what a stage depends on is the module that the run's task names (`porse.inputs`).
"""

import difflib
from pathlib import Path

TASK_CLASSES: dict[str, str] = {
    "Quadcopter": "porse.tasks.quadcopter:Quadcopter",
    "FrankaCabinet": "porse.tasks.franka_cabinet:FrankaCabinet",
    "Anymal": "porse.tasks.anymal:Anymal",
    "Humanoid": "porse.tasks.humanoid:Humanoid",
    "Over": "porse.tasks.over:Over",
    "CatchAbreast": "porse.tasks.catch_abreast:CatchAbreast",
    "CatchOver2Underarm": "porse.tasks.catch_over2underarm:CatchOver2Underarm",
    "CatchUnderarm": "porse.tasks.catch_underarm:CatchUnderarm",
    "TwoCatchUnderarm": "porse.tasks.two_catch_underarm:TwoCatchUnderarm",
    "ReOrientation": "porse.tasks.re_orientation:ReOrientation",
    "DoorCloseInward": "porse.tasks.door_close_inward:DoorCloseInward",
    "DoorCloseOutward": "porse.tasks.door_close_outward:DoorCloseOutward",
    "DoorOpenInward": "porse.tasks.door_open_inward:DoorOpenInward",
    "DoorOpenOutward": "porse.tasks.door_open_outward:DoorOpenOutward",
    "Scissors": "porse.tasks.scissors:Scissors",
    "SwingCup": "porse.tasks.swing_cup:SwingCup",
    "Switch": "porse.tasks.switch:Switch",
    "Kettle": "porse.tasks.kettle:Kettle",
    "LiftUnderarm": "porse.tasks.lift_underarm:LiftUnderarm",
    "Pen": "porse.tasks.pen:Pen",
    "BottleCap": "porse.tasks.bottle_cap:BottleCap",
    "GraspAndPlace": "porse.tasks.grasp_and_place:GraspAndPlace",
    "BlockStack": "porse.tasks.block_stack:BlockStack",
    "PushBlock": "porse.tasks.push_block:PushBlock",
    "SwitchReachable": "porse.tasks.switch_reachable:SwitchReachable",
}
"""Each task's class as "module:Class", in the order of docs/tasks.md."""

TAGS: dict[str, str] = {
    "hands": "two Shadow hands",
    "locomotion": "a body that walks or runs",
    "catch": "an object is thrown from hand to hand",
    "door": "a double door is opened or closed",
    "table": "what the hands move starts on a table",
    "easy": "the human reward is known to raise the fitness far above its start in half an hour of one CPU core",
    "hard": "it is known not to, or the task cannot be solved as the original ships it",
}
"""What each tag says. A task that is neither easy nor hard has not been looked at for long enough."""

TASK_TAGS: dict[str, tuple[str, ...]] = {
    "Quadcopter": ("easy",),
    "FrankaCabinet": ("easy",),
    "Anymal": ("locomotion", "easy"),
    "Humanoid": ("locomotion", "easy"),
    "Over": ("hands", "catch", "easy"),
    "CatchAbreast": ("hands", "catch", "easy"),
    "CatchOver2Underarm": ("hands", "catch", "easy"),
    "CatchUnderarm": ("hands", "catch", "easy"),
    "TwoCatchUnderarm": ("hands", "catch", "hard"),
    "ReOrientation": ("hands", "hard"),
    "DoorCloseInward": ("hands", "door", "easy"),
    "DoorCloseOutward": ("hands", "door", "hard"),
    "DoorOpenInward": ("hands", "door", "hard"),
    "DoorOpenOutward": ("hands", "door", "easy"),
    "Scissors": ("hands", "table", "easy"),
    "SwingCup": ("hands", "table", "hard"),
    "Switch": ("hands", "table", "hard"),
    "Kettle": ("hands", "table", "easy"),
    "LiftUnderarm": ("hands", "table", "easy"),
    "Pen": ("hands", "table", "easy"),
    "BottleCap": ("hands", "easy"),
    "GraspAndPlace": ("hands", "table", "easy"),
    "BlockStack": ("hands", "table", "easy"),
    "PushBlock": ("hands", "table", "easy"),
    "SwitchReachable": ("hands", "table", "easy"),
}
"""Tags of each task: facts about it, by which no result is computed."""

TASK_ROWS = Path(__file__).with_name("tasks.json")
"""Each task with its sizes, tags and text, which `python -m porse.report.task_rows` writes: importing 25 tasks takes seconds."""


def is_own(name: str) -> bool:
    """Returns whether a task's name is of the form "module:Class", which names a task outside the package."""
    return ":" in name


def near_tasks(name: str) -> str:
    """Returns a clause for an error about the name of a task that is none: the nearest names, or all where none is near."""
    tasks = {task.lower(): task for task in TASK_CLASSES}
    near = [tasks[key] for key in difflib.get_close_matches(name.lower(), tasks, n=3)]
    if near:
        return f"the nearest names are {', '.join(near)}"
    return f"no name is near, all are {', '.join(sorted(TASK_CLASSES))}"


def own_place(task: str) -> str:
    """Returns the top-level folder or file of a task of one's own, below the project's root."""
    module = class_name(task).partition(":")[0]
    return module.partition(".")[0] if "." in module else f"{module}.py"


def module_file(root: Path, module: str) -> Path:
    """Returns the file of a module, or of a package, whose dotted name is found from the folder `root`."""
    base = root.joinpath(*module.split("."))
    package = base / "__init__.py"
    return package if package.is_file() else base.with_suffix(".py")


def class_name(task: str) -> str:
    """Returns the "module:Class" of a task: of one of the package, or of one's own as it is named.

    Raises:
        KeyError: no task has that name.
    """
    return task if is_own(task) else TASK_CLASSES[task]
