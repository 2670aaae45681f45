"""`porse llm`: the commands for people who answer, check, read or replace recorded replies.

Errors of the project pass through: the `porse` command prints them as one paragraph.
"""

import dataclasses
import difflib
import json
from pathlib import Path

import click

from porse.config import LlmParams, load_params
from porse.errors import CacheError, ParamsError, TableError
from porse.llm.batch import Answerer, answer_lines, answer_text, export_lines, import_answers
from porse.llm.ledger import totals
from porse.llm.pending import load_pending, remove_pending
from porse.llm.record import CONTEXTS, answerer
from porse.llm.refresh import refresh_from_endpoint, refresh_from_text
from porse.llm.sampling import samples
from porse.llm.show import conversation, open_conversation
from porse.llm.stats import Line, by_model, by_place, samples_table, spending_table, total
from porse.llm.store import Store
from porse.llm.verify import verify as verify_cache
from porse.printing import echo, visible

FILE = click.Path(path_type=Path, dir_okay=False, exists=True)

CACHE = click.option(
    "--cache",
    "cache_dir",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("llm_cache"),
    show_default=True,
    help="Directory of recorded replies.",
)

PARAMS = click.option(
    "--params",
    "params_path",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path("params.yaml"),
    show_default=True,
    help="File with the llm section.",
)

PROFILE = click.option("--profile", help="Profile to ask instead of llm.profile.")

JSON = click.option("--json", "as_json", is_flag=True, help="Print JSON.")

CONTEXT_HELP = (
    "What was seen before each reply: `fresh`, only its question; `shared`, other questions and replies; or `unknown`."
)


@click.group()
def llm() -> None:
    """Recorded model replies: answer, check, read and replace them."""


@llm.command()
@CACHE
@click.option("--clear", is_flag=True, help="Forget all open requests; `porse repro` writes the ones it still needs.")
@JSON
def pending(cache_dir: Path, clear: bool, as_json: bool) -> None:
    """List the open requests, one line each."""
    store = Store(cache_dir)
    requests = load_pending(store)
    if as_json:
        rows = [{"key": request.key, **dataclasses.asdict(request.question.origin)} for request in requests]
        echo(json.dumps(rows, indent=2))
    else:
        for request in requests:
            echo(f"{request.key}  {request.question.origin}")
    echo(f"{len(requests)} open requests{', all forgotten' if clear else ''}", err=True)
    if clear:
        remove_pending(store, [request.key for request in requests])


@llm.command()
@CACHE
@click.option(
    "--prompts",
    type=click.Path(path_type=Path, file_okay=False),
    help="Also write each request as a readable text <key>.prompt into this directory.",
)
@click.argument("target", type=click.Path(dir_okay=False, allow_dash=True), default="-")
def export(cache_dir: Path, prompts: Path | None, target: str) -> None:
    """Write the open requests to TARGET as OpenAI batch JSONL (default: standard output)."""
    requests = load_pending(Store(cache_dir))
    with click.open_file(target, "w", encoding="utf-8") as file:
        file.write(export_lines(requests))
    if prompts is not None:
        prompts.mkdir(parents=True, exist_ok=True)
        for request in requests:
            text = open_conversation(request.question) + "\n"
            (prompts / f"{request.key}.prompt").write_text(text, encoding="utf-8")
    echo(f"{len(requests)} open requests", err=True)


@llm.command("import")
@CACHE
@click.option("--answered-by", required=True, help='Who answered, for the records: "a language model, offline".')
@click.option("--context", type=click.Choice(list(CONTEXTS)), required=True, help=CONTEXT_HELP)
@click.option("--api-model", is_flag=True, help="A model behind a public API answered.")
@click.argument("source", type=click.Path(path_type=Path, exists=True))
def import_(cache_dir: Path, answered_by: str, context: str, api_model: bool, source: Path) -> None:
    """Record the answers in SOURCE, all of them or none.

    SOURCE is a JSONL file, either OpenAI batch output or lines {"custom_id": KEY, "text": TEXT or LIST OF LINES}, or a
    directory with one text <key>.md or <key>.txt for each answer.
    """
    store = Store(cache_dir)
    who = Answerer(answered_by, context, api_model)
    for item in import_answers(answer_lines(source), str(source), who, load_pending(store), store):
        record, state = item.record, "recorded" if item.fresh else "was recorded before"
        echo(f"{record.key}  {record.provenance.origin}: {state}, {len(record.answer.text)} characters")


@llm.command()
@CACHE
@click.option(
    "--used", type=FILE, multiple=True, help="A Parquet table with a column `key`; may be given several times."
)
@JSON
def verify(cache_dir: Path, used: tuple[Path, ...], as_json: bool) -> None:
    """Check all records: keys, hashes, names, secrets; with --used also what no table names."""
    problems = verify_cache(cache_dir, _used_keys(used) if used else None)
    records = sum(1 for _ in Store(cache_dir).all_keys())
    if as_json:
        echo(json.dumps({"records": records, "problems": problems}, indent=2))
    else:
        for problem in problems:
            echo(visible(problem, keep=""))
    if problems:
        raise click.ClickException(f"{len(problems)} problems in {cache_dir}")
    if not as_json:
        echo(f"{records} records, all as they were written")


