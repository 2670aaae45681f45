"""How replies are got: what must not change what is asked, from environment variables and the budgets of `params.yaml`.

| variable | meaning | default |
| --- | --- | --- |
| `PORSE_LLM_MODE` | `frozen`, `record` or `batch` | `frozen` |
| `PORSE_LLM_BASE_URL` | endpoint instead of the profile's | the profile's |
| `PORSE_LLM_TIMEOUT_S` | limit on one request, in seconds, from connecting to the last byte | 300 |
| `PORSE_LLM_STAGE_TIMEOUT_S` | limit on all requests that a stage asks at once, in seconds | 3600 |
| `PORSE_LLM_CONCURRENCY` | requests under way at once | 4 |
| `PORSE_LLM_ATTEMPTS` | attempts at one request, the first among them | 6 |
"""

import os
import re
from dataclasses import dataclass
from typing import Literal, cast, get_args

from porse.config import LlmParams
from porse.errors import ParamsError

Mode = Literal["frozen", "record", "batch"]

_NOT_IN_A_HEADER = re.compile(r"[^\x21-\x7e]")


@dataclass(frozen=True)
class Transport:
    """Where and how patiently an endpoint is asked.

    Attributes:
        profile: name of the profile.
        base_url: the endpoint.
        overridden: whether the endpoint comes from the environment and not from the profile.
        api_key: the secret, "" where the endpoint asks for none; it is never printed or stored.
        aliases: names under which the endpoint may answer for the model.
        timeout_s: limit on one request.
        stage_timeout_s: limit on all requests of one call of `ask`.
        concurrency: requests under way at once.
        attempts: attempts at one request.
        max_usd: what may be spent in all, None for no limit.
        max_requests: requests that may be sent in all, None for no limit.
    """

    profile: str
    base_url: str
    overridden: bool
    api_key: str
    aliases: tuple[str, ...]
    timeout_s: float
    stage_timeout_s: float
    concurrency: int
    attempts: int
    max_usd: float | None
    max_requests: int | None

    def __repr__(self) -> str:
        """Returns the endpoint without its secret."""
        return f"Transport({self.profile!r}, {self.base_url!r})"


def mode_from_environment() -> Mode:
    """Returns the mode that `PORSE_LLM_MODE` names, `frozen` when it is unset or empty.

    Raises:
        ParamsError: it names no mode.
    """
    mode = os.environ.get("PORSE_LLM_MODE", "") or "frozen"
    if mode not in get_args(Mode):
        raise ParamsError(f"Expected PORSE_LLM_MODE to be {', '.join(get_args(Mode))} or unset, found {mode!r}.")
    return cast(Mode, mode)


def transport_from_environment(params: LlmParams) -> Transport:
    """Returns how to reach the chosen profile's endpoint.

    Raises:
        ParamsError: the profile has no endpoint, its API key is not set, or a limit is not a positive number.
    """
    profile = params.profiles[params.profile]
    override = os.environ.get("PORSE_LLM_BASE_URL", "")
    if not override and not profile.base_url:
        raise ParamsError(
            f"Expected an endpoint to record replies from, found none: profile {params.profile!r} of params.yaml has "
            "no base_url. Choose another llm.profile, set PORSE_LLM_BASE_URL, or answer the requests yourself with "
            "PORSE_LLM_MODE=batch."
        )
    return Transport(
        profile=params.profile,
        base_url=override or profile.base_url,
        overridden=bool(override),
        api_key=_api_key(params.profile, profile.key_variable),
        aliases=profile.aliases,
        timeout_s=_positive("PORSE_LLM_TIMEOUT_S", 300.0),
        stage_timeout_s=_positive("PORSE_LLM_STAGE_TIMEOUT_S", 3600.0),
        concurrency=_count("PORSE_LLM_CONCURRENCY", 4),
        attempts=_count("PORSE_LLM_ATTEMPTS", 6),
        max_usd=params.max_usd,
        max_requests=params.max_requests,
    )


def _api_key(profile: str, variable: str) -> str:
    if not variable:
        return ""
    key = os.environ.get(variable, "").strip()
    if not key:
        raise ParamsError(
            f"Expected the API key of profile {profile!r} in the environment variable {variable}, found none. "
            f"Run `export {variable}=...` first; keys are never read from a file."
        )
    wrong = _NOT_IN_A_HEADER.search(key)
    if wrong:
        raise ParamsError(
            f"Expected the API key of profile {profile!r} in {variable} to be one word of ASCII, found the character "
            f"U+{ord(wrong[0]):04X} at place {wrong.start() + 1} of {len(key)}. Copy the key again: word processors turn "
            "hyphens into dashes, and files end in line breaks."
        )
    return key


def _positive(variable: str, default: float) -> float:
    text = os.environ.get(variable, "")
    if not text:
        return default
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise ParamsError(f"Expected {variable} to be a number above 0, found {text!r}.")
    return value


def _count(variable: str, default: int) -> int:
    text = os.environ.get(variable, "")
    if text and not (text.isascii() and text.isdigit() and int(text) > 0):
        raise ParamsError(f"Expected {variable} to be a whole number above 0, found {text!r}.")
    return int(text) if text else default
