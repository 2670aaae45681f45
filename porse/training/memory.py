"""What a training will fill of the machine's memory, estimated before anything starts.

The numbers were fitted to trainings of five tasks, from Quadcopter to two hands, with 256 to 16 384 environments: the
estimate is two thirds of what each filled beyond the libraries, or more, and never all of it. It refuses what cannot fit, and
changes no result.
"""

from porse.config import Params, TrainParams
from porse.errors import ParamsError
from porse.training.limits import MEMORY_VARIABLE, WORKERS_VARIABLE, limits_from_environment

_FLOAT = 4
_ENVIRONMENT, _ENVIRONMENT_NUMBER = 6 * 1024, 64
"""Bytes of an environment: its simulation, and for each number that is observed of it."""

_WIDEST = (1024, 64)
"""Observations and actions that no task of the package has so many of."""


def training_mib(train: TrainParams, observations: int, actions: int) -> int:
    """Returns the memory that one training fills beyond the libraries, in MiB, estimated.

    Args:
        train: its parameters.
        observations: numbers in an observation of the task.
        actions: numbers in an action.
    """
    steps = train.num_envs * train.steps_per_epoch
    # An epoch's steps: observations twice (stored, and normalised), actions with their mean and deviation, eight scalars.
    stored = steps * _FLOAT * (2 * observations + 3 * actions + 8)
    # A batch through both networks: each layer's sums, activations and gradients.
    batch = steps // train.minibatches * _FLOAT * 2 * (observations + 3 * sum(train.hidden))
    return (stored + batch + _environments(train.num_envs, observations)) // 2**20


def check_memory(params: Params) -> None:
    """Checks that a training of these parameters fits into the memory that it may take.

    Raises:
        ParamsError: it does not, or a variable that says how much it may take is not a number.
    """
    limits = limits_from_environment()
    # To ask the task for its sizes takes seconds: only where the widest one would not fit.
    if max(_needed(params, *_WIDEST)) <= limits.memory_mib:
        return
    from porse.tasks import find_task

    task = find_task(params.task)
    training, episodes = _needed(params, task.NUM_OBSERVATIONS, task.NUM_ACTIONS)
    train, allowed = params.train, f"found {limits.memory_mib} MiB that one may take"
    if training > limits.memory_mib:
        raise ParamsError(
            f"expected memory for a training of {params.task} with train.num_envs = {train.num_envs} and "
            f"train.steps_per_epoch = {train.steps_per_epoch}, about {training} MiB, {allowed}; lower one of the two, "
            f"raise train.minibatches, or give each training more ({WORKERS_VARIABLE}, {MEMORY_VARIABLE})"
        )
    if episodes > limits.memory_mib:
        raise ParamsError(
            f"expected memory for evaluate.episodes = {params.evaluate.episodes} environments of {params.task} at once, "
            f"about {episodes} MiB, {allowed}; lower it"
        )


def _needed(params: Params, observations: int, actions: int) -> tuple[int, int]:
    """Returns the memory of a training, and that of the environments of the final episodes, in MiB."""
    return (
        training_mib(params.train, observations, actions),
        _environments(params.evaluate.episodes, observations) // 2**20,
    )


def _environments(count: int, observations: int) -> int:
    return count * (_ENVIRONMENT + _ENVIRONMENT_NUMBER * observations)
