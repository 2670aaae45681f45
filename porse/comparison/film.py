"""The winner of a run in motion, as the page about the run shows it."""

import tempfile
from pathlib import Path

from porse.config import Params
from porse.renderer import import_without_drawing, no_renderer
from porse.report.page import Film, no_film
from porse.report.results import winners_policy
from porse.task_names import is_own

LENGTHS_S = (4.0, 2.0, 1.0)
"""Of the film; a shorter one is tried where one is too large."""
WIDTH, HEIGHT = 320, 240
MOST_BYTES = 3 * 2**20


def winner_film(params: Params, folder: Path) -> Film:
    """Returns a film of the winner of the run in `folder`, or why there is none.

    Whether anything can be drawn here is tried in another process: a page is whole without a film.
    A run that came as its tables alone has no policy. A task of somebody's own is not imported for a page.
    """
    policy = winners_policy(folder / "run", params)
    if is_own(params.task):
        return no_film("the task is one of its author's own, and its code is not run for a page.")
    if not policy.is_file():
        import_without_drawing()
        return no_film("the run's policies are not beside its tables.")
    if without := no_renderer():
        return no_film(f"{without}.")
    from porse.film import SEED, Shot, write_gif
    from porse.tasks import make_task
    from porse.training.actor import policy_actor

    with tempfile.TemporaryDirectory() as place:
        target = Path(place) / "film.gif"
        for seconds in LENGTHS_S:
            shown = make_task(params.task, 1, SEED)
            write_gif(target, shown, policy_actor(shown, policy, params.train), seconds, Shot(WIDTH, HEIGHT))
            gif = target.read_bytes()
            if len(gif) <= MOST_BYTES:
                words = f"{seconds:g} seconds of its mean action, from the start of an episode."
                return Film(gif, WIDTH, HEIGHT, words)
    return no_film(f"{LENGTHS_S[-1]:g} seconds are {len(gif)} bytes, and {MOST_BYTES} are the most.")
