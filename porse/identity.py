"""Canonical JSON, content ids and named seeds: what makes two things the same thing.

Canonical JSON is UTF-8 with sorted keys, no spaces, no NaN, and Python's shortest round-trip floats. A content id is
the SHA-256 of the canonical JSON, tagged with what it identifies, so that ids of different kinds never collide.
Every random draw in the project starts from `seed_for`: a name for the draw, never a global generator.
"""

import hashlib
import json
from typing import Any

CANDIDATE_ID_LENGTH = 12
"""Hexadecimal digits of a candidate id: 48 bits, for a few hundred candidates of one run."""


def canonical_json(value: Any) -> str:
    """Returns the one JSON text of `value`.

    Raises:
        ValueError: a float is not finite.
        TypeError: a value is not JSON.
    """
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def content_id(kind: str, value: Any) -> str:
    """Returns the SHA-256 (64 hexadecimal digits) of `kind` and the canonical JSON of `value`."""
    return hashlib.sha256(f"{kind}\n{canonical_json(value)}".encode()).hexdigest()


def candidate_id(task: str, reward_source: str, mapping_source: str, beta: float, alpha: float, draw: int = 0) -> str:
    """Returns the id of a candidate: the hash of what it is, so equal candidates are one candidate.

    One that has draws of its own is another one than with the draws that its iteration shares, which are draw 0.
    """
    content = {
        "task": task,
        "reward_source": reward_source,
        "mapping_source": mapping_source,
        "beta": float(beta),
        "alpha": float(alpha),
    } | ({"draw": draw} if draw else {})
    return content_id("candidate", content)[:CANDIDATE_ID_LENGTH]


def seed_for(seed: int, *names: str | int) -> int:
    """Returns the seed of one named draw of a run, in [0, 2**63): `seed_for(params.seed, "policy", iteration)`."""
    return int(content_id("seed", [seed, *names])[:16], 16) >> 1
