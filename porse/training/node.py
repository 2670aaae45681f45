"""One training on a machine of a cluster, as a process of its own: `python -m porse.training.node`, an order on stdin.

The order is JSON (`porse.training.remote` writes it), and so is the answer on stdout, one line: how the training ended. What it
needs and leaves is in files that this machine and the one that gave the order share. The training itself is a local one, a
process below this one, with all that watches over it there: memory, silence, signals.
"""

import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from porse import numerics

# The imports below load NumPy, and the order with the profile is read after them.
numerics.prepare()

from porse.config import Params, parse_part  # noqa: E402
from porse.errors import PorseError  # noqa: E402
from porse.processes import die_with_parent, expected_parent  # noqa: E402
from porse.training.job import Ended, Job, Outcome, Report, Tell  # noqa: E402
from porse.training.limits import limits_from_environment  # noqa: E402
from porse.training.local import Local, message_of  # noqa: E402
from porse.training.parts import train_in_parts  # noqa: E402


def job_document(job: Job) -> dict[str, Any]:
    """Returns a job as JSON has it, with paths that hold in any folder."""
    return {**vars(job), "start": str(job.start.absolute()), "finish": str(job.finish.absolute())}


def job_of(document: Mapping[str, Any]) -> Job:
    """Returns the job that `job_document` wrote."""
    return Job(**{**document, "start": Path(document["start"]), "finish": Path(document["finish"])})


def obey(order: Mapping[str, Any]) -> Outcome:
    """Trains what an order says, and returns how it ended.

    Raises:
        PorseError: the program cannot go on.
    """
    params = parse_part(order["params"], "the parameters of the order")
    # Before torch is imported.
    numerics.apply(params.numerics)
    local, job, folder = Local(limits_from_environment()), job_of(order["job"]), Path(order["folder"])
    if not folder.is_dir():
        raise PorseError(
            f"expected the project's folder to be shared by all machines of the cluster, found no {folder} on "
            f"{os.uname().nodename}; put the project where every machine sees it under the same path (docs/cluster.md)"
        )

    def run(part: Job, params: Params, tell: Tell) -> None:
        local.run([part], params, tell)

    with Path(order["news"]).open("w", encoding="utf-8") as news:

        def tell(event: Report | Ended) -> None:
            if isinstance(event, Report):
                news.write(json.dumps({"epoch": event.epoch, "fitness": event.fitness}) + "\n")
                news.flush()

        return train_in_parts(job, params, folder, order["attempt"], order["every_s"], run, tell)


def main() -> None:
    """Obeys the order on stdin."""
    die_with_parent(expected_parent())
    answer = os.fdopen(os.dup(1), "w", encoding="utf-8")
    # Whatever prints, prints to stderr: stdout has the answer alone.
    os.dup2(2, 1)
    try:
        message = message_of(obey(json.load(sys.stdin)))
    except PorseError as error:
        message = message_of(error)
    answer.write(json.dumps(message) + "\n")
    answer.close()
    sys.stderr.flush()
    # To take PyTorch apart takes a second, and is no use.
    os._exit(0)


if __name__ == "__main__":
    main()
