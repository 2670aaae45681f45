"""Why a training failed, in words that two machines write alike: no path, no address, not too long."""

from porse.errors import without_places

_LONGEST = 400


def reason_of(error: BaseException) -> str:
    """Returns what an exception says, as part of a sentence."""
    said = plain(str(error))
    return f"{type(error).__name__}: {said}" if said else type(error).__name__


def last_words(printed: str) -> str:
    """Returns the end of what a training has printed, on one line."""
    lines = [line.strip() for line in printed.splitlines() if line.strip()]
    return plain(" | ".join(lines[-3:]))


def plain(text: str) -> str:
    """Returns a text on one line, cut to a length, without the folders of paths and without addresses."""
    line = without_places(" ".join(text.split()))
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST - 3]}..."
