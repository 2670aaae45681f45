"""The exploration bonus: what is counted -> cells -> visit counts -> bonus (section 3.2 and eq. 3 of the paper)."""

from porse.exploration.counts import ProgressCounts
from porse.exploration.simhash import SimHashCounts
from porse.exploration.sums import SumCounts
from porse.exploration.visits import VisitCounts

__all__ = ["ProgressCounts", "SimHashCounts", "SumCounts", "VisitCounts"]
