"""Open requests of batch mode: one file each under `.porse/pending/`, until somebody answers them."""

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path

from porse.config import LlmParams
from porse.errors import CacheError, ParamsError
from porse.llm.record import Price
from porse.llm.request import Origin, Question, request_from_body
from porse.llm.store import Store


@dataclass(frozen=True)
class OpenRequest:
    """A question that waits for an answer, with what its record will need.

    Attributes:
        question: the request and where it is asked.
        profile: name of the profile that asks.
        price: the profile's prices.
        aliases: names under which the profile's endpoint may answer for the model.
    """

    question: Question
    profile: str
    price: Price
    aliases: tuple[str, ...]

    @property
    def key(self) -> str:
        """The request's key."""
        return self.question.request.key


def open_request(question: Question, params: LlmParams) -> OpenRequest:
    """Returns the open request of a question under the chosen profile."""
    return OpenRequest(question, params.profile, price_of(params), params.profiles[params.profile].aliases)


def price_of(params: LlmParams) -> Price:
    """Returns the prices of the chosen profile."""
    profile = params.profiles[params.profile]
    return Price(profile.usd_per_million_prompt_tokens, profile.usd_per_million_completion_tokens)


def pending_dir(store: Store) -> Path:
    """Returns the directory of the open requests."""
    return store.state_dir / "pending"


def add_pending(store: Store, requests: list[OpenRequest]) -> None:
    """Writes the open requests, each by a rename, so that no half file is ever read.

    Raises:
        CacheError: one cannot be written, as on a full disk; those before it are open.
    """
    directory = pending_dir(store)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for request in requests:
            _write(request, directory)
    except OSError as error:
        raise CacheError(
            f"Expected to write {len(requests)} open requests to {directory}, found: {error}. Make room, or make the folder one "
            "that can be written, and run the command again: what is missing is written then."
        ) from error


def _write(request: OpenRequest, directory: Path) -> None:
    document = {
        "key": request.key,
        "request": request.question.request.body(),
        "origin": asdict(request.question.origin),
        "profile": request.profile,
        "price": asdict(request.price),
        "aliases": list(request.aliases),
    }
    text = json.dumps(document, indent=2, sort_keys=True, ensure_ascii=False) + "\n"
    temporary = directory / f".{request.key}.{os.getpid()}"
    try:
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(directory / f"{request.key}.json")
    finally:
        temporary.unlink(missing_ok=True)


def remove_pending(store: Store, keys: list[str]) -> None:
    """Forgets open requests; a key that is not open is no error."""
    for key in keys:
        (pending_dir(store) / f"{key}.json").unlink(missing_ok=True)


def load_pending(store: Store) -> list[OpenRequest]:
    """Returns all open requests, in the order of the run: by iteration, stage, subject, sample and key.

    A request whose reply has been recorded by other means is forgotten.

    Raises:
        CacheError: a file is not an open request.
    """
    paths = sorted(pending_dir(store).glob("[0-9a-f]*.json"))
    remove_pending(store, [path.stem for path in paths if store.path(path.stem).exists()])
    requests = [_load(path) for path in paths if path.exists()]

    def place(request: OpenRequest) -> tuple[int, str, str, int, str]:
        origin = request.question.origin
        return origin.iteration, origin.stage, origin.subject, request.question.request.sample, request.key

    return sorted(requests, key=place)


def _load(path: Path) -> OpenRequest:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        question = Question(request_from_body(document["request"]), Origin(**document["origin"]))
        price, aliases = Price(**document["price"]), tuple(document["aliases"])
        request = OpenRequest(question, document["profile"], price, aliases)
    except (ValueError, KeyError, TypeError, ParamsError) as error:
        raise CacheError(_damaged(path, repr(error))) from error
    if request.key != path.stem:
        raise CacheError(_damaged(path, f"one with key {request.key[:12]}"))
    return request


def _damaged(path: Path, found: str) -> str:
    return (
        f"Expected an open request in {path}, found {found}. Delete the file and run `porse repro` again with "
        "PORSE_LLM_MODE=batch: the request is written anew."
    )
