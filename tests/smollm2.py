"""The example in examples/smollm2: its run, and its recording anew by `python tests/smollm2.py` (`make record-example`)."""

import csv
import json
import logging
import os
import shutil
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parent.parent
EXAMPLE = ROOT / "examples" / "smollm2"
CACHE = EXAMPLE / "llm_cache"
VERDICTS = EXAMPLE / "verdicts.csv"
OUTCOME = EXAMPLE / "outcome.json"
COLUMNS = ("kind", "slot", "attempt", "finish_reason", "completion_tokens", "check", "line", "message", "key")


def params_document() -> dict[str, Any]:
    """Returns the committed parameters with the example's laid over them."""
    from porse.suite.resolve import laid_over

    document = yaml.safe_load((ROOT / "params.yaml").read_text(encoding="utf-8"))
    return laid_over(document, yaml.safe_load((EXAMPLE / "overrides.yaml").read_text(encoding="utf-8")))


@dataclass(frozen=True)
class Outcome:
    """How the functions of the first iteration were got.

    Attributes:
        rows: for each reply what became of it, by the columns of `COLUMNS`, as texts.
        error: the paragraph that the stage ended with, "" where every slot got a function.
    """

    rows: list[dict[str, str]]
    error: str

    @property
    def summary(self) -> dict[str, Any]:
        """What outcome.json holds."""
        checks = [row["check"] for row in self.rows]
        return {
            "error": self.error,
            "replies": len(self.rows),
            "cut_off": sum(row["finish_reason"] == "length" for row in self.rows),
            "verdicts": {check: checks.count(check) for check in sorted(set(checks))},
        }


def run_functions(cache: Path) -> Outcome:
    """Does what the stages `generate` and `validate-code` of iteration 1 do, in this process, and keeps every verdict."""
    from porse.config import parse_params
    from porse.errors import SearchError
    from porse.generation.about import about
    from porse.generation.conversations import Brief
    from porse.generation.functions import Attempt, checked_functions, first_attempts
    from porse.generation.states import checker
    from porse.tasks import find_task

    params = parse_params(params_document(), "the example's parameters")
    task = find_task(params.task)
    environment = task.observation_source().strip()
    brief = Brief(ROOT / "prompts", about(task), environment, True, False, None, [], {}, {}, [])
    rows: list[dict[str, str]] = []
    error = ""
    with checker(params) as check:

        def noted(attempts: Sequence[Attempt]) -> list[Any]:
            found = check(attempts)
            for attempt, (verdict, _) in zip(attempts, found, strict=True):
                reply = attempt.reply
                values = (
                    attempt.kind, attempt.slot, attempt.number, reply.finish_reason, reply.completion_tokens,
                    verdict.check, verdict.line, verdict.message, reply.key,
                )  # fmt: skip
                rows.append({name: str(value) for name, value in zip(COLUMNS, values, strict=True)})
            return found

        try:
            checked_functions(first_attempts(brief, params, 1, cache), noted, brief, params, 1, cache)
        except SearchError as found:
            error = str(found)
    return Outcome(rows, error)


def committed() -> Outcome:
    """Returns the outcome that is committed beside the replies."""
    with VERDICTS.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return Outcome(rows, json.loads(OUTCOME.read_text(encoding="utf-8"))["error"])


def record() -> None:
    """Asks the small model everything anew and writes replies, verdicts and outcome as they come."""
    from servers import engine, missing

    if missing():
        sys.exit(missing())
    logging.basicConfig(format="%(message)s", level=logging.INFO)
    logging.getLogger("httpx2").setLevel(logging.WARNING)
    with tempfile.TemporaryDirectory() as scratch:
        cache = Path(scratch) / "llm_cache"
        # One after the other, so that the engine's seeds go to the questions in their order.
        os.environ |= {"PORSE_LLM_MODE": "record", "PORSE_LLM_CONCURRENCY": "1"}
        with engine(Path(scratch)) as server:
            os.environ["PORSE_LLM_BASE_URL"] = server.url
            outcome = run_functions(cache)
        shutil.rmtree(CACHE, ignore_errors=True)
        shutil.copytree(cache, CACHE)
    with VERDICTS.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        table.writeheader()
        table.writerows(outcome.rows)
    OUTCOME.write_text(json.dumps(outcome.summary, indent=2) + "\n", encoding="utf-8")
    print(json.dumps(outcome.summary, indent=2))


if __name__ == "__main__":
    sys.path[:0] = [str(ROOT)]
    from porse import numerics

    numerics.apply("portable")
    record()
