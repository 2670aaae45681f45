"""What of a request goes over the wire."""

from typing import Any

from porse.llm.request import Request


def wire_body(request: Request) -> dict[str, Any]:
    """Returns what is sent to an endpoint: the canonical body without what only the key needs."""
    body = request.body()
    del body["schema"], body["sample"]
    return body
