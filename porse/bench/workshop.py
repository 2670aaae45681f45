"""Processes that measure, one for each numeric profile: a process has one profile for life, and two have to take turns.

`python -m porse.bench.workshop PROFILE PARAMS` reads a line of JSON for each thing that it is asked, and answers with one.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from porse import numerics
from porse.bench.machine import plain_environment
from porse.errors import PorseError
from porse.processes import die_with_parent


class Workshop:
    """A process that measures what it is asked for."""

    def __init__(self, profile: numerics.Profile, process: subprocess.Popen[str]) -> None:
        self._profile, self._process = profile, process

    def ask(self, what: str, **arguments: Any) -> Any:
        """Returns what a method of `porse.bench.work.Work` returns, called there with these arguments.

        Raises:
            PorseError: it failed.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps([what, arguments]) + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            pass  # its answer says that it has ended
        answer = self._process.stdout.readline()
        if not answer:
            # It has closed its output, and may still be saying why.
            self._process.wait()
            raise PorseError(
                f"expected {what} of {arguments} to be measured in profile {self._profile}, found that its process ended; "
                "what it printed last, above, says why"
            )
        value, failure = json.loads(answer)
        if failure:
            raise PorseError(failure)
        return value


@contextmanager
def workshop(profile: numerics.Profile, params: Path) -> Iterator[Workshop]:
    """Gives a process that has this profile; it ends with the block, or with this process.

    Args:
        profile: its numeric profile.
        params: the file with the parameters of its trainings.
    """
    command = [sys.executable, "-m", "porse.bench.workshop", profile, str(params)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=plain_environment()
    ) as process:
        try:
            yield Workshop(profile, process)
        finally:
            process.kill()


def main(profile: numerics.Profile, params: Path) -> None:
    """Answers until nobody asks any more."""
    numerics.apply(profile)
    # Before the imports of what measures: torch must find the profile set.
    from porse.bench.work import Work, human_params

    # What trainings and libraries print is not an answer.
    with os.fdopen(os.dup(1), "w", buffering=1) as answers, tempfile.TemporaryDirectory() as folder:
        os.dup2(2, 1)
        work = Work(lambda task: human_params(params, task, profile), Path(folder))
        for line in sys.stdin:
            what, arguments = json.loads(line)
            try:
                answer = getattr(work, what)(**arguments), ""
            except PorseError as error:
                answer = None, str(error)
            answers.write(json.dumps(answer) + "\n")


if __name__ == "__main__":
    die_with_parent()
    main("fast" if sys.argv[1] == "fast" else "portable", Path(sys.argv[2]))
