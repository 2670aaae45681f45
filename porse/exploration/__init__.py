"""The exploration bonus: progress variables -> cells -> visit counts -> bonus (section 3.2 and eq. 3 of the paper)."""

from porse.exploration.visits import VisitCounts

__all__ = ["VisitCounts"]
