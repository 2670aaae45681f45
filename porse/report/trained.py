"""What trained policies do, four pictures of each task side by side: `python -m porse.report.trained RESULTS docs/trained`.

The pictures are of one of several episodes of the policy's mean action: the first of those that came to most, so a rare
success is shown where there is one. They are taken at its start, after one and two thirds of it, and before its last step.
"""

from collections.abc import Sequence
from pathlib import Path

import click
import numpy as np
import torch

from porse.config import Params, load_params, presets_root
from porse.picture import Pixels, camera, write_png
from porse.report.results import winners_policy
from porse.tasks import TASKS, make_task
from porse.training.actor import policy_actor
from porse.training.episodes import Episode, play_episodes

ENVS = 16
"""Episodes, of which one is shown."""
SEED = 0
WIDTH, HEIGHT = 240, 180


def shown_episode(episodes: Sequence[Episode]) -> tuple[int, list[int]]:
    """Returns which episode is shown, and after how many of its steps the pictures are taken.

    Args:
        episodes: of all environments, at least one.
    """
    best = max(range(len(episodes)), key=lambda number: episodes[number].outcome)
    # After its last step an environment is at the start of the next episode.
    last = episodes[best].steps - 1
    return best, [0, last // 3, 2 * last // 3, last]


def frames(params: Params, policy: Path) -> Pixels:
    """Returns four pictures of a trained policy side by side, `(HEIGHT, 4 * WIDTH, 3)`, 8-bit RGB.

    Args:
        params: of the policy's run.
        policy: its file.
    """
    played = make_task(params.task, ENVS, SEED)
    best, times = shown_episode(play_episodes(played, policy_actor(played, policy, params.train)))
    # The same seed and the same policy: the same episodes again.
    task = make_task(params.task, ENVS, SEED)
    actor = policy_actor(task, policy, params.train)
    with camera(task, WIDTH, HEIGHT) as take, torch.inference_mode():
        taken: dict[int, Pixels] = {}
        for step in range(times[-1] + 1):
            if step in times:
                taken[step] = take(best)
            task.step(actor(task.observations()))
            task.reset(task.terminated() | task.timed_out())
    return np.concatenate([taken[time] for time in times], axis=1)


@click.command()
@click.argument("results", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.argument("target", type=click.Path(file_okay=False, path_type=Path))
def main(results: Path, target: Path) -> None:
    """Draw the policy of the first seed of each task with a finished run in the folder RESULTS of a suite."""
    torch.set_num_threads(1)
    target.mkdir(parents=True, exist_ok=True)
    found: dict[str, tuple[Params, Path]] = {}
    for done in sorted(results.glob("*/done.json")):
        params = load_params(done.parent / "params.yaml", presets_root(done.parent))
        if params.task not in found or params.seed < found[params.task][0].seed:
            found[params.task] = params, done.parent
    for task in filter(found.__contains__, TASKS):
        params, result = found[task]
        write_png(target / f"{task}.png", frames(params, winners_policy(result / "run", params)))


if __name__ == "__main__":
    main()
