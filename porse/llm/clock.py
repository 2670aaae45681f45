"""The time, for provenance only: nothing that a stage writes ever depends on it."""

from datetime import UTC, datetime


def utc_now() -> str:
    """Returns the time in UTC, ISO 8601, to the second."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
