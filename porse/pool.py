"""A pool: candidates at one point of the schedule, with all that the next stage needs to go on with them.

A pool is a folder, the same for every stage that reads or writes one:

    candidates.parquet   who is in it, and which policy each goes on from
    curves.parquet       the series of these candidates, over all their epochs so far
    policies/            policies and checkpoints, one file for each that is named in `candidates.policy`
"""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from porse import tables
from porse.tables import Row

CANDIDATES_FILE, CURVES_FILE, POLICIES = "candidates.parquet", "curves.parquet", "policies"
BEST, RANDOM, START_POLICY = "best", "random", "fused"
"""Stems of theta_best and theta_random, and of the policy that a candidate starts from by default."""
START_POLICIES = (BEST, RANDOM, START_POLICY)


@dataclass(frozen=True)
class Pool:
    """A pool that was read from its folder."""

    folder: Path
    candidates: list[Row]
    curves: list[Row]

    def policy(self, candidate: Row) -> Path:
        """Returns the file that a candidate's training goes on from."""
        return policy_file(self.folder, candidate["policy"])


def policy_file(folder: Path, stem: str) -> Path:
    """Returns the file of a policy in a pool's folder."""
    return folder / POLICIES / f"{stem}.safetensors"


def read_pool(folder: Path) -> Pool:
    """Returns the pool in `folder`.

    Raises:
        TableError: a table is missing or is not as declared.
    """
    candidates = tables.read(folder / CANDIDATES_FILE, tables.CANDIDATES)
    return Pool(folder, candidates, tables.read(folder / CURVES_FILE, tables.CURVES))


def write_pool(folder: Path, candidates: Sequence[Row], curves: Sequence[Row], policies: Mapping[str, Path]) -> None:
    """Writes a pool to `folder`.

    Args:
        folder: where; made when missing.
        candidates: rows of the candidates table.
        curves: rows of the curves table; those of other candidates are left out.
        policies: stem -> file to copy, for policies that are not in the folder yet.
    """
    members = {candidate["candidate_id"] for candidate in candidates}
    tables.write(folder / CANDIDATES_FILE, tables.CANDIDATES, candidates)
    tables.write(folder / CURVES_FILE, tables.CURVES, [row for row in curves if row["candidate_id"] in members])
    for stem, source in sorted(policies.items()):
        target = policy_file(folder, stem)
        target.parent.mkdir(parents=True, exist_ok=True)
        # copyfile, not copy: DVC may have made the source read-only, which must not travel.
        shutil.copyfile(source, target)