@llm.command()
@CACHE
@click.option("--list", "list_keys", is_flag=True, help="List all keys instead.")
@JSON
def stats(cache_dir: Path, list_keys: bool, as_json: bool) -> None:
    """Show requests, tokens and cost, who answered what, and how different the samples of a question are."""
    if not cache_dir.is_dir():
        raise CacheError(f"Expected a directory of recorded replies in {cache_dir}, found none. Pass it by `--cache`.")
    store = Store(cache_dir)
    records = [record for key in store.all_keys() if (record := store.read(key)) is not None]
    if list_keys:
        if as_json:
            rows = [{"key": record.key, **dataclasses.asdict(record.provenance.origin)} for record in records]
            echo(json.dumps(rows, indent=2))
            return
        for record in records:
            echo(f"{record.key}  {record.provenance.origin}")
        return
    lines = by_place(records)
    recorded, ledger = total(lines), totals(store)
    if as_json:
        document = {
            "by_place": [_line(("iteration", "stage"), line) for line in lines],
            "by_model": [_line(("model", "answered_by"), line) for line in by_model(records)],
            "samples": [
                {
                    **dataclasses.asdict(entry.origin),
                    "key": entry.key,
                    "samples": entry.count,
                    "replies": entry.replies,
                    "functions": entry.functions,
                }
                for entry in samples(records)
            ],
            "recorded": dataclasses.asdict(recorded),
            "reserved_usd": sum(ledger.reserved.values()),
            "spent_by_this_checkout": dataclasses.asdict(ledger.spending),
        }
        echo(json.dumps(document, indent=2))
        return
    echo(spending_table(("iteration", "stage"), lines))
    echo()
    echo(spending_table(("model", "answered by"), by_model(records)))
    echo()
    several = samples(records)
    if several:
        echo(samples_table(several))
        count, functions = sum(entry.count for entry in several), sum(entry.functions for entry in several)
        echo(f"{count} samples of {len(several)} questions hold {functions} different functions")
        echo()
    echo(f"recorded: {recorded.replies} replies, {recorded.cost_usd:.6f} USD")
    if ledger.reserved:
        echo(f"sent without an answer: {len(ledger.reserved)} requests, up to {sum(ledger.reserved.values()):.6f} USD")
    echo(f"spent by this checkout: {ledger.spending.replies} replies, {ledger.spending.cost_usd:.6f} USD")


@llm.command()
@CACHE
@click.argument("key")
def show(cache_dir: Path, key: str) -> None:
    """Print a recorded or open request as a conversation. KEY may be the first digits of a key."""
    echo(conversation(key, Store(cache_dir)))


@llm.command()
@CACHE
@click.argument("key")
@click.argument("other")
def diff(cache_dir: Path, key: str, other: str) -> None:
    """Compare two conversations line by line."""
    store = Store(cache_dir)
    # Written out first: what a reply holds divides no line.
    left, right = (visible(conversation(prefix, store)).splitlines() for prefix in (key, other))
    for line in difflib.unified_diff(left, right, key, other, lineterm=""):
        echo(line)


@llm.command()
@CACHE
@PARAMS
@PROFILE
@click.option("--answer", type=FILE, help="Take the new reply from this text instead of asking an endpoint.")
@click.option("--answered-by", help="Who wrote the text of --answer.")
@click.option("--context", type=click.Choice(list(CONTEXTS)), help=CONTEXT_HELP)
@click.argument("key")
def refresh(
    cache_dir: Path,
    params_path: Path,
    profile: str | None,
    answer: Path | None,
    answered_by: str | None,
    context: str | None,
    key: str,
) -> None:
    """Replace one recorded reply; the old record is kept beside it as <key>.<n>.json."""
    store = Store(cache_dir)
    whole_key = store.find(key)
    if answer is None:
        kept = refresh_from_endpoint(whole_key, with_profile(load_params(params_path).llm, profile), store)
    elif answered_by and context:
        who = answerer(answered_by, "a text", context, is_api_model=False)
        kept = refresh_from_text(whole_key, answer_text(answer), who, store)
    else:
        raise click.UsageError("--answer needs --answered-by and --context")
    echo(f"{whole_key}: replaced, the old record is {kept}")


def _line(heading: tuple[str, str], line: Line) -> dict[str, object]:
    """Returns a line of the statistics as an object; `heading` names what it is about."""
    group = dict(zip(heading, line.group, strict=True))
    return {
        **{name: int(part) if name == "iteration" else part for name, part in group.items()},
        **dataclasses.asdict(line.spending),
        "truncated": line.truncated,
    }


def with_profile(params: LlmParams, profile: str | None) -> LlmParams:
    """Returns the llm section with another profile chosen; None leaves it as it is.

    Raises:
        ParamsError: there is no such profile.
    """
    if profile is None:
        return params
    if profile not in params.profiles:
        raise ParamsError(f"Expected --profile to be one of {', '.join(params.profiles)}, found {profile!r}.")
    return dataclasses.replace(params, profile=profile)


def _used_keys(paths: tuple[Path, ...]) -> set[str]:
    """Returns all keys that the tables name."""
    # Imported here: only this command reads Parquet, and the library takes half a second.
    import pyarrow
    import pyarrow.parquet

    keys: set[str] = set()
    for path in paths:
        try:
            column = pyarrow.parquet.read_table(path, columns=["key"]).column("key")
        except (pyarrow.ArrowException, KeyError, OSError) as error:
            found = str(error).splitlines()[0]
            raise TableError(f"Expected a Parquet table with a column `key` in {path}, found: {found}.") from error
        keys.update(key for key in column.to_pylist() if key)
    return keys
