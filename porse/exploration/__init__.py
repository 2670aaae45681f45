"""The exploration bonus: what is counted -> cells -> visit counts -> bonus (section 3.2 and eq. 3 of the paper)."""

from porse.exploration.bins import ProgressSpace
from porse.exploration.counts import Counts, Visits
from porse.exploration.rarity import literal, relative
from porse.exploration.simhash import SimHash

__all__ = ["Counts", "ProgressSpace", "SimHash", "Visits", "literal", "relative"]
