"""The exception tree of the project.

PorseError
    ParamsError       params.yaml or an environment variable is missing, unknown or out of range
    TableError        a Parquet table differs from the data dictionary
    TaskError         a task is unknown or was used in a way that it does not allow
    CacheError        a recorded reply cannot be trusted: edited, truncated, misnamed, contradictory
        CacheMiss     frozen mode, and a request has no recorded reply
    RepliesPending    batch mode, and some requests wait for an answer
    AnswersError      a file of answers cannot be imported
    ProviderError     a model endpoint refused, failed or answered with something unusable
    CodeError         a generated function cannot be compiled or run (porse.functions.verdict)
    ProbeError        the confined process that tries functions cannot work (porse.functions.read.sandbox)
    SearchError       the search cannot go on: no valid candidate is left, say
    CheckpointError   a checkpoint is missing, damaged or of another run

A failed *candidate* is never an exception: it is a row with a reason. An exception is a failed program, and its
text says what was expected, what was found, where, and what to do next, in one paragraph.
"""

import re

_SIGNS_OF_LACK = (
    "can't allocate memory",
    "not enough memory",
    "bad_alloc",
    "cannot allocate memory",
    "could not allocate",
)
_PATH = re.compile(r"(?:/[^\s/:'\"<>,;()]+)+/([^\s/:'\"<>,;()]+)")
_ADDRESS = re.compile(r"\b0x[0-9a-fA-F]{4,}\b")


def without_places(text: str) -> str:
    """Returns what an error says without the folders of paths and without addresses, so that two machines say the same."""
    return _ADDRESS.sub("0x...", _PATH.sub(r"\1", text))


def lacks_memory(error: BaseException) -> bool:
    """Returns whether an exception says that memory was refused; torch and MuJoCo have no type of their own for that."""
    return isinstance(error, MemoryError) or any(sign in str(error).lower() for sign in _SIGNS_OF_LACK)


class PorseError(Exception):
    """Base of every error that the project raises on purpose."""


class ParamsError(PorseError):
    """A parameter or an environment variable is missing, unknown or out of range."""


class TableError(PorseError):
    """A table differs from the data dictionary in `porse.tables`."""


class TaskError(PorseError):
    """A task is unknown or was used in a way that it does not allow."""


class CacheError(PorseError):
    """A recorded reply cannot be trusted."""


class CacheMiss(CacheError):
    """Frozen mode, and a request has no recorded reply."""


class RepliesPending(PorseError):
    """Batch mode, and some requests wait for an answer."""


class AnswersError(PorseError):
    """A file of answers cannot be imported."""


class ProviderError(PorseError):
    """A model endpoint refused, failed or answered with something unusable."""


class SearchError(PorseError):
    """The search cannot go on."""


class CheckpointError(PorseError):
    """A checkpoint is missing, damaged or of another run."""
