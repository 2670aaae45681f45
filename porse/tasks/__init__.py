"""The tasks, by name. Adding one here means adding its class to `TASKS`; one of your own is named "module:Class"."""

import difflib

from porse.errors import TaskError
from porse.tasks.anymal import Anymal
from porse.tasks.base import Task
from porse.tasks.block_stack import BlockStack
from porse.tasks.bottle_cap import BottleCap
from porse.tasks.catch_abreast import CatchAbreast
from porse.tasks.catch_over2underarm import CatchOver2Underarm
from porse.tasks.catch_underarm import CatchUnderarm
from porse.tasks.door_close_inward import DoorCloseInward
from porse.tasks.door_close_outward import DoorCloseOutward
from porse.tasks.door_open_inward import DoorOpenInward
from porse.tasks.door_open_outward import DoorOpenOutward
from porse.tasks.franka_cabinet import FrankaCabinet
from porse.tasks.grasp_and_place import GraspAndPlace
from porse.tasks.humanoid import Humanoid
from porse.tasks.kettle import Kettle
from porse.tasks.lift_underarm import LiftUnderarm
from porse.tasks.over import Over
from porse.tasks.own import check_task, find_own_task, is_own
from porse.tasks.pen import Pen
from porse.tasks.push_block import PushBlock
from porse.tasks.quadcopter import Quadcopter
from porse.tasks.re_orientation import ReOrientation
from porse.tasks.scissors import Scissors
from porse.tasks.swing_cup import SwingCup
from porse.tasks.switch import Switch
from porse.tasks.switch_reachable import SwitchReachable
from porse.tasks.two_catch_underarm import TwoCatchUnderarm

TASKS: dict[str, type[Task]] = {
    "Quadcopter": Quadcopter,
    "FrankaCabinet": FrankaCabinet,
    "Anymal": Anymal,
    "Humanoid": Humanoid,
    "Over": Over,
    "CatchAbreast": CatchAbreast,
    "CatchOver2Underarm": CatchOver2Underarm,
    "CatchUnderarm": CatchUnderarm,
    "TwoCatchUnderarm": TwoCatchUnderarm,
    "ReOrientation": ReOrientation,
    "DoorCloseInward": DoorCloseInward,
    "DoorCloseOutward": DoorCloseOutward,
    "DoorOpenInward": DoorOpenInward,
    "DoorOpenOutward": DoorOpenOutward,
    "Scissors": Scissors,
    "SwingCup": SwingCup,
    "Switch": Switch,
    "Kettle": Kettle,
    "LiftUnderarm": LiftUnderarm,
    "Pen": Pen,
    "BottleCap": BottleCap,
    "GraspAndPlace": GraspAndPlace,
    "BlockStack": BlockStack,
    "PushBlock": PushBlock,
    "SwitchReachable": SwitchReachable,
}


def find_task(name: str) -> type[Task]:
    """Returns the class of the task with that name: a name in `TASKS`, or "module:Class" for a task of your own.

    Raises:
        TaskError: no task has that name.
    """
    if is_own(name):
        return find_own_task(name)
    if name not in TASKS:
        near = difflib.get_close_matches(name, TASKS, n=3) or sorted(TASKS)
        raise TaskError(
            f"expected the name of a task, found {name!r}; the nearest names are {', '.join(near)}, and `porse tasks` lists all"
        )
    return TASKS[name]


def make_task(name: str, num_envs: int, seed: int, threads: int = 1) -> Task:
    """Returns a new task with its first episodes started.

    Args:
        name: a name in `TASKS`, or "module:Class".
        num_envs: number of environments.
        seed: seed of the task's own generator.
        threads: native threads of the physics; changes no result.

    Raises:
        TaskError: no task has that name, or a task of your own is not what its class says.
    """
    task = find_task(name)(num_envs, seed, threads)
    if is_own(name):
        check_task(task)
    return task
